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


class Measured(NamedTuple):
    """A line of the table.

    Attributes:
        keywords: the options of the function.
        dtype: of the inputs.
        gradients: whether with derivatives.
        nanoseconds: for a pair.
        spreads: those that `errors` is for.
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
        if scene.spheres and scene.spread <= self.spreads[-1]:
            return self.errors_of_spheres[str(answer)][0][column]
        if scene.spread > self.spreads[-1]:
            return math.inf
        errors = [row[column] for row in self.errors[str(answer)]]
        if not all(errors):
            following = np.searchsorted(self.spreads, scene.spread)
            return errors[int(following)]
        logarithm = np.interp(
            math.log(scene.spread), np.log(self.spreads), np.log(errors)
        )
        return float(np.exp(logarithm))


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
