"""Newton's method for the depth along a direction.

Along the unit direction n two bodies overlap by f(n) = e.|n| + s(n) - n.k, with
s = sqrt(n^T S n): moved apart along n by f they touch; minus f they are apart. For a
direction u of any length the depth is f = F(u) / |u|, with the same F, which is
homogeneous and convex.

The largest component of u is held, and f minimised in the other two. F has kinks where
a u_i is zero. There its derivative in u_i is anything within e_i of
g_i = (S u / s - k)_i: while |g_i| <= e_i the coordinate stays at zero, else it is
released.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxbe import _xla
from jaxbe.choice import choose, maximum
from jaxbe.components import clip, column, dot, largest, matrix, times, vector, where
from jaxbe.pose import CanonicalPair
from jaxbe.support import extent
from jaxbe.types import ComponentMatrix, Components, Flags, Scalars

LONGEST_STEP = 0.5
"""In units of the component that is held."""

SHORT_STEP = 0.25
SHORTER_STEP = 0.0625
"""Fractions of Newton's step that are tried where it fails."""

FLOOR = 1e-4
"""Of the Hessian's smaller eigenvalue, in units of its diagonal."""


class Chart(NamedTuple):
    """Which component of u is held, being the largest.

    Attributes:
        is_first: the component 0; those that vary are 1 and 2.
        is_last: the component 2; those that vary are 0 and 1. Else 0 and 2 vary.
    """

    is_first: Flags
    is_last: Flags

    def of_vector(self, x: Components) -> tuple[Scalars, Scalars]:
        """The two components that vary."""
        return choose(self.is_first, x[1], x[0]), choose(self.is_last, x[1], x[2])

    def of_matrix(self, m: ComponentMatrix) -> Components:
        """The entries 11, 12 and 22 of a symmetric matrix, in these components."""
        mixed = choose(self.is_last, m[0][1], m[0][2])
        return (
            choose(self.is_first, m[1][1], m[0][0]),
            choose(self.is_first, m[1][2], mixed),
            choose(self.is_last, m[1][1], m[2][2]),
        )

    def move(self, t_1: Scalars, t_2: Scalars) -> Components:
        """The vector with these two components, and zero for the one that is held."""
        middle = choose(self.is_first, t_1, choose(self.is_last, t_2, 0))
        return choose(self.is_first, 0, t_1), middle, choose(self.is_last, 0, t_2)


class Tangent(NamedTuple):
    """Derivatives of f, times |u|, in the two components of u that vary.

    Attributes:
        F: F(u).
        chart: which.
        slopes: the first ones, zero where a coordinate stays at zero.
        hessian: h_11, h_12 and h_22; of what stays at zero anything harmless.
    """

    F: Scalars
    chart: Chart
    slopes: tuple[Scalars, Scalars]
    hessian: Components


class Depth(NamedTuple):
    """The depth along u as a quotient, so that two compare without a division.

    Attributes:
        F: F(u).
        length: |u|.
    """

    F: Scalars
    length: Scalars

    def is_less(self, other: Depth, allowance: Scalars | float = 0.0) -> Flags:
        """Whether this depth is below the other, plus an allowance; False for NaN."""
        most = (other.F + allowance * other.length) * self.length
        less: Flags = self.F * other.length < most
        return less


class Best(NamedTuple):
    """The best direction so far, and its depth."""

    u: Components
    depth: Depth

    def or_better(
        self, other: Best, allowance: Scalars | float = 0.0
    ) -> tuple[Best, Flags]:
        """The other one if it is less deep, and whether it is; see `Depth.is_less`."""
        better, here, there = other.depth.is_less(self.depth, allowance), self, other
        least = Depth(
            choose(better, there.depth.F, here.depth.F),
            choose(better, there.depth.length, here.depth.length),
        )
        return Best(where(better, there.u, here.u), least), better


class Search(NamedTuple):
    """A pair as the search sees it, in its units.

    Attributes:
        k, e: as in `jaxbe.pose`.
        B: R diag(a): its columns are the semi-axes as vectors.
        S: B B^T.
        rounding: of a depth.
    """

    k: Components
    e: Components
    B: ComponentMatrix
    S: ComponentMatrix
    rounding: Scalars


def search(pair: CanonicalPair) -> Search:
    """Prepares a pair."""
    B = matrix(lambda i, p: pair.R[i][p] * pair.a[p])
    S = matrix(lambda i, j: dot(B[min(i, j)], B[max(i, j)]))
    size = largest(pair.e) + largest(vector(lambda i: abs(pair.k[i]))) + 1
    eps = float(np.finfo(size.dtype).eps)
    return Search(pair.k, pair.e, B, S, 4 * eps * size)


