"""The picture that `--picture` asks for."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path, PureWindowsPath
from typing import Any

from jaxbe.cli.errors import InputError
from jaxbe.cli.shown import shown
from jaxbe.viz import picture
from jaxbe.viz.view import View


def check_writable(path: Path) -> None:
    """Checks that a picture can be written, before anything takes long.

    Raises:
        InputError: it cannot, or something else than a picture has that name.
    """
    with _refusals_said(path):
        target = _target(path)
        _check_replaceable(path)
        if target.suffix.lower() != ".png":
            raise _refused(path, "a picture's name ends in .png")
        with _beside(target):
            pass


def check_no_input(path: Path, inputs: Iterable[Path | None], model: Any) -> None:
    """Checks that the picture replaces nothing that was read.

    Args:
        path: of the picture.
        inputs: files that were read.
        model: what was made of the first.

    Raises:
        InputError: it would.
    """
    if not path.exists():
        return
    if any(x is not None and os.path.samefile(path, x) for x in inputs):
        raise _refused(path, "it is an input")
    # Of textures, by name: the folder is not known to every MuJoCo.
    files = os.fsdecode(model.paths).split("\0")
    if _target(path).name in {PureWindowsPath(file).name for file in files}:
        raise _refused(path, "the scene is made of a file of this name")


def draw(model: Any, view: View, path: Path) -> picture.Picture:
    """Draws a state, see `jaxbe.viz.picture`; all of the file changes, or nothing.

    Raises:
        InputError: neither OpenGL nor matplotlib is there, or no room for the file.
    """
    target = _target(path)
    try:
        with _refusals_said(path), _beside(target) as temporary:
            drawn = picture.draw(model, view, temporary)
            if target.exists():
                shutil.copymode(target, temporary)
            temporary.replace(target)
    except ModuleNotFoundError as error:
        raise InputError(error) from None
    return drawn._replace(path=str(path))


def _target(path: Path) -> Path:
    """Where links lead: it is the file that is replaced, and not a link to it."""
    return Path(os.path.realpath(path))


def _check_replaceable(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise _refused(path, "Is a directory")
    if not stat.S_ISREG(mode):
        raise _refused(path, "not a regular file")
    if not os.access(path, os.W_OK):
        raise _refused(path, "Permission denied")


@contextlib.contextmanager
def _beside(target: Path) -> Iterator[Path]:
    """A new file in the same folder, which goes unless it was renamed."""
    temporary = target.with_name(f".jaxbe-{secrets.token_hex(8)}.png")
    temporary.open("xb").close()
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def _refusals_said(path: Path) -> Iterator[None]:
    """Says in one line what the file system refuses."""
    try:
        yield
    except OSError as error:
        raise _refused(path, error.strerror or error) from None


def _refused(path: Path, why: object) -> InputError:
    return InputError(f"cannot write {shown(path)}: {why}")
