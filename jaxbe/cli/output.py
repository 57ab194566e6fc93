"""Text on its way to terminals, pipes and files, which may not take it."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import TextIO

from jaxbe.cli.errors import OutputError


def write(text: str) -> None:
    """Writes to standard output, and not later.

    What its encoding has not is written as an escape.

    Raises:
        OutputError: standard output is closed, full or read by nobody.
    """
    if sys.stdout is None:
        raise OutputError("cannot write to standard output: it is closed")
    try:
        sys.stdout.write(_encodable(text, sys.stdout.encoding))
        sys.stdout.flush()
    except (OSError, ValueError) as error:
        _discard(sys.stdout)
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot write to standard output: {reason}") from None


def complain(line: str) -> None:
    """Writes a line to standard error, if anybody can read it."""
    if sys.stderr is None:
        return
    try:
        print(f"jaxbe: {line}", file=sys.stderr, flush=True)
    except (OSError, ValueError):
        _discard(sys.stderr)


def _encodable(text: str, encoding: str | None) -> str:
    if encoding is None:
        return text
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _discard(stream: TextIO) -> None:
    """Lets what is left go nowhere: at its exit Python would try and fail again."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
