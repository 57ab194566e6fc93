"""How far from touching rounding can change an answer."""

from __future__ import annotations

import numpy as np

from jaxbe.cli.states import Floats

MODERATE_SPREAD, LARGE_SPREAD = 40, 1000

_RATIO_ROUNDING = {"float32": (1e-5, 1e-4), "float64": (1e-12, 1e-10)}
"""As documented of `jaxbe.overlap`, to either spread."""


def ratio_rounding(half_extents: Floats, semi_axes: Floats, dtype: str) -> Floats:
    """How near 1 a `scaled_distance` must be for rounding to decide the answer.

    By the spread: the longest length over the smallest semi-axis. Beyond 1000, for
    which nothing is promised, it grows in proportion.

    Args:
        half_extents: (n, 3) of the box.
        semi_axes: (n, 3) of the ellipsoid.
        dtype: what the tests compute in.

    Returns:
        (n,)
    """
    fine, coarse = _RATIO_ROUNDING[dtype]
    longest = np.maximum(half_extents.max(axis=1), semi_axes.max(axis=1))
    with np.errstate(over="ignore"):
        spread = longest / semi_axes.min(axis=1)
    growth = np.maximum(1, spread / LARGE_SPREAD)
    return np.where(spread <= MODERATE_SPREAD, fine, coarse * growth)


def rounding_in_metres(
    centers: Floats, half_extents: Floats, semi_axes: Floats, dtype: str
) -> Floats:
    """How far from touching, in metres, rounding can change an answer.

    The ratio's rounding, times the largest semi-axis: growing the ellipsoid about
    its centre by a factor 1 + r moves no point of it further than r times that.
    And the rounding of the poses to the dtype: of both positions, and of the axes
    times the lengths along them.

    Args:
        centers: (n, 2, 3) of both bodies, metres, world frame.
        half_extents: (n, 3) of the box.
        semi_axes: (n, 3) of the ellipsoid.
        dtype: what the tests compute in.

    Returns:
        (n,)
    """
    eps = float(np.finfo(dtype).eps)
    lengths = abs(centers).sum(axis=(1, 2)) + half_extents.sum(1) + semi_axes.sum(1)
    growth = ratio_rounding(half_extents, semi_axes, dtype) * semi_axes.max(axis=1)
    return np.asarray(growth + eps * lengths)
