"""Derivatives of everything that is a maximum over a direction n.

The margin, the scaled distance and the distance are maxima over n of expressions in

    n.k,   E = e.|n|,   s = sqrt(n^T S n),

the last two the support functions of the box and of the ellipsoid. By the envelope
theorem the derivative of the maximum is that of the expression with the best n held.
It is written out here, one array a field, on what was computed once.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxbe import _xla
from jaxbe.choice import choose
from jaxbe.components import clip, split_vector, stack, with_rank
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Components, Scalars


def directional_derivative(
    bodies: tuple[Box, Ellipsoid],
    tangents: tuple[Box, Ellipsoid],
    n: Components,
    radius: Scalars,
    *,
    of_extent: Scalars,
    of_radius: Scalars,
    reach: Components | None = None,
) -> Scalars:
    """n.k - of_extent * E - of_radius * s, differentiated with n and the factors held.

    Args:
        bodies: box and ellipsoid, in metres; the letters are those of `jaxbe.pose`.
        tangents: in their structure.
        n: the direction in box axes, divided by whatever divides the expression.
        radius: s at n; anything where n is zero.
        of_extent: the factor of the box's support function.
        of_radius: the factor of the ellipsoid's.
        reach: a_p^2 v_p.n of_radius / s in metres, as `jaxbe.touching` has it, for
            bodies that touch when scaled by the two factors. Else it is taken from n.
    """
    gradients = _gradients(bodies, n, radius, of_extent, of_radius, reach)
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
    touching: Components | None,
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
    safe_radius = choose(radius == 0, 1, radius)
    world = _combination(lambda i: U[..., i], n)
    along = _combination(lambda r: V[..., r, :], split_vector(world, rank))
    # Divided last: the compiler makes one division of two, and computes again what had
    # been materialised.
    share = a * along * of_radius[..., None] / safe_radius[..., None]
    reach = a * share
    of_a = along * share
    if touching is not None:
        reach = instead(stack(touching), reach)
        per_a = _xla.stay_fused(reach / a)
        factor = choose(of_radius == 0, 1, of_radius)[..., None]
        of_a = instead(per_a * per_a * radius[..., None] / (a * factor), of_a)
    arm = K - C - _combination(lambda p: V[..., p], split_vector(reach, rank))
    normal = stack(n)
    if touching is not None:
        # An eighth: the push by a component of rounding grows with the square.
        length = of_radius * (a[..., 0] + a[..., 1] + a[..., 2]) / 8
        still = jax.lax.stop_gradient((box, normal, of_extent, arm, length))
        arm = instead(_on_box(*still), arm)
    return (
        -world,
        arm[..., :, None] * normal[..., None, :],
        -of_extent[..., None] * abs(normal),
        world,
        -world[..., :, None] * reach[..., None, :],
        -of_a,
    )


def _on_box(
    box: Box,
    normal: jax.Array,
    of_extent: Scalars,
    arm: jax.Array,
    length: Scalars,
) -> jax.Array:
    """The touching point from the box's centre, in world axes: exact where on a bound.

    Far from each other, the bodies' centres have not its digits: the point is pushed
    along the normal, by a length like the ellipsoid's, and stops at the bounds. A
    component of the normal that is zero but for rounding, of either sign, pushes it by
    rounding.
    """
    rank = of_extent.ndim
    U = with_rank(box.axes, rank + 2)
    bound = of_extent[..., None] * with_rank(box.half_extents, rank + 1)
    point = _combination(lambda r: U[..., r, :], split_vector(arm, rank))
    x = clip(point + normal * length[..., None] * length[..., None], -bound, bound)
    return _combination(lambda i: U[..., i], split_vector(x, rank))


@jax.custom_jvp
def instead(accurate: jax.Array, formula: jax.Array) -> jax.Array:
    """The first, with the derivatives of the second."""
    return accurate


@instead.defjvp
def _instead_jvp(primals: Any, tangents: Any) -> Any:
    return instead(*primals), tangents[1]


def _combination(vectors: Callable[[int], jax.Array], weights: Components) -> jax.Array:
    """The sum of the vectors by their weights."""
    x, y, z = (vectors(i) * weights[i][..., None] for i in range(3))
    return x + y + z


def _contract(tangent: jax.Array, gradient: jax.Array, rank: int) -> Scalars:
    """The scalar product over all but the batch axes."""
    aligned = with_rank(tangent, gradient.ndim)
    return jnp.sum(aligned * gradient, axis=tuple(range(rank, gradient.ndim)))
