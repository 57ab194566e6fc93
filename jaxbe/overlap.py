"""`overlap`: do they touch? One entry point for the three tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

from jaxbe import all_features, closest_features, minkowski
from jaxbe.metric import Metric, metric
from jaxbe.pose import canonical_pair
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Components, Flags

Method = Literal["closest_features", "all_features", "minkowski"]

METHODS: tuple[Method, ...] = get_args(Method)
"""The three tests, as `overlap` calls them."""

_TESTS: dict[str, Callable[[Components, Components, Metric], Flags]] = {
    "closest_features": closest_features.overlaps,
    "all_features": all_features.overlaps,
    "minkowski": minkowski.overlaps,
}


def overlap(
    box: Box, ellipsoid: Ellipsoid, *, method: Method = "closest_features"
) -> Flags:
    """Whether a box and an ellipsoid overlap. Both are solid and closed.

    The three methods are exact, branch-free and give the same answer by different
    routes (sections 2, 3 and 5 of the paper, corrected). `closest_features` and
    `minkowski` are about equally fast, `all_features` is somewhat slower.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        method: "closest_features", "all_features" or "minkowski".

    Returns:
        Booleans of the common batch shape. Touching overlaps. A pair with a NaN or
        an infinity counts as overlapping: what cannot be decided is kept. Zero
        half extents (plate, rod, point) are legal.

        Accuracy: the verdict is right wherever the ratio sqrt(q) of
        `scaled_distance` differs from 1 by more than 1e-5 in float32 at spreads to
        40, 1e-4 to 1000; in float64 1e-12 and 1e-10. The spread is the longest half
        extent or semi-axis, or the distance of the centres if that is longer, over
        the smallest semi-axis: a box much larger than the ellipsoid widens the band
        in proportion. Aspect ratios of the ellipsoid above 1e9 leave float32: such a
        pair counts as overlapping if it cannot be decided.

    Raises:
        TypeError: arguments that are not a Box and an Ellipsoid of one dtype.
        ValueError: batch shapes that do not broadcast, or an unknown method.

    Source:
        D. Eberly, "Intersection of Box and Ellipsoid", 1998-2014.
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    pair = canonical_pair(box, ellipsoid)
    return _TESTS[method](pair.k, pair.e, metric(pair.R, pair.a))
