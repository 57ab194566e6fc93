"""`margin`: by how much do they touch? A smooth signed quantity."""

from __future__ import annotations

import operator

from jaxbe.growth import MAX_STEPS, growth_bounds, growth_distance
from jaxbe.pose import canonical_pair
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Scalars

DEFAULT_STEPS = 5


def margin(box: Box, ellipsoid: Ellipsoid, *, steps: int = DEFAULT_STEPS) -> Scalars:
    """The growth distance minus one."""
    return growth_distance(canonical_pair(box, ellipsoid), _count(steps)) - 1


def margin_bounds(
    box: Box, ellipsoid: Ellipsoid, *, steps: int = DEFAULT_STEPS
) -> tuple[Scalars, Scalars]:
    """A lower and an upper bound of the margin."""
    lower, upper = growth_bounds(canonical_pair(box, ellipsoid), _count(steps))
    return lower - 1, upper - 1


def _count(steps: int) -> int:
    try:
        count = operator.index(steps)
    except TypeError:
        raise TypeError(f"steps must be a Python integer, got {steps!r}") from None
    if not 0 <= count <= MAX_STEPS:
        raise ValueError(f"steps must be from 0 to {MAX_STEPS}, got {count}")
    return count
