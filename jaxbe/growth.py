"""The growth distance: by which factor must both bodies grow to touch?

alpha is the factor by which box and ellipsoid must be scaled about their centres
(Ong and Gilbert, 1996): the gauge at k of the Minkowski sum of section 5 of the
paper,

    alpha = max over n of quotient(n),   quotient(n) = n.k / (e.|n| + sqrt(n^T S n)).

It is the root of sqrt(q(alpha e)) = alpha, with q of `jaxbe.kernel`: the box grown
by alpha touches the ellipsoid grown by alpha. sqrt(q) is convex and falls with
alpha, with the slope -E / sqrt(q), E = e.|n|; as long as the set A of active
coordinates stays the same, q is a parabola in alpha.

Each step takes the nearest point at a trial value alpha_t, and from it

- a *lower bound*, by Newton's method: (q + alpha_t E) / (E + sqrt(q)). As
  n.k = q + alpha_t E (complementarity) and n^T S n = q it is quotient(n), so it is
  a bound for *every* trial value, below or above the root;
- an *upper bound*, by a feasible point: x is in the grown box and at sqrt(q) from
  the centre, so max(alpha_t, sqrt(q)) suffices;
- the next trial value: the root of the parabola, exact once A is right. Plain
  Newton, which linearises, doubles its digits a step; the parabola ends in one.
  A trial value may overshoot when A changes, the lower bounds never do.

Only sums of positive terms enter the lower bound: nothing cancels in float32.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxbe.components import column, dot, largest, vector, where
from jaxbe.envelope import directional_derivative, supports
from jaxbe.kernel import Nearest, nearest
from jaxbe.metric import Metric, active_inverse, metric
from jaxbe.pose import CanonicalPair, canonical_pair
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import ComponentMatrix, Components, Scalars

MAX_STEPS = 6
"""More gain nothing (float64 is exhausted at aspect ratios to 1e7), and a chain of
eight is beyond what XLA's CPU backend fuses well: it runs a hundred times slower."""


class Iterate(NamedTuple):
    """Where the iteration is: a trial value, and bounds that hold regardless."""

    trial: Scalars
    lower: Scalars
    upper: Scalars


def growth_bounds(pair: CanonicalPair, steps: int) -> tuple[Scalars, Scalars]:
    """A lower and an upper bound of alpha after `steps` steps."""
    m = metric(pair.R, pair.a)
    iterate = start(pair, m)
    for _ in range(steps):
        iterate = step(iterate, pair, m)
    return iterate.lower, jnp.maximum(iterate.lower, iterate.upper)


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def growth_distance(box: Box, ellipsoid: Ellipsoid, steps: int) -> Scalars:
    """The lower bound of alpha after `steps` steps."""
    return growth_bounds(canonical_pair(box, ellipsoid), steps)[0]


@growth_distance.defjvp
def _growth_distance_jvp(steps: int, bodies: Any, tangents: Any) -> Any:
    """Alpha is a maximum over n: hold the best n and differentiate the quotient.

    By the envelope theorem that is exact, and no clip, minimum or step is ever
    differentiated. The rule calls functions that have such rules themselves, so it
    can be differentiated again.
    """
    box, ellipsoid = bodies
    alpha = growth_distance(box, ellipsoid, steps)
    # Each in units of its own: XLA would else find what the loops of alpha and of the
    # three components share, and write and read 40 arrays instead of computing twice.
    pairs = [canonical_pair(box, ellipsoid, units=units) for units in (2, 4, 8, 16)]
    n = vector(lambda i: contact_normal(pairs[i + 1], alpha)[i])
    at = supports(box, ellipsoid, n, pairs[0].per_unit)
    tangent = directional_derivative(
        at,
        tangents,
        of_extent=alpha,
        of_radius=alpha,
        scale=at.extent + at.radius,
    )
    return alpha, jnp.where(_coincident(pairs[0].k), 0, tangent)


def start(pair: CanonicalPair, m: Metric) -> Iterate:
    """Step 0: the slab box B' of section 5 below, the ellipsoid alone above."""
    lower = largest(vector(lambda i: abs(pair.k[i]) / (pair.e[i] + m.width[i])))
    return Iterate(lower, lower, _norm(pair.k, pair))


def step(iterate: Iterate, pair: CanonicalPair, m: Metric) -> Iterate:
    """One evaluation of the kernel: better bounds, and the next trial value."""
    alpha = iterate.trial
    near = nearest(pair.k, vector(lambda i: alpha * pair.e[i]), m)
    lower = jnp.maximum(iterate.lower, _newton(alpha, near, pair.e))
    upper = jnp.minimum(iterate.upper, _feasible(alpha, near, pair))
    trial = jnp.maximum(lower, _parabola_root(alpha, near, pair.e, m))
    return Iterate(trial, lower, upper)


def contact_normal(pair: CanonicalPair, alpha: Scalars) -> Components:
    """The direction n that attains alpha, scaled to the largest component 1.

    Where the grown box reaches the centre to rounding (a needle seen end on beside
    a huge box, or coincident centres) it is the best face normal of the box.
    """
    n = _multipliers(pair, alpha)
    size = lax.stop_gradient(largest(vector(lambda i: abs(n[i]))))
    lost = size == 0
    safe_size = jnp.where(lost, 1, size)
    scaled = vector(lambda i: n[i] / safe_size)
    return where(lost, _face_normal(pair), scaled)


