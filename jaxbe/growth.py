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
import numpy as np

from jaxbe import _xla
from jaxbe.choice import choose, maximum, minimum
from jaxbe.components import dot, is_zero, largest, vector
from jaxbe.contact_normal import contact_normal, contact_reach
from jaxbe.envelope import directional_derivative
from jaxbe.kernel import Nearest, nearest
from jaxbe.metric import Metric, active_inverse, metric, squared_length
from jaxbe.pose import (
    CanonicalPair,
    canonical_pair,
    in_units,
    materialised,
    runtime_witness,
)
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.support import extent
from jaxbe.types import Components, Scalars

MAX_STEPS = 10
"""More gain nothing at aspect ratios to 1e7, in either dtype."""

FEASIBLE_ROUNDINGS = 8
"""In `_feasible`, more than the roundings of each term, in units of eps."""


class Iterate(NamedTuple):
    """Where the iteration is: a trial value, and bounds that hold regardless."""

    trial: Scalars
    lower: Scalars
    upper: Scalars


def growth_bounds(pair: CanonicalPair, steps: int) -> tuple[Scalars, Scalars]:
    """A lower and an upper bound of alpha after `steps` steps."""
    first = max(0, steps - _xla.GROWTH_LIMIT.at_once)
    if first:
        iterate = _materialised_steps(pair, first)
        iterate = _more_steps(iterate, in_units(pair, 4), steps - first)
    else:
        iterate = _first_steps(pair, steps)
    return iterate.lower, maximum(iterate.lower, iterate.upper)


def growth_estimate(pair: CanonicalPair, steps: int) -> Scalars:
    """Alpha to so few steps that they need no cut: not a bound, but nearer."""
    return _first_steps(pair, steps).trial


def _materialised_steps(pair: CanonicalPair, count: int) -> Iterate:
    """The first steps, apart from those that follow."""
    trial, lower, _ = _first_steps(pair, count)
    *_, upper = _first_steps(in_units(pair, 2), count)
    witness = runtime_witness(pair)
    trial, lower = _xla.materialise_two(trial, lower, witness)
    return Iterate(trial, lower, _xla.cut(upper, witness))


def _first_steps(pair: CanonicalPair, count: int) -> Iterate:
    return _more_steps(start(pair, metric(pair.R, pair.a)), pair, count)


def _more_steps(iterate: Iterate, pair: CanonicalPair, count: int) -> Iterate:
    m = metric(pair.R, pair.a)
    for number in range(count):
        iterate = Iterate(*_xla.between_steps(iterate, number, _xla.GROWTH_LIMIT))
        iterate = step(iterate, pair, m)
    return iterate


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
    alpha = _xla.materialise_once(alpha, runtime_witness(canonical_pair(*bodies)))
    n, radius, reach = _materialised_contact(box, ellipsoid, alpha)
    tangent = directional_derivative(
        bodies,
        tangents,
        n,
        radius,
        of_extent=alpha,
        of_radius=alpha,
        reach=reach,
    )
    return alpha, tangent


def _materialised_contact(
    box: Box, ellipsoid: Ellipsoid, alpha: Scalars
) -> tuple[Components, Scalars, Components]:
    """The contact normal, with e.|n| + radius = 1 in metres, 0 for coincident centres.

    And the touching point, from the ellipsoid's centre and in its axes.
    """
    pair = canonical_pair(*_xla.reread((box, ellipsoid), alpha))
    normal = functools.partial(_masked_normal, alpha=alpha)
    n_0, n_1, n_2, radius = materialised(normal, pair, (8, 16), alpha)
    still, at = jax.lax.stop_gradient((pair, alpha))
    reach = functools.partial(_reach, alpha=at)
    r_0, r_1, r_2 = materialised(reach, still, (32, 64), alpha)
    return (n_0, n_1, n_2), radius, (r_0, r_1, r_2)


