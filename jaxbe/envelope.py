"""Derivatives of everything that is a maximum over a direction n.

The margin, the scaled distance and the distance are maxima over n of expressions in

    n.k,   E = e.|n|,   s = sqrt(n^T S n),

the last two the support functions of the box and of the ellipsoid. By the envelope
theorem the derivative of the maximum is that of the expression with the best n held.
It is written out here, one array a field, on what `jaxbe.kept` keeps.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxbe.components import split_vector, stack, with_rank
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.touching import TouchingPoint
from jaxbe.types import Components, Scalars


def directional_derivative(
    bodies: tuple[Box, Ellipsoid],
    tangents: tuple[Box, Ellipsoid],
    n: Components,
    radius: Scalars,
    *,
    of_extent: Scalars,
    of_radius: Scalars,
    contact: TouchingPoint | None = None,
) -> Scalars:
    """n.k - of_extent * E - of_radius * s, differentiated with n and the factors held.

    Args:
        bodies: box and ellipsoid, in metres; the letters are those of `jaxbe.pose`.
        tangents: in their structure.
        n: the direction in box axes, divided by whatever divides the expression.
        radius: s at n; anything where n is zero.
        of_extent: the factor of the box's support function.
        of_radius: the factor of the ellipsoid's.
        contact: x - k for the point x in which the scaled bodies touch, in box axes and
            metres: minus of_radius S n / s. Taken from n where it is not given, which
            loses digits where rods cross: two for each power of ten of the aspect
            ratio.
    """
    gradients = _gradients(bodies, n, radius, of_extent, of_radius, contact)
    pairs = zip(jax.tree.leaves(tangents), gradients, strict=True)
    rank = radius.ndim
    terms = (_contract(d, gradient, rank) for d, gradient in pairs)
    return functools.reduce(operator.add, terms)


def _gradients(
    bodies: tuple[Box, Ellipsoid],
    n: Components,
    radius: Scalars,
    of_extent: Scalars,
    of_radius: Scalars,
    contact: TouchingPoint | None,
) -> tuple[jax.Array, ...]:
    """The derivatives in C, U, e, K, V and a.

    With w = U n, the direction in world axes, and v_p.w its components along the
    ellipsoid's axes, s = sqrt(sum (a_p v_p.w)^2) changes by (a_p v_p.w / s) (v_p.w)
    with a_p, and by reach_p w = (a_p v_p.w / s) a_p w with v_p.
    """
    box, ellipsoid = bodies
    rank = radius.ndim
    U, V = with_rank(box.axes, rank + 2), with_rank(ellipsoid.axes, rank + 2)
    a = with_rank(ellipsoid.semi_axes, rank + 1)
    K, C = (with_rank(b.center, rank + 1) for b in (ellipsoid, box))
    safe_radius = jnp.where(radius == 0, 1, radius)[..., None]
    world = _combination(lambda i: U[..., i], n)
    along = _combination(lambda r: V[..., r, :], split_vector(world, rank))
    # Divided last: XLA makes one division of two, and would undo what keeps the factor.
    share = a * along * of_radius[..., None] / safe_radius
    reach = a * share
    of_a = along * share
    arm = K - C - _combination(lambda p: V[..., p], split_vector(reach, rank))
    if contact is not None:
        arm = _instead(_combination(lambda i: U[..., i], contact.x), arm)
        turned = _combination(lambda i: U[..., i], contact.d)
        accurate = _by_point(
            ellipsoid, world, along, contact, turned, radius, of_radius
        )
        reach = _instead(accurate.reach, reach)
        of_a = _instead(accurate.of_a, of_a)
    normal = stack(n)
    return (
        -world,
        arm[..., :, None] * normal[..., None, :],
        -of_extent[..., None] * abs(normal),
        world,
        -world[..., :, None] * reach[..., None, :],
        -of_a,
    )


class _ByPoint(NamedTuple):
    """What belongs to the ellipsoid's axes (..., 3), with the help of the point.

    Attributes:
        reach: a_p^2 v_p.w of_radius / s.
        of_a: a_p (v_p.w)^2 of_radius / s.
    """

    reach: jax.Array
    of_a: jax.Array


def _by_point(
    ellipsoid: Ellipsoid,
    world: jax.Array,
    along: jax.Array,
    contact: TouchingPoint,
    turned: jax.Array,
    radius: Scalars,
    of_radius: Scalars,
) -> _ByPoint:
    """Along a long axis v_p.w cancels; along a short one the point's coordinate does.

    The one has the rounding of w, the other that of x and k. With t_p = a_p v_p.w / s,
    a unit vector, s follows from the short axes, to the scale of this w.
    """
    rank = radius.ndim
    V = with_rank(ellipsoid.axes, rank + 2)
    a = with_rank(ellipsoid.semi_axes, rank + 1)
    s, factor = radius[..., None], of_radius[..., None]
    safe = jnp.where(factor == 0, 1, factor)
    reach = -_combination(lambda r: V[..., r, :], split_vector(turned, rank))
    t = reach / a / safe
    lengths = _size(stack(contact.x)) + _size(stack(contact.d))
    is_long = (a * factor) * (a * _size(world)) > s * lengths
    short = jnp.where(is_long, 0, a * along)
    rest = 1 - _squared(jnp.where(is_long, t, 0))
    s = jnp.where(rest > 0.5, jnp.sqrt(_squared(short) / rest), s)
    share = a * along * factor / jnp.where(s == 0, 1, s)
    return _ByPoint(
        jnp.where(is_long, reach, a * share),
        jnp.where(is_long, t * factor * t * (s / a), along * share),
    )


@jax.custom_jvp
def _instead(accurate: jax.Array, formula: jax.Array) -> jax.Array:
    """The first, with the derivatives of the second."""
    return accurate


@_instead.defjvp
def _instead_jvp(primals: Any, tangents: Any) -> Any:
    return _instead(*primals), tangents[1]


def _squared(x: jax.Array) -> jax.Array:
    return jnp.sum(x * x, axis=-1, keepdims=True)


def _size(x: jax.Array) -> jax.Array:
    return jnp.max(abs(x), axis=-1, keepdims=True)


def _combination(vectors: Callable[[int], jax.Array], weights: Components) -> jax.Array:
    """The sum of the vectors by their weights."""
    x, y, z = (vectors(i) * weights[i][..., None] for i in range(3))
    return x + y + z


def _contract(tangent: jax.Array, gradient: jax.Array, rank: int) -> Scalars:
    """The scalar product over all but the batch axes."""
    aligned = with_rank(tangent, gradient.ndim)
    return jnp.sum(aligned * gradient, axis=tuple(range(rank, gradient.ndim)))
