"""The direction in which two bodies, grown until they touch, touch."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxbe.choice import choose
from jaxbe.components import column, dot, is_zero, largest, times, vector, where
from jaxbe.kernel import Nearest, nearest
from jaxbe.metric import active_inverse, metric
from jaxbe.pose import CanonicalPair
from jaxbe.support import along_axes, extent
from jaxbe.touching import touching
from jaxbe.types import ComponentMatrix, Components, Flags, Scalars


class ContactNormal(NamedTuple):
    """A direction with e.|n| + radius = 1.

    Attributes:
        n: in box axes, from the box to the ellipsoid.
        radius: sqrt(n^T S n), the support function of the ellipsoid.
    """

    n: Components
    radius: Scalars


@jax.custom_jvp
def contact_normal(pair: CanonicalPair, alpha: Scalars) -> ContactNormal:
    """The direction that attains the growth distance alpha.

    Where the grown box reaches the centre to rounding (a needle seen end on beside
    a huge box, or coincident centres) it is the best face normal of the box.
    """
    near = _nearest(pair, alpha)
    n, radius = _multipliers(pair, near)
    total = extent(n, pair.e) + radius
    radius = touching(pair, near, n, radius, alpha).radius
    # Each by a division of its own: a quotient with three uses would be computed apart.
    return ContactNormal(vector(lambda i: n[i] / total), radius / total)


def contact_reach(pair: CanonicalPair, alpha: Scalars) -> Components:
    """Where the scaled ellipsoid touches, from its centre, in its axes."""
    near = _nearest(pair, alpha)
    return touching(pair, near, *_multipliers(pair, near), alpha).reach


@contact_normal.defjvp
def _contact_normal_jvp(primals: Any, tangents: Any) -> Any:
    """n_A = S_AA^-1 (k - sign(n) alpha e)_A on the active set A, differentiated.

    The formulas of the kernel take S and N for inverses of each other, which holds
    along rotations only; this one is right in all entries of the axes.
    """
    pair, alpha = primals
    near = _nearest(pair, alpha)
    n, _ = _multipliers(pair, near)
    d_n = _multipliers_tangent(primals, tangents, near)
    # A face normal stays where it is.
    d_n = vector(lambda i: choose(is_zero(near.n), 0, d_n[i]))
    size = largest(vector(lambda i: abs(n[i])))
    _, tangent = jax.jvp(
        _scaled,
        (pair, vector(lambda i: n[i] / size)),
        (tangents[0], vector(lambda i: d_n[i] / size)),
    )
    return contact_normal(pair, alpha), tangent


def _nearest(pair: CanonicalPair, alpha: Scalars) -> Nearest:
    grown = vector(lambda i: alpha * pair.e[i])
    return nearest(pair.k, grown, metric(pair.R, pair.a))


def _multipliers(pair: CanonicalPair, near: Nearest) -> tuple[Components, Scalars]:
    """A direction, to some scale, and the ellipsoid's support function there."""
    lost = is_zero(near.n)
    width = metric(pair.R, pair.a).width
    face = _face_normal(pair, width)
    on_face = dot(vector(lambda i: abs(face[i])), width)
    # Of a free coordinate nothing but rounding can be left.
    n = vector(lambda i: choose(near.active[i], near.n[i], 0))
    return where(lost, face, n), choose(lost, on_face, jnp.sqrt(near.q))


def _multipliers_tangent(primals: Any, tangents: Any, near: Nearest) -> Components:
    """The tangent of the kernel's n."""
    pair, alpha = primals
    d_pair, d_alpha = tangents
    n = near.n
    inverse = active_inverse(near.active, metric(pair.R, pair.a))
    _, d_Sn = jax.jvp(
        lambda R, a: _shape_times(n, R, a), (pair.R, pair.a), (d_pair.R, d_pair.a)
    )
    sign = vector(lambda i: jnp.sign(n[i]))
    right = vector(
        lambda i: (
            d_pair.k[i]
            - sign[i] * (d_alpha * pair.e[i] + alpha * d_pair.e[i])
            - d_Sn[i]
        )
    )
    right = vector(lambda i: choose(near.active[i], right[i], 0))
    return vector(lambda i: choose(near.active[i], dot(inverse[i], right), 0))


def _scaled(pair: CanonicalPair, n: Components) -> ContactNormal:
    """The direction n with the support functions written out, for its derivative."""
    terms = along_axes(pair, n)
    radius = jnp.sqrt(dot(terms, terms))
    total = extent(n, pair.e) + radius
    return ContactNormal(vector(lambda i: n[i] / total), radius / total)


def _shape_times(n: Components, R: ComponentMatrix, a: Components) -> Components:
    """S n."""
    weighted = vector(lambda p: a[p] * a[p] * dot(column(R, p), n))
    return times(R, weighted)


def _face_normal(pair: CanonicalPair, width: Components) -> Components:
    """The face normal of the box, signed towards the ellipsoid, that gave step 0."""
    distance = vector(lambda i: abs(pair.k[i]))
    reach = vector(lambda i: pair.e[i] + width[i])

    def beats(i: int, j: int) -> Flags:
        """The larger quotient distance / reach, without a division."""
        return distance[i] * reach[j] >= distance[j] * reach[i]

    first = beats(0, 1) & beats(0, 2)
    second = ~first & beats(1, 2)
    chosen = (first, second, ~first & ~second)
    sign = vector(lambda i: choose(pair.k[i] < 0, -1, 1).astype(pair.k[i].dtype))
    return vector(lambda i: choose(chosen[i], sign[i], 0))
