"""What is known of a scene before it runs: its sizes, not its poses."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np

from jaxbe.pose import batch_shape
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.validate import as_number

SAME = 1e-6
"""Semi-axes that differ by less, relatively, are those of a sphere."""


@dataclasses.dataclass(frozen=True)
class SceneFacts:
    """Static facts of a scene, for `jaxbe.plan`.

    Attributes:
        spread: the longest half extent or semi-axis of a pair over its smallest
            semi-axis, the largest of all pairs; at least 1.
        upper_spread: the geometric mean of the largest tenth of the pairs' spreads,
            what errors go by; the largest spread if None.
        spheres: whether all ellipsoids are spheres.
    """

    spread: float
    upper_spread: float | None = None
    spheres: bool = False

    def __post_init__(self) -> None:
        spread = as_number("spread", self.spread)
        if not spread >= 1:
            raise ValueError(f"spread must be at least 1, got {self.spread}")
        given = spread if self.upper_spread is None else self.upper_spread
        typical = as_number("upper_spread", given)
        if not 1 <= typical <= spread:
            raise ValueError(f"upper_spread must be from 1 to {spread}, got {typical}")
        object.__setattr__(self, "spread", spread)
        object.__setattr__(self, "upper_spread", typical)


def scene_facts(box: Box, ellipsoid: Ellipsoid) -> SceneFacts:
    """The facts of a batch of pairs; reads half extents and semi-axes only.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.

    Raises:
        TypeError: arguments that are not a Box and an Ellipsoid of one dtype, or
            lengths that are traced: facts are static.
        ValueError: batch shapes that do not broadcast, no pair, or semi-axes that are
            not positive or not finite.
    """
    batch = batch_shape(box, ellipsoid)
    if 0 in batch:
        raise ValueError(f"the batch shape {batch} has no pair, so there are no facts")
    return facts_of_lengths(box.half_extents, ellipsoid.semi_axes)


def facts_of_lengths(half_extents: Any, semi_axes: Any) -> SceneFacts:
    """The facts of lengths (..., 3), of shapes that broadcast."""
    for name, given in (("half_extents", half_extents), ("semi_axes", semi_axes)):
        if isinstance(given, jax.core.Tracer):
            raise TypeError(f"{name} must be known when a plan is made, got a tracer")
    e, a = (np.asarray(x, np.float64) for x in (half_extents, semi_axes))
    if not (np.all(np.isfinite(e)) and np.all(np.isfinite(a)) and np.all(a > 0)):
        raise ValueError("lengths must be finite, and semi_axes positive")
    smallest, largest = a.min(axis=-1), a.max(axis=-1)
    longest = np.maximum(e.max(axis=-1), largest)
    spread = np.sort((longest / smallest).ravel())
    upper = spread[-max(1, spread.size // 10) :]
    return SceneFacts(
        spread=float(spread[-1]),
        upper_spread=min(float(np.exp(np.mean(np.log(upper)))), float(spread[-1])),
        spheres=bool(np.all(largest <= smallest * (1 + SAME))),
    )