def depth(pair: Search, u: Components) -> Depth:
    """F(u) and |u|; minus their quotient is the distance where they are apart."""
    along = _along(pair, u)
    F = extent(u, pair.e) + jnp.sqrt(dot(along, along)) - dot(u, pair.k)
    return Depth(_xla.stay_fused(F), _xla.stay_fused(jnp.sqrt(dot(u, u))))


def tangent(pair: Search, u: Components) -> Tangent:
    """The derivatives of f at u, not zero."""
    along = _along(pair, u)
    per_s = _xla.stay_fused(1 / jnp.sqrt(dot(along, along)))
    # The ellipsoid's extreme point; not from S, which loses digits.
    p = times(pair.B, vector(lambda p: along[p] * per_s))
    slope = vector(lambda i: _slope(u[i], p[i] - pair.k[i], pair.e[i]))
    F = dot(u, slope)
    per_square = _xla.stay_fused(1 / dot(u, u))
    phi = F * per_square
    chart = _chart(u)
    u_1, u_2 = chart.of_vector(u)
    p_1, p_2 = chart.of_vector(p)
    s_1, s_2 = chart.of_vector(slope)
    S_11, S_12, S_22 = chart.of_matrix(pair.S)
    d_1, d_2 = s_1 - phi * u_1, s_2 - phi * u_2
    # At a minimum the slopes vanish; elsewhere their terms keep Newton's step right.
    w_1, w_2 = u_1 * per_square, u_2 * per_square
    h_11 = (S_11 - p_1 * p_1) * per_s - phi * (1 - u_1 * w_1) - 2 * d_1 * w_1
    h_22 = (S_22 - p_2 * p_2) * per_s - phi * (1 - u_2 * w_2) - 2 * d_2 * w_2
    h_12 = (S_12 - p_1 * p_2) * per_s + phi * u_1 * w_2 - d_1 * w_2 - d_2 * w_1
    held_1, held_2 = (u_1 == 0) & (d_1 == 0), (u_2 == 0) & (d_2 == 0)
    hessian = (
        choose(held_1, abs(h_22), h_11),
        choose(held_1 | held_2, 0, h_12),
        choose(held_2, abs(h_11), h_22),
    )
    return Tangent(F, chart, (d_1, d_2), hessian)


def improved(pair: Search, u: Components, *, is_last: bool = True) -> Components:
    """One step of Newton's method, or the beginning of it, or none: whichever is best.

    The beginning is up to where a coordinate reaches zero, or a quarter. In the last
    steps there is another one, up to where the ellipsoid is narrowest, or a sixteenth.
    What would change its sign on the way stops at zero.

    Near the minimum all depths are alike to rounding, and the whole step still gains
    digits: it may be deeper by that, and a beginning has to be better by more. Where
    the whole step fails, a kink that is reached settles a component's sign, though the
    depth there is the same.

    Args:
        pair: the bodies.
        u: a direction, not zero.
        is_last: whether to try both beginnings.
    """
    at = tangent(pair, u)
    t_1, t_2 = _newton(at, u)
    move = at.chart.move(t_1, t_2)
    zero = _until_first_zero(at.chart, u, t_1, t_2)
    best = Best(u, Depth(at.F, _xla.stay_fused(jnp.sqrt(dot(u, u)))))

    def moved(fraction: Scalars | float) -> Best:
        there = _moved(u, move, fraction)
        return Best(there, depth(pair, there))

    best, is_whole = best.or_better(moved(1.0), pair.rounding)
    allowance = choose(is_whole, -pair.rounding, pair.rounding)
    best, _ = best.or_better(moved(zero), allowance)
    if is_last:
        narrowest = _until_narrowest(pair, u, move)
        best, _ = best.or_better(moved(narrowest), -pair.rounding)
    return best.u


def solve(at: Tangent, slopes: tuple[Scalars, Scalars]) -> Components:
    """Minus the inverse Hessian times the slopes; the Hessian lifted to be positive."""
    h_11, h_12, h_22, determinant = _lifted(at.hessian)
    t_1, t_2 = _against(h_11, h_12, h_22, slopes)
    divisor = choose(determinant > 0, determinant, 1)
    return at.chart.move(t_1 / divisor, t_2 / divisor)


def _slope(u_i: Scalars, g_i: Scalars, e_i: Scalars) -> Scalars:
    """The derivative of F in u_i; where u_i is zero, the smallest one."""
    at_kink = g_i - clip(g_i, -e_i, e_i)
    return choose(u_i == 0, at_kink, choose(u_i < 0, g_i - e_i, g_i + e_i))


def _chart(u: Components) -> Chart:
    size = vector(lambda i: abs(u[i]))
    is_first = (size[0] >= size[1]) & (size[0] >= size[2])
    return Chart(is_first, ~is_first & (size[2] > size[1]))


