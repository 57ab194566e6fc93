"""The distance of a pair that is apart, by the kernel of a swollen ellipsoid.

Wanted is the maximum d over unit n of n.k - e.|n| - s(n), s = sqrt(n^T S n). For a
mu >= 0 take the nearest point x of the box in the metric of S + mu I and its
multipliers n. If s(n) = 1, then y = k - S n is on the ellipsoid, x - y = -mu n, and
n.k - E = n^T (S + mu I) n makes n / |n| the maximiser: d = mu |n|.

s falls as mu grows, and on a fixed set A of active coordinates, where
(S + mu I)_AA n_A is constant, 1/s is all but linear: each step is Newton's for
1/s = 1, held in a bracket. Every mu gives

    a lower bound,   mu |n| + s (s - 1) / |n|    (the value at n / |n|),
    an upper bound,  |x - y|, y = k - S n / s.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxbe import _xla
from jaxbe.choice import choose, maximum, minimum
from jaxbe.components import dot, largest, times, vector
from jaxbe.kernel import Nearest, nearest
from jaxbe.metric import Metric, Shape, active_inverse, inflated, metric_of, shape
from jaxbe.pose import CanonicalPair, in_units, runtime_witness
from jaxbe.support import along_axes
from jaxbe.types import Components, Scalars


class Trial(NamedTuple):
    """What one mu gives, in the pair's units.

    Attributes:
        near: the kernel's answer.
        radius: s(n).
        support: S n.
        metric: of S + mu I.
    """

    near: Nearest
    radius: Scalars
    support: Components
    metric: Metric


class Bracket(NamedTuple):
    """A value of mu to try, and between which values the solution lies."""

    mu: Scalars
    low: Scalars
    high: Scalars


def shift(pair: CanonicalPair, steps: int) -> Scalars:
    """The value of mu, in the pair's units squared, after so many steps.

    Zero where the bodies overlap.
    """
    return _advanced(_start(pair), pair, steps)


def refined_shift(pair: CanonicalPair, mu: Scalars, steps: int) -> Scalars:
    """A guess of mu after so many more steps."""
    mu = _advanced(Bracket(mu, jnp.zeros_like(mu), _highest(pair)), pair, steps)
    if steps <= _xla.SEPARATION_LIMIT.at_once:
        return mu
    return _xla.cut(mu, runtime_witness(pair))


def _advanced(bracket: Bracket, pair: CanonicalPair, steps: int) -> Scalars:
    """The value of mu after so many steps, in computations of at most so many.

    Each has units of its own; the highest mu is found again in them.
    """
    most = _xla.SEPARATION_LIMIT.at_once
    first = steps % most or min(steps, most)
    bracket = _advance(bracket, pair, range(first))
    later = range(first, steps, most)
    for done in later:
        mu, low = _xla.hand_over(bracket.mu, bracket.low, runtime_witness(pair))
        pair = in_units(pair, 0.5)
        mu, low = _xla.in_units(mu, 0.25), _xla.in_units(low, 0.25)
        bracket = Bracket(mu, low, choose(mu > 0, _highest(pair), 0))
        bracket = _advance(bracket, pair, range(done, done + most))
    return _xla.in_units(bracket.mu, 4.0 ** len(later))


def trial(pair: CanonicalPair, form: Shape, mu: Scalars) -> Trial:
    """Evaluates the kernel of the ellipsoid swollen by mu."""
    m = metric_of(inflated(form, mu), _xla.stay_fused)
    near = nearest(pair.k, pair.e, m)
    terms = along_axes(pair, near.n)
    return Trial(
        near=near,
        radius=_xla.stay_fused(jnp.sqrt(dot(terms, terms))),
        support=times(pair.R, vector(lambda p: pair.a[p] * terms[p])),
        metric=m,
    )


def _start(pair: CanonicalPair) -> Bracket:
    """From mu = 0: the distance along its n, which is too short, to scale."""
    zero = jnp.zeros_like(pair.k[0] + pair.e[0] + pair.a[0])
    at = trial(pair, shape(pair.R, pair.a), zero)
    # n of length s = 1: its square as it stands leaves the floats, far from a plate.
    per_radius = _xla.stay_fused(1 / _positive(at.radius))
    n = vector(lambda i: at.near.n[i] * per_radius)
    mu = maximum(at.radius - 1, 0) / _positive(dot(n, n))
    high = choose(at.near.q > 1, _highest(pair), zero)
    return Bracket(minimum(mu, high), zero, high)


def _highest(pair: CanonicalPair) -> Scalars:
    """A bound of mu = d / |n|: d <= |k|, and s(n) = 1 <= |n| times a semi-axis."""
    return jnp.sqrt(dot(pair.k, pair.k)) * largest(pair.a)


def _advance(bracket: Bracket, pair: CanonicalPair, numbers: range) -> Bracket:
    form = shape(pair.R, pair.a)
    for number in numbers:
        state = _xla.between_steps(bracket, number, _xla.SEPARATION_LIMIT)
        bracket = _step(Bracket(*state), pair, form)
    return bracket


def _step(bracket: Bracket, pair: CanonicalPair, form: Shape) -> Bracket:
    """Newton's step for 1/s = 1; the middle of the bracket where it would leave."""
    mu = bracket.mu
    at = trial(pair, form, mu)
    further = at.radius > 1
    low = choose(further, mu, bracket.low)
    high = choose(further, bracket.high, mu)
    n, active = at.near.n, at.near.active
    inverse = active_inverse(active, at.metric)
    held = vector(lambda i: choose(active[i], n[i], 0))
    slope = dot(
        vector(lambda i: choose(active[i], at.support[i], 0)), times(inverse, held)
    )
    rise = at.radius * at.radius * (at.radius - 1)
    # Both sides times the slope, so that nothing is compared with a quotient.
    inside = (rise >= (low - mu) * slope) & (rise <= (high - mu) * slope)
    middle = jnp.sqrt(maximum(low * high, high * high * 1e-12))
    proposed = mu + rise / _positive(choose(inside, slope, 1))
    return Bracket(choose(inside, proposed, middle), low, high)


def _positive(x: Scalars) -> Scalars:
    return choose(x > 0, x, 1)
