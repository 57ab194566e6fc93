"""The files that the command reads."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from jaxbe.cli.errors import InputError
from jaxbe.cli.shown import shown


def check_is_file(path: Path) -> None:
    """Checks that there is a file to read.

    Raises:
        InputError: nothing, a directory, a device, a pipe, or out of reach.
    """
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):
        raise InputError(f"no such file: {shown(path)}") from None
    except OSError as error:
        raise InputError(f"cannot read {shown(path)}: {error.strerror}") from None
    if stat.S_ISDIR(mode):
        raise InputError(f"{shown(path)} is a directory, not a file")
    if not stat.S_ISREG(mode):
        raise InputError(f"{shown(path)} is not a regular file")
