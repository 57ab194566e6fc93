"""The canonical pair: the ellipsoid seen from the box, in units of the ellipsoid.

Every answer depends on 18 numbers only: k = U^T (K - C), the ellipsoid's centre
in box coordinates; R = U^T V, its axes there; the half extents e and the
semi-axes a. (Letters as in the paper: C and U are the box's centre and axes, K
and V the ellipsoid's.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jax import lax

from jaxbe import _xla
from jaxbe.components import (
    column,
    dot,
    largest,
    matrix,
    split_matrix,
    split_vector,
    vector,
)
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
    box: Box, ellipsoid: Ellipsoid, witness: Scalars | None = None
) -> CanonicalPair:
    """Expresses the ellipsoid in the frame of the box, and scales.

    K - C is taken first, so the distance of both bodies from the origin costs
    only what the floats given had lost already: at a coordinate x they are
    spaced by eps |x|, and the answer is the right one for those floats.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        witness: for a pair computed anew, see `jaxbe._xla.recompute`. NaN makes the
            pair NaN.

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
    if witness is not None:
        C, K, e, a, *U_rows = (
            vector(lambda i: _xla.recompute(x[i], witness))  # noqa: B023
            for x in (C, K, e, a, *U)
        )
        U = (U_rows[0], U_rows[1], U_rows[2])
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


def recomputed_pair(
    box: Box, ellipsoid: Ellipsoid, known: CanonicalPair, witness: Scalars
) -> CanonicalPair:
    """The canonical pair, for a computation that shares nothing else with others.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        known: their canonical pair.
        witness: see `jaxbe._xla.recompute`. NaN makes the pair NaN.
    """
    anew = canonical_pair(box, ellipsoid, witness)
    return _xla.recomputed(anew, known, witness)


def runtime_witness(pair: CanonicalPair) -> Scalars:
    """An array of the whole batch, for `jaxbe._xla`: constant only if all of it is.

    NaN only where k is.
    """
    return _xla.runtime_witness((*pair.k, pair.R[0][0], *pair.e, *pair.a))


def in_units(pair: CanonicalPair, factor: float) -> CanonicalPair:
    """All lengths times a power of two, or as they are: no answer depends on it.

    For a computation that shares nothing with others, see `jaxbe._xla.in_units`.
    """
    k, e, a = (
        vector(lambda i: _xla.in_units(x[i], factor))  # noqa: B023
        for x in (pair.k, pair.e, pair.a)
    )
    return CanonicalPair(k, pair.R, e, a, _xla.in_units(pair.per_unit, factor))


def materialised(
    function: Callable[[CanonicalPair], Sequence[Scalars]],
    pair: CanonicalPair,
    factors: Sequence[float],
    witness: Scalars,
) -> list[Scalars]:
    """What a function of the pair returns, each array computed once.

    Args:
        function: returns the same in any units.
        pair: the bodies.
        factors: units for every two of the results, see `in_units`.
        witness: see `jaxbe._xla.materialise_once`.
    """
    results: list[Scalars] = []
    for i, factor in enumerate(factors):
        part = function(in_units(pair, factor))[2 * i : 2 * i + 2]
        results += _xla.materialise(part, witness)
    return results


def reciprocal_power_of_two(x: Scalars) -> Scalars:
    """1 / 2^floor(log2 x), exactly, from the exponent bits; a constant to autodiff.

    Exact for normal x up to a quarter of the largest float; finite and positive
    for every x that is not NaN. (`exp2` and `log2` are not exact.)
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
