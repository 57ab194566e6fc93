"""The picture that `--picture` asks for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jaxbe.cli.errors import InputError
from jaxbe.viz import picture
from jaxbe.viz.view import View


def check_writable(path: Path) -> None:
    """Checks that a file can be written, before anything takes long.

    Raises:
        InputError: it cannot.
    """
    existed = path.exists()
    try:
        path.open("ab").close()
        if not existed:
            path.unlink()
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from None


def draw(model: Any, view: View, path: Path) -> picture.Picture:
    """Draws a state, see `jaxbe.viz.picture`.

    Raises:
        InputError: neither OpenGL nor matplotlib is there.
    """
    try:
        return picture.draw(model, view, path)
    except ModuleNotFoundError as error:
        raise InputError(error) from None