@jax.custom_jvp
def _multipliers(pair: CanonicalPair, alpha: Scalars) -> Components:
    grown = vector(lambda i: alpha * pair.e[i])
    return nearest(pair.k, grown, metric(pair.R, pair.a)).n


@_multipliers.defjvp
def _multipliers_jvp(primals: Any, tangents: Any) -> Any:
    """n_A = S_AA^-1 (k - sign(n) alpha e)_A on the active set A, differentiated.

    The formulas of the kernel take S and N for inverses of each other, which holds
    along rotations only; this one is right in all entries of the axes.
    """
    pair, alpha = primals
    d_pair, d_alpha = tangents
    m = metric(pair.R, pair.a)
    near = nearest(pair.k, vector(lambda i: alpha * pair.e[i]), m)
    n = near.n
    inverse = active_inverse(near.active, m)
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
    right = vector(lambda i: jnp.where(near.active[i], right[i], 0))
    d_n = vector(lambda i: jnp.where(near.active[i], dot(inverse[i], right), 0))
    return _multipliers(pair, alpha), d_n


def _newton(alpha: Scalars, near: Nearest, e: Components) -> Scalars:
    """quotient(n), from sums of positive terms; alpha where n is lost to rounding."""
    extent = _extent(near.n, e)
    root = jnp.sqrt(near.q)
    total = extent + root
    lost = total == 0
    return jnp.where(lost, alpha, (near.q + alpha * extent) / jnp.where(lost, 1, total))


def _parabola_root(alpha: Scalars, near: Nearest, e: Components, m: Metric) -> Scalars:
    """Alpha + d, for the root d of q - 2 E d + A d^2 = (alpha + d)^2.

    A is s^T S_AA^-1 s with s = sign(n) e: half the curvature of q in alpha.
    """
    n = near.n
    inverse = active_inverse(near.active, m)
    side = vector(lambda i: jnp.where(near.active[i], jnp.sign(n[i]) * e[i], 0))
    curvature = dot(side, vector(lambda i: dot(inverse[i], side)))
    b = alpha + _extent(n, e)
    c = near.q - alpha * alpha
    discriminant = jnp.maximum(b * b + (1 - curvature) * c, 0)
    total = b + jnp.sqrt(discriminant)
    lost = total == 0
    return alpha + jnp.where(lost, 0, c / jnp.where(lost, 1, total))


def _feasible(alpha: Scalars, near: Nearest, pair: CanonicalPair) -> Scalars:
    """An upper bound of alpha, from the nearest point x of the grown box.

    (1 + rho) x is in the box grown by alpha (1 + rho); it is in the ellipsoid grown
    so as well if q - 2 rho alpha E + rho^2 x^T N x <= alpha^2 (1 + rho)^2. Without a
    real root there remains max(alpha, sqrt(q)).
    """
    b = alpha * (alpha + _extent(near.n, pair.e))
    c = near.q - alpha * alpha
    reach = _norm(near.x, pair)
    discriminant = b * b + (alpha - reach) * (alpha + reach) * c
    total = b + jnp.sqrt(jnp.maximum(discriminant, 0))
    usable = (discriminant >= 0) & (total > 0)
    rho = c / jnp.where(usable, total, 1)
    simple = jnp.maximum(alpha, jnp.sqrt(near.q))
    usable = usable & (rho > -1)
    return jnp.where(usable, jnp.minimum(simple, alpha * (1 + rho)), simple)


def _extent(n: Components, e: Components) -> Scalars:
    """E = e.|n|, the support function of the box."""
    return dot(vector(lambda i: abs(n[i])), e)


def _norm(x: Components, pair: CanonicalPair) -> Scalars:
    """sqrt(x^T N x), the length of x in ellipsoid radii."""
    y = vector(lambda p: dot(column(pair.R, p), x) / pair.a[p])
    return jnp.sqrt(dot(y, y))


def _shape_times(n: Components, R: ComponentMatrix, a: Components) -> Components:
    """S n."""
    weighted = vector(lambda p: a[p] * a[p] * dot(column(R, p), n))
    return vector(lambda i: dot(R[i], weighted))


def _face_normal(pair: CanonicalPair) -> Components:
    """The face normal of the box, signed towards the ellipsoid, that gave step 0."""
    width = metric(pair.R, pair.a).width
    ratio = vector(lambda i: abs(pair.k[i]) / (pair.e[i] + width[i]))
    first = (ratio[0] >= ratio[1]) & (ratio[0] >= ratio[2])
    second = ~first & (ratio[1] >= ratio[2])
    chosen = (first, second, ~first & ~second)
    sign = vector(lambda i: jnp.where(pair.k[i] < 0, -1, 1).astype(pair.k[i].dtype))
    return vector(lambda i: jnp.where(chosen[i], sign[i], 0))


def _coincident(k: Components) -> Any:
    return (k[0] == 0) & (k[1] == 0) & (k[2] == 0)
