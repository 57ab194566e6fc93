"""The canonical pair: the ellipsoid seen from the box, in units of the ellipsoid.

Every answer depends on 18 numbers only: k = U^T (K - C), the ellipsoid's centre
in box coordinates; R = U^T V, its axes there; the half extents e and the
semi-axes a. (Letters as in the paper: C and U are the box's centre and axes, K
and V the ellipsoid's.)
"""

from __future__ import annotations

import functools
import operator
from typing import NamedTuple

import numpy as np
from jax import lax

from jaxbe.components import (
    column,
    dot,
    largest,
    matrix,
    split_matrix,
    split_vector,
    vector,
)
from jaxbe.kept import opaque_one
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import ComponentMatrix, Components, Scalars


class CanonicalPair(NamedTuple):
    """k, R, e and a (see above) as components, each an array over the batch.

    Lengths are in units of a power of two near the largest semi-axis, `per_unit` to
    the metre: scaling a scene by a power of two changes no bit of k, R, e and a.
    """

    k: Components
    R: ComponentMatrix
    e: Components
    a: Components
    per_unit: Scalars


def canonical_pair(
    box: Box, ellipsoid: Ellipsoid, one: Scalars | None = None
) -> CanonicalPair:
    """Expresses the ellipsoid in the frame of the box, and scales.

    K - C is taken first, so the distance of both bodies from the origin costs
    only what the floats given had lost already: at a coordinate x they are
    spaced by eps |x|, and the answer is the right one for those floats.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        one: a factor of the numbers given, see `canonical_pair_again`.

    Returns:
        Components that broadcast to the common batch shape. A NaN or an
        infinity in any argument makes k NaN.

    Raises:
        TypeError: an argument of the wrong class, or of two dtypes.
        ValueError: batch shapes that do not broadcast.
    """
    rank = len(batch_shape(box, ellipsoid))
    C, K = split_vector(box.center, rank), split_vector(ellipsoid.center, rank)
    U, V = split_matrix(box.axes, rank), split_matrix(ellipsoid.axes, rank)
    e = split_vector(box.half_extents, rank)
    a = split_vector(ellipsoid.semi_axes, rank)
    if one is not None:
        C, K, e, a = (vector(lambda i: x[i] * one) for x in (C, K, e, a))  # noqa: B023
        U = matrix(lambda i, j: U[i][j] * one)
    per_unit = reciprocal_power_of_two(largest(a))
    offset = vector(lambda i: (K[i] - C[i]) * per_unit)
    e = vector(lambda i: e[i] * per_unit)
    a = vector(lambda i: a[i] * per_unit)
    k = vector(lambda i: dot(column(U, i), offset))
    R = matrix(lambda i, j: dot(column(U, i), column(V, j)))
    # Zero, but NaN if any length, coordinate or axis is NaN or infinite.
    lengths = k[0] + k[1] + k[2] + e[0] + e[1] + e[2] + a[0] + a[1] + a[2]
    poison = 0 * (lengths + (R[0][0] + R[0][1] + R[0][2]))
    return CanonicalPair(vector(lambda i: k[i] + poison), R, e, a, per_unit)


def canonical_pair_again(
    box: Box, ellipsoid: Ellipsoid, given: Scalars
) -> CanonicalPair:
    """The canonical pair, for a loop of its own.

    XLA writes down and reads again, in dozens of arrays, what two loops share. It does
    not see that this is the pair that other loops have: they read the bodies again.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        given: an array at hand, of the whole batch, another one for each loop; best
            one that the loop needs anyway. NaN makes the pair NaN.
    """
    return canonical_pair(box, ellipsoid, opaque_one(given))


def of_all(pair: CanonicalPair) -> Scalars:
    """An array of the whole batch, for `jaxbe.kept`: constant only if all of it is.

    What is constant inside `jit`, or the same for many pairs, keeps nothing there. NaN
    only where k is.
    """
    return functools.reduce(operator.add, (*pair.k, pair.R[0][0], *pair.e, *pair.a))


def in_other_units(pair: CanonicalPair, factor: float) -> CanonicalPair:
    """All lengths multiplied by a power of two, which changes no answer.

    XLA writes down and reads again, in dozens of arrays, what two loops share. Loops
    in different units share little; `canonical_pair_again` leaves nothing to share.
    """
    k, e, a = (
        (x * factor, y * factor, z * factor) for x, y, z in (pair.k, pair.e, pair.a)
    )
    return CanonicalPair(k, pair.R, e, a, pair.per_unit * factor)


def reciprocal_power_of_two(x: Scalars) -> Scalars:
    """1 / 2^floor(log2 x), exactly, from the exponent bits; a constant to autodiff.

    Exact for normal x up to a quarter of the largest float; finite and positive
    for every x that is not NaN. (`exp2` and `log2` are not exact under XLA.)
    """
    info = np.finfo(x.dtype)
    integer = np.dtype(f"int{info.bits}").type
    bits = lax.bitcast_convert_type(lax.stop_gradient(x), integer)
    exponents = integer(((1 << info.iexp) - 1) << info.nmant)
    twice_bias = integer(((1 << info.iexp) - 2) << info.nmant)
    return lax.bitcast_convert_type(twice_bias - (bits & exponents), x.dtype)


def batch_shape(box: Box, ellipsoid: Ellipsoid) -> tuple[int, ...]:
    """The common batch shape.

    Raises:
        TypeError: an argument of the wrong class, or of two dtypes.
        ValueError: batch shapes that do not broadcast.
    """
    for name, kind, body in (("box", Box, box), ("ellipsoid", Ellipsoid, ellipsoid)):
        if not isinstance(body, kind):
            raise TypeError(
                f"{name} must be a jaxbe.{kind.__name__}, got {type(body).__name__}"
            )
    shapes = box.check_form(), ellipsoid.check_form()
    dtypes = box.center.dtype, ellipsoid.center.dtype
    if dtypes[0] != dtypes[1]:
        raise TypeError(
            f"box and ellipsoid must have one dtype, got {dtypes[0]} and {dtypes[1]}"
        )
    try:
        return lax.broadcast_shapes(*shapes)
    except ValueError:
        raise ValueError(
            "the batch shapes of box and ellipsoid must broadcast, "
            f"got {shapes[0]} and {shapes[1]}"
        ) from None
