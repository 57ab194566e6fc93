"""The point in which box and ellipsoid touch when they are scaled to do so.

Known from the kernel to rounding. From the contact normal it follows too, but loses two
digits for each power of ten of the aspect ratio where rods cross: the derivatives in
the axes need it.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe.components import column, dot, split_matrix, split_vector, vector
from jaxbe.kept import kept, kept_pair
from jaxbe.kernel import nearest
from jaxbe.metric import metric
from jaxbe.pose import CanonicalPair, canonical_pair, in_other_units
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Components, Scalars


class TouchingPoint(NamedTuple):
    """The nearest point x of the scaled box, in box axes and metres.

    Attributes:
        x: from the box's centre; exact on the bounds.
        d: from the ellipsoid's centre.
    """

    x: Components
    d: Components


def touching_point(box: Box, ellipsoid: Ellipsoid, alpha: Scalars) -> TouchingPoint:
    """Of the box scaled by alpha. A value: its derivatives are zero.

    In two loops of their own, which keep d where x is free, and the side of the box
    where it is not.
    """
    box, ellipsoid, alpha = jax.lax.stop_gradient((box, ellipsoid, alpha))
    rank = alpha.ndim
    given = split_vector(ellipsoid.semi_axes, rank)[0]
    pair = canonical_pair(box, ellipsoid)
    p_0, p_1 = kept_pair(*_free_or_side(in_other_units(pair, 32), alpha)[:2], given)
    p_2 = kept(_free_or_side(in_other_units(pair, 64), alpha)[2], given)
    K, C = (split_vector(body.center, rank) for body in (ellipsoid, box))
    U, e = split_matrix(box.axes, rank), split_vector(box.half_extents, rank)
    offset = vector(lambda i: K[i] - C[i])
    k = vector(lambda i: dot(column(U, i), offset))
    p = p_0, p_1, p_2
    bound = vector(lambda i: jnp.sign(p[i]) * alpha * e[i])
    on_side = vector(lambda i: abs(p[i]) >= _side(p[i]))
    return TouchingPoint(
        vector(lambda i: jnp.where(on_side[i], bound[i], k[i] + p[i])),
        vector(lambda i: jnp.where(on_side[i], bound[i] - k[i], p[i])),
    )


def _free_or_side(pair: CanonicalPair, alpha: Scalars) -> Components:
    """D in metres, or a number beyond all lengths with the sign of x."""
    grown = vector(lambda i: alpha * pair.e[i])
    near = nearest(pair.k, grown, metric(pair.R, pair.a))
    return vector(
        lambda i: jnp.where(
            near.active[i],
            jnp.where(near.d[i] + pair.k[i] < 0, -_side(pair.e[i]), _side(pair.e[i])),
            near.d[i] / pair.per_unit,
        )
    )


def _side(x: Scalars) -> float:
    return float(np.finfo(x.dtype).max) / 4
