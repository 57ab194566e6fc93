"""Whether the README's figures are those of the results files.

    python -m tests.readme_figures

prints every sentence that does not agree, and what it should be. The sentences are in
`tests.readme_claims` and `tests.readme_speeds`.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tests.readme_format import About

ROOT = Path(__file__).parents[1]
RESULTS = Path("benchmarks/results")

FIGURE = r"([^|]{1,90}?)"
"""What stands for {} in a claim: no more than a cell or some words."""


class Claim(NamedTuple):
    """A sentence of the README, {} where it has figures, and what they should be."""

    text: str
    figures: tuple[str | About, ...]

    def expected(self) -> str:
        return self.text.format(*self.figures)


Claims = Iterator[tuple[Any, ...]]
SOURCES: dict[Callable[..., Claims], tuple[str, ...]] = {}
"""What yields claims, and the results files it reads."""


def of(*names: str) -> Callable[[Callable[..., Claims]], Callable[..., Claims]]:
    """Registers a function of these results that yields (text, figure, figure, ...)."""

    def register(function: Callable[..., Claims]) -> Callable[..., Claims]:
        SOURCES[function] = names
        return function

    return register


def files(function: Callable[..., Claims]) -> list[Path]:
    """The results it reads, from the repository's root."""
    return [RESULTS / f"{name}-cpu.json" for name in SOURCES[function]]


def claims(function: Callable[..., Claims]) -> list[Claim]:
    """The function's claims, from the results in the repository."""
    results = [json.loads((ROOT / f).read_text()) for f in files(function)]
    return [Claim(text, tuple(figures)) for text, *figures in function(*results)]


def readme() -> str:
    """The README, every run of white space a blank."""
    return " ".join((ROOT / "README.md").read_text().split())


def find(claim: Claim, text: str) -> list[re.Match[str]]:
    """Where the text has the claim, with any figures."""
    literals = map(re.escape, claim.text.split("{}"))
    return list(re.finditer(FIGURE.join(literals), text))


def problem(claim: Claim, text: str) -> str | None:
    """What is wrong with the claim in the text; None if nothing."""
    found = find(claim, text)
    if len(found) != 1:
        return f"is in the README {len(found)} times: {claim.expected()}"
    pairs = list(zip(claim.figures, found[0].groups(), strict=True))
    if all(right == written for right, written in pairs):
        return None
    return f"README:  {found[0].group()}\n    results: {claim.expected()}"


def problems(function: Callable[..., Claims], text: str) -> list[str]:
    """Of all of a function's claims."""
    missing = [str(f) for f in files(function) if not (ROOT / f).exists()]
    if missing:
        return [f"no results: {', '.join(missing)}"]
    every = (problem(claim, text) for claim in claims(function))
    return [one for one in every if one]


def main() -> int:
    """Prints all problems; returns how many."""
    text, count = readme(), 0
    for function in SOURCES:
        for one in problems(function, text):
            count += 1
            print(f"{', '.join(map(str, files(function)))}:\n    {one}")
    print(f"{count} claims differ")
    return count


if __name__ == "__main__":
    # Run as a script, this file is another module than the one that claims register in.
    from tests import readme_claims, readme_placing, readme_speeds  # noqa: F401
    from tests.readme_figures import main as registered

    sys.exit(bool(registered()))
