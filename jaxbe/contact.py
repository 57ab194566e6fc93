"""`contact`: distance, normal and witness points, what a physics engine needs."""

from __future__ import annotations

from typing import NamedTuple

from jaxbe.closest import closest
from jaxbe.components import split_matrix, split_vector, stack, times, vector
from jaxbe.distance import DEFAULT_STEPS, MAX_STEPS, witness_points
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Components, Scalars, Vectors
from jaxbe.validate import as_count


class Contact(NamedTuple):
    """How two bodies touch, or would.

    Attributes:
        distance: `signed_distance`, metres.
        position: (..., 3), world frame: half way between the witness points.
        normal: (..., 3), world frame, unit: from the ellipsoid to the box.
        on_box: (..., 3), world frame: the box's witness point.
        on_ellipsoid: (..., 3), world frame: the ellipsoid's.
    """

    distance: Scalars
    position: Vectors
    normal: Vectors
    on_box: Vectors
    on_ellipsoid: Vectors


def contact(box: Box, ellipsoid: Ellipsoid, *, steps: int = DEFAULT_STEPS) -> Contact:
    """The signed distance with its direction and points.

    Apart, the witness points are the nearest ones. Overlapping, they are the deepest
    ones along the shortest way out that was found: moving the ellipsoid by the distance
    along the normal makes the bodies touch, there.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        steps: as for `signed_distance`.

    Returns:
        A `Contact` of the common batch shape. NaN if any number is NaN or infinite.

        The points are in the bodies, to rounding, and on_box - on_ellipsoid is distance
        times normal: for pairs apart, of 30,000 with lengths from 0.05 to 2 m, within
        1e-14 of their size and distance in float64 and 3e-6 in float32, where each
        point is right to as much; from 0.001 to 1 m within 1e-6 and 3e-5; of needles
        of aspect ratio 1000 within 3e-5 and 1e-3. Round and aligned bodies do not
        differ. For pairs that overlap it holds as far as the search for the way out has
        come: within 1e-4 in 99.8 %, 0.1 at most (from 0.001 to 1 m 99.5 % and 0.1;
        needles 97 % and 0.4); on_box is then the point of the box that is nearest to
        fulfilling it.

        Derivatives of the distance are those of `signed_distance`; those of normal and
        points follow from the equations that they solve, by one step of Newton's
        method. They are finite, and first ones only. Where the answer has none (a
        change of feature, several ways out equally short) they are one-sided: those of
        the feature found.

    Raises:
        TypeError: as `signed_distance`.
        ValueError: as `signed_distance`.
    """
    steps = as_count("steps", steps, 1, MAX_STEPS)
    found = closest(box, ellipsoid, steps)
    n, distance = found
    x, d = witness_points(box, ellipsoid, found)
    on_box, on_ellipsoid = _from_center(box, _turned(box, x)), _from_center(box, d)
    return Contact(
        distance=distance,
        position=stack(vector(lambda r: (on_box[r] + on_ellipsoid[r]) / 2)),
        normal=stack(_turned(box, vector(lambda i: -n[i]))),
        on_box=stack(on_box),
        on_ellipsoid=stack(on_ellipsoid),
    )


def _turned(box: Box, x: Components) -> Components:
    """U x."""
    return times(split_matrix(box.axes, x[0].ndim), x)


def _from_center(box: Box, d: Components) -> Components:
    """C + d."""
    C = split_vector(box.center, d[0].ndim)
    return vector(lambda r: C[r] + d[r])
