"""The command `jaxbe`: all three tests on a real scene, checked against MuJoCo C."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence

from jaxbe.cli.arguments import Options, parse
from jaxbe.cli.errors import InputError

EXIT_FINE = 0
EXIT_DISAGREE = 1
EXIT_BAD_INPUT = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: the arguments without the program's name; those of the process if
            None.

    Returns:
        The exit status, 0 fine, 1 tests disagree, 2 bad input.
    """
    try:
        options = parse(argv)
        agree = _import_job()(options)
    except InputError as error:
        print(f"jaxbe: error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return EXIT_FINE if agree else EXIT_DISAGREE


def _import_job() -> Callable[[Options], bool]:
    """Imports what needs the extra `mjx`, so that `--help` works without it."""
    try:
        with _without_opengl():
            from jaxbe.cli.job import run
    except ModuleNotFoundError as error:
        if error.name not in ("mujoco", "rich"):
            raise
        raise InputError(
            f"the command line needs {error.name}: pip install 'jaxbe[mjx]'"
        ) from None
    return run


@contextlib.contextmanager
def _without_opengl() -> Iterator[None]:
    """Where MUJOCO_GL asks for a library that is missing, `import mujoco` fails."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]
        if before is not None:
            os.environ["MUJOCO_GL"] = before
