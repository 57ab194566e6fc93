"""Derivatives of everything that is a maximum over a direction n.

The margin, the scaled distance and the distance are maxima over n of expressions in

    n.k,   E = e.|n|,   s = sqrt(n^T S n),

the last two the support functions of the box and of the ellipsoid. By the envelope
theorem the derivative of the maximum is that of the expression with the best n held.
It is written here as one array a field, not left to autodiff, which would take all
axes apart into components and put them together again.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxbe.components import (
    column,
    dot,
    matrix,
    split_matrix,
    split_vector,
    stack,
    vector,
    with_rank,
)
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import ComponentMatrix, Components, Scalars


class Supports(NamedTuple):
    """The support functions in a direction n, and what their derivatives need.

    Lengths are metres times `per_unit`. The letters are those of `jaxbe.pose`.

    Attributes:
        n: the direction in box axes.
        world: the same in world axes.
        per_unit: units a metre.
        extent: E.
        radius: s.
        along: v_p.world.
        share: the derivatives of s by the terms a_p v_p.world.
        reach: a_p share_p: the supporting point in the ellipsoid's axes.
        arm: the same in world axes.
        offset: K - C.
    """

    n: Components
    world: Components
    per_unit: Scalars
    extent: Scalars
    radius: Scalars
    along: Components
    share: Components
    reach: Components
    arm: Components
    offset: Components


def supports(
    box: Box, ellipsoid: Ellipsoid, n: Components, per_unit: Scalars
) -> Supports:
    """Evaluates the support functions in the direction n (box axes, not zero)."""
    rank = per_unit.ndim
    U, V = split_matrix(box.axes, rank), split_matrix(ellipsoid.axes, rank)
    C, K = split_vector(box.center, rank), split_vector(ellipsoid.center, rank)
    e = split_vector(box.half_extents, rank)
    a = split_vector(ellipsoid.semi_axes, rank)
    world = vector(lambda r: dot(U[r], n))
    along = vector(lambda p: dot(column(V, p), world))
    terms = vector(lambda p: a[p] * per_unit * along[p])
    radius = jnp.sqrt(dot(terms, terms))
    per_radius = 1 / radius
    share = vector(lambda p: terms[p] * per_radius)
    reach = vector(lambda p: a[p] * per_unit * share[p])
    return Supports(
        n=n,
        world=world,
        per_unit=per_unit,
        extent=dot(vector(lambda i: e[i] * per_unit), vector(lambda i: abs(n[i]))),
        radius=radius,
        along=along,
        share=share,
        reach=reach,
        arm=vector(lambda r: dot(V[r], reach)),
        offset=vector(lambda r: (K[r] - C[r]) * per_unit),
    )


def directional_derivative(
    at: Supports,
    tangents: tuple[Box, Ellipsoid],
    *,
    of_extent: Scalars | float,
    of_radius: Scalars | float,
    scale: Scalars,
) -> Scalars:
    """(n.k - of_extent * E - of_radius * s) / scale, differentiated.

    The direction n, the factors and the scale are held.

    Args:
        at: the support functions of the bodies.
        tangents: of the bodies, in their structure.
        of_extent: the factor of the box's support function.
        of_radius: the factor of the ellipsoid's.
        scale: the divisor.
    """
    d_box, d_ellipsoid = tangents
    weight = 1 / scale
    metres = weight * at.per_unit
    arm = vector(lambda r: at.offset[r] - of_radius * at.arm[r])
    pull = vector(lambda p: of_radius * at.reach[p])
    return (
        _contract(d_ellipsoid.center, vector(lambda r: metres * at.world[r]))
        - _contract(d_box.center, vector(lambda r: metres * at.world[r]))
        - _contract(
            d_box.half_extents, vector(lambda i: metres * of_extent * abs(at.n[i]))
        )
        - _contract(
            d_ellipsoid.semi_axes,
            vector(lambda p: metres * of_radius * at.share[p] * at.along[p]),
        )
        + _contract_matrix(d_box.axes, matrix(lambda r, i: weight * arm[r] * at.n[i]))
        - _contract_matrix(
            d_ellipsoid.axes, matrix(lambda r, p: weight * at.world[r] * pull[p])
        )
    )


def _contract(tangent: jax.Array, gradient: Components) -> Scalars:
    stacked = stack(gradient)
    return jnp.sum(with_rank(tangent, stacked.ndim) * stacked, axis=-1)


def _contract_matrix(tangent: jax.Array, gradient: ComponentMatrix) -> Scalars:
    stacked = jnp.stack([stack(row) for row in gradient], axis=-2)
    return jnp.sum(with_rank(tangent, stacked.ndim) * stacked, axis=(-2, -1))
