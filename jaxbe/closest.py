"""The direction of the signed distance, of pairs apart and of pairs that overlap."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe.components import dot, largest, vector, where
from jaxbe.envelope import directional_derivative
from jaxbe.kept import kept, kept_from, kept_pair
from jaxbe.kernel import squared_distance
from jaxbe.metric import metric, shape
from jaxbe.penetration import refined, way_out
from jaxbe.pose import CanonicalPair, canonical_pair, in_other_units
from jaxbe.separation import shift, trial
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.support import along_axes
from jaxbe.tangent import solve, tangent
from jaxbe.types import Components, Flags, Scalars

LAST_ROUNDS = 2
"""Steps of the descent of pairs that overlap, after those of `jaxbe.penetration`."""


class Closest(NamedTuple):
    """The best direction.

    Attributes:
        n: a unit vector in box axes, from the box to the ellipsoid.
        distance: n.k - e.|n| - s(n) in metres, negative when they overlap.
    """

    n: Components
    distance: Scalars


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def closest(box: Box, ellipsoid: Ellipsoid, steps: int) -> Closest:
    """The direction of the distance or of the depth, by the test of section 4."""
    # Loops in different units share little: see `jaxbe.pose.in_other_units`.
    pair = canonical_pair(box, ellipsoid)
    # Lengths may have fewer batch axes than poses. XLA turns a division by what it
    # repeats along an axis into a product, and then keeps nothing.
    given = kept_from(pair.a[0], pair.k[0])
    pair = pair._replace(a=(given, *pair.a[1:]))
    mu = kept_from(shift(pair, steps), given)
    inside = way_out(in_other_units(pair, 8))
    n, _ = _either(in_other_units(pair, 2), 4 * mu, inside)
    m, distance = _either(in_other_units(pair, 4), 16 * mu, inside)
    distance = jnp.where(_is_too_far(pair), jnp.nan, distance)
    n_0, n_1 = kept_pair(n[0], n[1], given)
    n_2, distance = kept_pair(m[2], distance, given)
    return Closest((n_0, n_1, n_2), distance)


@closest.defjvp
def _closest_jvp(steps: int, bodies: Any, tangents: Any) -> Any:
    """Of the distance, a maximum over n, with n held; of n, by the equation it solves.

    f (see `jaxbe.tangent`) has no slope at n: one step of Newton's method,
    differentiated. Coordinates held at zero stay there. Where the Hessian is singular
    it is lifted, so the derivatives are finite.
    """
    found = closest(*bodies, steps)
    pair, d_pair = jax.jvp(canonical_pair, bodies, tangents)
    at = tangent(pair, found.n)
    _, slopes = jax.jvp(lambda p: tangent(p, found.n).slopes, (pair,), (d_pair,))
    t_1, t_2 = solve(at, slopes)
    moved = vector(lambda i: at.first[i] * t_1 + at.second[i] * t_2)
    along = along_axes(pair, found.n)
    radius = kept(jnp.sqrt(dot(along, along)) / pair.per_unit, pair.a[0])
    one = jnp.ones_like(radius)
    d_distance = directional_derivative(
        bodies, tangents, found.n, radius, of_extent=one, of_radius=one
    )
    return found, Closest(moved, d_distance)


def _is_too_far(pair: CanonicalPair) -> Flags:
    """Where mu, some |k| times the largest semi-axis, has no third power in floats."""
    limit = float(np.finfo(pair.per_unit.dtype).max) ** (1 / 3) / 64
    too_far: Flags = largest(vector(lambda i: abs(pair.k[i]))) > limit
    return too_far


def _either(
    pair: CanonicalPair, mu: Scalars, inside: Components
) -> tuple[Components, Scalars]:
    """The way out where they overlap, else the direction that mu gives; metres."""
    at = trial(pair, shape(pair.R, pair.a), mu)
    norm = jnp.where(at.norm == 0, 1, at.norm)
    outside = vector(lambda i: at.near.n[i] / norm)
    distance = mu * norm + at.radius * (at.radius - 1) / norm
    inside, depth = refined(pair, inside, LAST_ROUNDS)
    overlaps = squared_distance(pair.k, pair.e, metric(pair.R, pair.a)) <= 1
    n = where(overlaps, inside, outside)
    return n, jnp.where(overlaps, -depth, distance) / pair.per_unit