def _masked_normal(pair: CanonicalPair, alpha: Scalars) -> tuple[Scalars, ...]:
    n, radius = contact_normal(pair, alpha)
    here = is_zero(pair.k)
    return *vector(lambda i: choose(here, 0, n[i] * pair.per_unit)), radius


def _reach(pair: CanonicalPair, alpha: Scalars) -> Components:
    reach = contact_reach(pair, alpha)
    return vector(lambda p: reach[p] / pair.per_unit)


def start(pair: CanonicalPair, m: Metric) -> Iterate:
    """Step 0: the slab box B' of section 5 below, the ellipsoid alone above."""
    lower = largest(vector(lambda i: abs(pair.k[i]) / (pair.e[i] + m.width[i])))
    return Iterate(lower, lower, jnp.sqrt(squared_length(pair.k, m)))


def step(iterate: Iterate, pair: CanonicalPair, m: Metric) -> Iterate:
    """One evaluation of the kernel: better bounds, and the next trial value."""
    alpha = iterate.trial
    near = nearest(pair.k, vector(lambda i: alpha * pair.e[i]), m)
    lower = maximum(iterate.lower, _newton(alpha, near, pair.e))
    upper = minimum(iterate.upper, _feasible(alpha, near, pair.e, m))
    trial = maximum(lower, _parabola_root(alpha, near, pair.e, m))
    return Iterate(trial, lower, upper)


def _newton(alpha: Scalars, near: Nearest, e: Components) -> Scalars:
    """quotient(n), from sums of positive terms; alpha where n is lost to rounding."""
    reach = extent(near.n, e)
    root = jnp.sqrt(near.q)
    total = reach + root
    lost = total == 0
    return choose(lost, alpha, (near.q + alpha * reach) / choose(lost, 1, total))


def _parabola_root(alpha: Scalars, near: Nearest, e: Components, m: Metric) -> Scalars:
    """Alpha + d, for the root d of q - 2 E d + A d^2 = (alpha + d)^2.

    A is s^T S_AA^-1 s with s = sign(n) e: half the curvature of q in alpha.
    """
    n = near.n
    inverse = active_inverse(near.active, m)
    side = vector(lambda i: choose(near.active[i], jnp.sign(n[i]) * e[i], 0))
    curvature = dot(side, vector(lambda i: dot(inverse[i], side)))
    b = alpha + extent(n, e)
    c = near.q - alpha * alpha
    discriminant = maximum(b * b + (1 - curvature) * c, 0)
    total = b + jnp.sqrt(discriminant)
    lost = total == 0
    return alpha + choose(lost, 0, c / choose(lost, 1, total))


def _feasible(alpha: Scalars, near: Nearest, e: Components, m: Metric) -> Scalars:
    """An upper bound of alpha, from the nearest point x of the grown box.

    (1 + rho) x is in the box grown by alpha (1 + rho); it is in the ellipsoid grown
    so as well if q - 2 rho alpha E + rho^2 x^T N x <= alpha^2 (1 + rho)^2. Without a
    real root there remains max(alpha, sqrt(q)).

    Where x and the centre lie almost in one direction, as between two needles, that sum
    cancels: what rounding may hide of it is added to the right side, whatever rho is.

    Written for one computation: no root with two uses, nothing compared with a
    quotient.
    """
    square, reach = alpha * alpha, extent(near.n, e)
    size = squared_length(near.x, m)
    b = alpha * (alpha + reach)
    c = near.q - square
    discriminant = b * b + (square - size) * c
    total = b + jnp.sqrt(maximum(discriminant, 0))
    usable = (discriminant >= 0) & (total > 0) & (c > -total)
    rho = _xla.stay_fused(c / choose(usable, total, 1))
    terms = near.q + rho * rho * size + 2 * abs(rho) * (alpha * reach)
    hidden = FEASIBLE_ROUNDINGS * float(np.finfo(alpha.dtype).eps) * terms
    grown = alpha * (1 + rho)
    simple = maximum(square, near.q)
    better = minimum(simple, grown * grown + hidden)
    return jnp.sqrt(choose(usable, better, simple))
