"""The command `jaxbe`: all three tests on a real scene, checked against MuJoCo C."""

from __future__ import annotations

import contextlib
import os
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from jaxbe.cli.arguments import Options, parse
from jaxbe.cli.errors import InputError, OutputError, one_line
from jaxbe.cli.output import complain

EXIT_FINE = 0
EXIT_DISAGREE = 1
EXIT_BAD_INPUT = 2
EXIT_UNEXPECTED = 3
EXIT_INTERRUPTED = 130
"""As of a program that SIGINT ends."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: the arguments without the program's name; those of the process if
            None.

    Returns:
        The exit status, 0 fine, 1 tests disagree, 2 bad input, 3 the unexpected, 130
        interrupted.
    """
    try:
        options = parse(argv)
        agree = _import_job()(options)
    except InputError as error:
        return _ended(EXIT_BAD_INPUT, f"error: {error}")
    except OutputError as error:
        return _ended(EXIT_UNEXPECTED, f"error: {error}")
    except KeyboardInterrupt:
        return _ended(EXIT_INTERRUPTED, "interrupted")
    except Exception as error:
        return _ended(EXIT_UNEXPECTED, f"unexpected error: {_description(error)}")
    return EXIT_FINE if agree else EXIT_DISAGREE


def _ended(status: int, line: str) -> int:
    complain(line)
    return status


def _description(error: Exception) -> str:
    """What happened and where: one line, enough to report it."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    kind, place = type(error).__name__, f"{Path(last.filename).name}:{last.lineno}"
    return f"{one_line(f'{kind}: {error}')} ({place})"


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
