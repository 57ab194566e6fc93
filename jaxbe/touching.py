"""Where the scaled ellipsoid touches the scaled box, to rounding.

The derivatives in the axes and the semi-axes need the touching point, of_radius S n / s
from the ellipsoid's centre. From the contact normal n it follows, but where rods cross
it loses two digits for each power of ten of the aspect ratio: along a long axis v_p.n
cancels. The kernel knows the point itself; along a short axis that one cancels.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxbe import _xla
from jaxbe.choice import choose, maximum
from jaxbe.components import column, dot, is_zero, largest, matrix, vector
from jaxbe.kernel import Nearest
from jaxbe.pose import CanonicalPair
from jaxbe.types import Components, Scalars


class Touching(NamedTuple):
    """The point, and the support function to its scale.

    Attributes:
        reach: from the ellipsoid's centre, in its axes, in the pair's units.
        radius: s = sqrt(n^T S n) of the very n given. The kernel's sqrt(q) is that of
            an n without rounding, from which a thin plate's differs in its scale.
    """

    reach: Components
    radius: Scalars


def touching(
    pair: CanonicalPair, near: Nearest, n: Components, s: Scalars, factor: Scalars
) -> Touching:
    """By the direction or by the point, for each axis what is more accurate.

    With t_p = a_p v_p.n / s, a unit vector, s follows from the short axes alone, unless
    they are little of it.

    Args:
        pair: the bodies.
        near: the kernel's answer for the scaled box.
        n: the direction, of any length.
        s: its support function, roughly.
        factor: by which the ellipsoid is scaled, of_radius.
    """
    a = pair.a
    # Used before and after: see `jaxbe._xla.stay_fused`.
    R = matrix(lambda i, j: _xla.stay_fused(pair.R[i][j]))
    along = vector(lambda p: dot(column(R, p), n))
    point = vector(lambda p: -dot(column(R, p), near.d))
    size = largest(vector(lambda i: abs(n[i])))
    lengths = largest(vector(lambda i: maximum(abs(near.x[i]), abs(near.d[i]))))
    # Where the box reaches the centre to rounding, there is no point to be had.
    apart = ~is_zero(near.d)
    is_long = vector(
        lambda p: apart & (a[p] * a[p] * (factor * size) > 2 * s * lengths)
    )
    reciprocal = vector(
        lambda p: _xla.stay_fused(1 / (a[p] * choose(factor == 0, 1, factor)))
    )
    t = vector(lambda p: choose(is_long[p], point[p] * reciprocal[p], 0))
    short = vector(lambda p: choose(is_long[p], 0, a[p] * along[p]))
    rest = 1 - dot(t, t)
    every = vector(lambda p: a[p] * along[p])
    alone = _xla.stay_fused(dot(short, short) / rest)
    s = _xla.stay_fused(jnp.sqrt(choose(rest > 0.5, alone, dot(every, every))))
    scale = _xla.stay_fused(factor / choose(s == 0, 1, s))
    reach = vector(
        lambda p: choose(is_long[p], point[p], a[p] * (a[p] * along[p]) * scale)
    )
    return Touching(reach, s)
