"""Tables, files and the progress bar that the benchmark scripts share."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table that also reads well as text; numbers stand to the right."""
    columns = list(zip(header, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    right = [all(map(_is_number, column[1:])) for column in columns]
    lines = [_line(row, widths, right) for row in (header, *rows)]
    rule = [("-" * (w - r)) + ":" * r for w, r in zip(widths, right, strict=True)]
    return "\n".join([lines[0], f"| {' | '.join(rule)} |", *lines[1:]])


def machine_lines(machine: Mapping[str, Any]) -> str:
    """The machine in one sentence."""
    return ", ".join(f"{name} {value}" for name, value in machine.items()) + "."


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Adds --json and --markdown."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers")
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="write the report"
    )


def command() -> str:
    """The command line of this process, but for Python's own folder."""
    return shlex.join(["python", *sys.orig_argv[1:]])


def write(options: argparse.Namespace, text: str, numbers: Mapping[str, Any]) -> None:
    """Prints the report and the command that made it; writes the files asked for."""
    text = f"{text}\n\n`{command()}`"
    print(text)
    if options.markdown:
        options.markdown.write_text(text + "\n")
    if options.json:
        found = {"command": command(), **numbers}
        options.json.write_text(json.dumps(found, indent=1) + "\n")


def progress_bar() -> Progress:
    """A bar on stderr, so that stdout holds the report alone."""
    return Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
    )


def _is_number(cell: str) -> bool:
    return not cell or cell[0].isdigit()


def _line(row: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    cells = [
        cell.rjust(w) if r else cell.ljust(w)
        for cell, w, r in zip(row, widths, right, strict=True)
    ]
    return f"| {' | '.join(cells)} |"