def _held_size(chart: Chart, u: Components) -> Scalars:
    held = choose(chart.is_first, u[0], choose(chart.is_last, u[2], u[1]))
    return abs(held)


def _newton(at: Tangent, u: Components) -> tuple[Scalars, Scalars]:
    """The step, no longer than LONGEST_STEP units.

    A coordinate at zero that it would move against its slope stays there.
    """
    unit = _held_size(at.chart, u)
    u_1, u_2 = at.chart.of_vector(u)
    s_1, s_2 = at.slopes
    h_11, h_12, h_22, determinant = _lifted(at.hessian)
    t_1, t_2 = _against(h_11, h_12, h_22, at.slopes)
    stays_1 = (u_1 == 0) & (t_1 * s_1 >= 0)
    stays_2 = (u_2 == 0) & (t_2 * s_2 >= 0)
    alone = stays_1 | stays_2
    t_1 = choose(stays_1, 0, choose(alone, -h_22 * s_1, t_1))
    t_2 = choose(stays_2, 0, choose(alone, -h_11 * s_2, t_2))
    determinant = choose(alone, h_11 * h_22, determinant)
    length = maximum(abs(t_1), abs(t_2))
    divisor = maximum(determinant * unit, length / LONGEST_STEP)
    scale = _xla.stay_fused(unit / choose(divisor > 0, divisor, 1))
    return t_1 * scale, t_2 * scale


def _lifted(hessian: Components) -> tuple[Scalars, Scalars, Scalars, Scalars]:
    """The Hessian with its smaller eigenvalue raised to FLOOR; its determinant."""
    h_11, h_12, h_22 = hessian
    apart = (h_11 - h_22) / 2
    # Not of zero, where the root has no derivative.
    square = maximum(apart * apart + h_12 * h_12, float(np.finfo(h_12.dtype).tiny))
    smaller = (h_11 + h_22) / 2 - jnp.sqrt(square)
    lift = maximum(FLOOR * (abs(h_11) + abs(h_22)) - smaller, 0)
    h_11, h_22 = h_11 + lift, h_22 + lift
    return h_11, h_12, h_22, h_11 * h_22 - h_12 * h_12


def _against(
    h_11: Scalars, h_12: Scalars, h_22: Scalars, slopes: tuple[Scalars, Scalars]
) -> tuple[Scalars, Scalars]:
    """The solution of h t = -slopes, times the determinant."""
    s_1, s_2 = slopes
    return h_12 * s_2 - h_22 * s_1, h_12 * s_1 - h_11 * s_2


def _moved(u: Components, move: Components, fraction: Scalars | float) -> Components:
    """What changes its sign, or ends at zero to rounding, becomes zero."""
    there = vector(lambda i: u[i] + fraction * move[i])
    to_rounding = float(8 * np.finfo(u[0].dtype).eps)
    return vector(
        lambda i: choose(u[i] * there[i] < to_rounding * u[i] * u[i], 0, there[i])
    )


def _along(pair: Search, u: Components) -> Components:
    """a_p v_p.u, in the ellipsoid's axes; its length is s."""
    return vector(lambda p: dot(column(pair.B, p), u))


def _until_narrowest(pair: Search, u: Components, move: Components) -> Scalars:
    """The fraction of the step to where the ellipsoid is narrowest, or SHORTER_STEP.

    Along a needle's axis s is as good as |a_p v_p.u|: it has a kink where that is zero.
    """
    here, change = _along(pair, u), _along(pair, move)
    left, gone = -dot(here, change), dot(change, change)
    return _fraction(left, gone, (left > 0) & (left < gone), SHORTER_STEP)


def _until_first_zero(
    chart: Chart, u: Components, t_1: Scalars, t_2: Scalars
) -> Scalars:
    """The fraction of the step after which one of the two is zero, or SHORT_STEP."""
    u_1, u_2 = chart.of_vector(u)
    left, gone = abs(u_1), choose(u_1 * t_1 < 0, abs(t_1), 0)
    left_2, gone_2 = abs(u_2), choose(u_2 * t_2 < 0, abs(t_2), 0)
    # The smaller of the quotients left / gone, by one division.
    first = left_2 * gone < left * gone_2
    left, gone = choose(first, left_2, left), choose(first, gone_2, gone)
    return _fraction(left, gone, left < SHORT_STEP * gone, SHORT_STEP)


def _fraction(left: Scalars, gone: Scalars, usable: Flags, otherwise: float) -> Scalars:
    """The quotient left / gone where it is usable, else a number."""
    return _xla.stay_fused(choose(usable, left / choose(usable, gone, 1), otherwise))
