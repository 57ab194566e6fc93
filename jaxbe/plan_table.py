"""The table of `jaxbe.plan`: what settings cost, and how wrong they were.

Written by `python -m benchmarks` (see `benchmarks/frontier.py`).
"""

from __future__ import annotations

import functools
import json
import math
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from jaxbe.scene_facts import SceneFacts


class Settings(dict[str, Any]):
    """Keyword arguments that stay as they are: hashed, copied, stored like a tuple."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError("the settings of a plan cannot be changed")

    __setitem__ = __delitem__ = __ior__ = _refuse  # type: ignore[assignment]
    update = pop = popitem = clear = setdefault = _refuse  # type: ignore[assignment]

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return Settings, (dict(self),)


class Measured(NamedTuple):
    """A line of the table.

    Attributes:
        keywords: the options of the function.
        dtype: of the inputs.
        gradients: whether with derivatives.
        nanoseconds: for a pair.
        spreads: the upper ones (see `SceneFacts`) that `errors` is for.
        errors: by kind of answer a row for each spread, a column for each share.
        errors_of_spheres: likewise, one row.
    """

    keywords: dict[str, Any]
    dtype: str
    gradients: bool
    nanoseconds: float
    spreads: list[float]
    errors: dict[str, list[list[float]]]
    errors_of_spheres: dict[str, list[list[float]]]

    def error(self, answer: str | None, column: int, scene: SceneFacts) -> float:
        """Interpolated between the spreads; infinite beyond them."""
        spread = float(scene.upper_spread or scene.spread)
        if spread > self.spreads[-1]:
            return math.inf
        if scene.spheres:
            return self.errors_of_spheres[str(answer)][0][column]
        errors = [row[column] for row in self.errors[str(answer)]]
        following = min(int(np.searchsorted(self.spreads, spread)), len(errors) - 1)
        if not all(errors[max(following - 1, 0) : following + 1]):
            return errors[following]
        logarithms = np.log(np.maximum(errors, np.finfo(float).tiny))
        found = np.interp(math.log(spread), np.log(self.spreads), logarithms)
        return float(np.exp(found))


@functools.cache
def frontier() -> dict[str, Any]:
    """The whole file."""
    file = resources.files("jaxbe").joinpath("frontier.json")
    table: dict[str, Any] = json.loads(file.read_text())
    return table


@functools.cache
def lines(function: str) -> tuple[Measured, ...]:
    """The lines of one function."""
    spreads = frontier()["spreads"]
    return tuple(
        Measured(
            keywords={k: row[k] for k in ("steps", "method") if k in row},
            dtype=row["dtype"],
            gradients=row["gradients"],
            nanoseconds=row["nanoseconds"],
            spreads=spreads,
            errors=row["errors"],
            errors_of_spheres=row["errors_of_spheres"],
        )
        for row in frontier()["settings"]
        if row["function"] == function
    )
