"""The depth of a pair that overlaps: the shortest way out, among several.

Moved along any unit direction n by f(n) (see `jaxbe.tangent`) the pair is apart: each
direction gives an upper bound of the depth, the least over n. f has several local
minima. The descent starts from the three face normals of the box, the margin's normal
and the three axes of the ellipsoid, and the best result is refined further.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxbe.components import column, dot, largest, vector, where
from jaxbe.contact_normal import contact_normal
from jaxbe.growth import growth_bounds
from jaxbe.kept import kept, kept_from, kept_pair, shared
from jaxbe.pose import CanonicalPair, in_other_units
from jaxbe.tangent import depth, improved
from jaxbe.types import Components, Scalars

STARTS = 7
STARTS_A_LOOP = 2
"""As many as XLA compiles well in one expression (see `jaxbe.growth`)."""

FIRST_ROUNDS = 3
"""Steps from every start, before the best is chosen."""

ROUNDS = 4
"""Steps of the best one, again from the start."""

GROWTH_STEPS = 2


def way_out(pair: CanonicalPair) -> Components:
    """The unit direction, from the box to the ellipsoid, with the least f found."""
    normal = _growth_normal(pair)
    best = _best_start(pair, normal)
    n = _refined_start(in_other_units(pair, 128), normal, best)
    m = _refined_start(in_other_units(pair, 256), normal, best)
    n_0, n_1 = kept_pair(n[0], n[1], pair.a[0])
    return n_0, n_1, kept_from(m[2], pair.a[0])


def _best_start(pair: CanonicalPair, normal: Components) -> Scalars:
    """The number of the start that is best after the first rounds."""
    best, value = _best_of_group(in_other_units(pair, 8), normal, 0)
    for i, first in enumerate(range(STARTS_A_LOOP, STARTS, STARTS_A_LOOP)):
        number, least = _best_of_group(in_other_units(pair, 16 << i), normal, first)
        best = jnp.where(least < value, number, best)
        value = jnp.minimum(least, value)
    return kept_from(best, pair.a[0])


def _refined_start(
    pair: CanonicalPair, normal: Components, best: Scalars
) -> Components:
    """The best start refined."""
    n = _numbered(pair, normal, 0)
    for number in range(1, STARTS):
        n = where(best == number, _numbered(pair, normal, number), n)
    return refined(pair, n, ROUNDS)[0]


def _growth_normal(pair: CanonicalPair) -> Components:
    given = pair.a[0]
    alpha = kept(growth_bounds(pair, GROWTH_STEPS)[0], given)
    n = contact_normal(in_other_units(pair, 2), alpha).n
    m = contact_normal(in_other_units(pair, 4), alpha).n
    n_0, n_1 = kept_pair(n[0], n[1], given)
    # In the units of n.
    return n_0, n_1, 2 * kept(m[2], given)


def _best_of_group(
    pair: CanonicalPair, normal: Components, first: int
) -> tuple[Scalars, Scalars]:
    """Of some starts, a few rounds on: the best one's number, and its f in metres."""
    _, value = refined(pair, _numbered(pair, normal, first), FIRST_ROUNDS)
    best = jnp.full_like(value, first)
    for number in range(first + 1, min(first + STARTS_A_LOOP, STARTS)):
        _, least = refined(pair, _numbered(pair, normal, number), FIRST_ROUNDS)
        best = jnp.where(least < value, jnp.full_like(least, number), best)
        value = jnp.minimum(least, value)
    return kept_pair(best, value / pair.per_unit, pair.a[0])


def _numbered(pair: CanonicalPair, normal: Components, start: int) -> Components:
    """The start of that number: the margin's normal, faces, ellipsoid axes."""
    if start == 0:
        return _unit(normal)
    if start <= 3:
        sign = jnp.where(pair.k[start - 1] < 0, -1, 1).astype(pair.k[0].dtype)
        return vector(lambda i: sign if i == start - 1 else jnp.zeros_like(sign))
    axis = column(pair.R, start - 4)
    sign = jnp.where(dot(axis, pair.k) < 0, -1, 1).astype(pair.k[0].dtype)
    return _unit(vector(lambda i: sign * axis[i]))


def refined(
    pair: CanonicalPair, n: Components, rounds: int
) -> tuple[Components, Scalars]:
    """A unit direction after so many steps, and its f in the pair's units."""
    value = depth(pair, n)
    for _ in range(rounds):
        n, value = improved(pair, n, value)
    return n, value


def _unit(n: Components) -> Components:
    per_size = shared(1 / largest(vector(lambda i: abs(n[i]))))
    n = vector(lambda i: n[i] * per_size)
    per_length = shared(1 / jnp.sqrt(dot(n, n)))
    return vector(lambda i: n[i] * per_length)
