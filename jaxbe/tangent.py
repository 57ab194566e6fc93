"""Newton's method on the unit sphere, for the depth along a direction.

Along the unit direction n two bodies overlap by f(n) = e.|n| + s(n) - n.k, with
s = sqrt(n^T S n): moved apart along n by f they touch. f has kinks where an n_i is
zero. There its derivative in n_i is anything within e_i of g_i = (S n / s - k)_i:
while |g_i| <= e_i the coordinate is held at zero, else it is released.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxbe.components import clip, column, dot, smallest, vector, where
from jaxbe.kept import shared
from jaxbe.pose import CanonicalPair
from jaxbe.support import along_axes, extent
from jaxbe.types import Components, Scalars

LONGEST_STEP = 0.5
SHORT_STEP = 0.25
FLOOR = 1e-4
"""Of the Hessian's smaller eigenvalue, in units of its diagonal."""


class Tangent(NamedTuple):
    """Derivatives of f in the plane orthogonal to n.

    Attributes:
        first, second: an orthonormal basis, second along a coordinate that is zero.
        slopes: the derivatives of f along it, zero where a coordinate is held.
        hessian: h_11, h_12 and h_22; of held coordinates anything harmless.
    """

    first: Components
    second: Components
    slopes: tuple[Scalars, Scalars]
    hessian: Components


def depth(pair: CanonicalPair, n: Components) -> Scalars:
    """f(n), for a unit n; minus the distance where the pair is apart along n."""
    along = along_axes(pair, n)
    return extent(n, pair.e) + jnp.sqrt(dot(along, along)) - dot(n, pair.k)


def tangent(pair: CanonicalPair, n: Components) -> Tangent:
    """The derivatives of f at a unit n."""
    squares = vector(lambda p: pair.a[p] * pair.a[p])
    along = vector(lambda p: dot(column(pair.R, p), n))
    weighted = vector(lambda p: squares[p] * along[p])
    s = shared(jnp.sqrt(dot(weighted, along)))
    g = vector(lambda i: dot(pair.R[i], weighted) / s - pair.k[i])
    slope = vector(lambda i: _slope(n[i], g[i], pair.e[i]))
    f = dot(n, slope)
    first, second = _basis(n)
    ends = [vector(lambda p: dot(column(pair.R, p), b)) for b in (first, second)]  # noqa: B023
    pulls = [shared(dot(weighted, end) / s) for end in ends]

    def curvature(i: int, j: int) -> Scalars:
        forms = vector(lambda p: squares[p] * ends[i][p] * ends[j][p])
        return shared((forms[0] + forms[1] + forms[2] - pulls[i] * pulls[j]) / s)

    slopes = dot(first, slope), dot(second, slope)
    zeros = [x == 0 for x in n]
    # Zero coordinates are along the second axis first. Held ones have no say, released
    # ones go down their own slope.
    one = zeros[0] | zeros[1] | zeros[2]
    second_held = one & (slopes[1] == 0)
    two = (zeros[0] & zeros[1]) | (zeros[1] & zeros[2]) | (zeros[2] & zeros[0])
    first_held = two & (slopes[0] == 0)
    h_11, h_22 = curvature(0, 0) - f, curvature(1, 1) - f
    hessian = (
        jnp.where(first_held, abs(h_22), h_11),
        jnp.where(one, 0, curvature(0, 1)),
        jnp.where(second_held, abs(h_11), h_22),
    )
    return Tangent(first, second, slopes, hessian)


def improved(
    pair: CanonicalPair, n: Components, value: Scalars
) -> tuple[Components, Scalars]:
    """One step of Newton's method, or the beginning of it, or none: whichever is best.

    The beginning is a quarter, or less where a coordinate reaches zero before.

    Args:
        pair: the bodies.
        n: a unit direction.
        value: f(n).

    Returns:
        The new direction and its f.
    """
    at = tangent(pair, n)
    t_1, t_2 = _newton(at)
    move = vector(lambda i: at.first[i] * t_1 + at.second[i] * t_2)
    crossings = vector(lambda i: _crossing(n[i], move[i]))
    nearest = smallest(crossings)
    best = n
    for length in (jnp.ones_like(nearest), jnp.minimum(nearest, SHORT_STEP)):
        candidate = _moved(n, move, length, crossings)
        there = depth(pair, candidate)
        best = where(there < value, candidate, best)
        value = jnp.minimum(value, there)
    return best, value


def _slope(n_i: Scalars, g_i: Scalars, e_i: Scalars) -> Scalars:
    """The derivative of f in n_i; where n_i is zero, the smallest one."""
    at_kink = g_i - clip(g_i, -e_i, e_i)
    return jnp.where(n_i == 0, at_kink, g_i + jnp.sign(n_i) * e_i)


def _basis(n: Components) -> tuple[Components, Components]:
    """A basis of the tangent plane; its second vector is along a coordinate of zero."""
    size = vector(lambda i: abs(n[i]))
    is_0 = (size[0] <= size[1]) & (size[0] <= size[2])
    is_1 = ~is_0 & (size[1] <= size[2])
    x, y, z = n
    # n x e_i for the axis i of the smallest component.
    cross = (
        jnp.where(is_0, 0, jnp.where(is_1, -z, y)),
        jnp.where(is_0, z, jnp.where(is_1, 0, -x)),
        jnp.where(is_0, -y, jnp.where(is_1, x, 0)),
    )
    per_length = shared(1 / jnp.sqrt(dot(cross, cross)))
    first = vector(lambda i: cross[i] * per_length)
    second = (
        y * first[2] - z * first[1],
        z * first[0] - x * first[2],
        x * first[1] - y * first[0],
    )
    return first, second


def solve(at: Tangent, slopes: tuple[Scalars, Scalars]) -> tuple[Scalars, Scalars]:
    """Minus the inverse Hessian times the slopes; the Hessian lifted to be positive."""
    h_11, h_12, h_22, determinant = _lifted(at.hessian)
    t_1, t_2 = _against(h_11, h_12, h_22, slopes)
    divisor = jnp.where(determinant > 0, determinant, 1)
    return t_1 / divisor, t_2 / divisor


def _newton(at: Tangent) -> tuple[Scalars, Scalars]:
    """The step, no longer than LONGEST_STEP."""
    h_11, h_12, h_22, determinant = _lifted(at.hessian)
    t_1, t_2 = _against(h_11, h_12, h_22, at.slopes)
    length = jnp.sqrt(t_1 * t_1 + t_2 * t_2)
    divisor = jnp.maximum(determinant, length / LONGEST_STEP)
    divisor = jnp.where(divisor > 0, divisor, 1)
    return shared(t_1 / divisor), shared(t_2 / divisor)


def _lifted(hessian: Components) -> tuple[Scalars, Scalars, Scalars, Scalars]:
    """The Hessian with its smaller eigenvalue raised to FLOOR; its determinant."""
    h_11, h_12, h_22 = hessian
    apart = (h_11 - h_22) / 2
    smaller = (h_11 + h_22) / 2 - jnp.sqrt(apart * apart + h_12 * h_12)
    lift = jnp.maximum(FLOOR * (abs(h_11) + abs(h_22)) - smaller, 0)
    h_11, h_22 = h_11 + lift, h_22 + lift
    return h_11, h_12, h_22, h_11 * h_22 - h_12 * h_12


def _against(
    h_11: Scalars, h_12: Scalars, h_22: Scalars, slopes: tuple[Scalars, Scalars]
) -> tuple[Scalars, Scalars]:
    """The solution of h t = -slopes, times the determinant."""
    s_1, s_2 = slopes
    return h_12 * s_2 - h_22 * s_1, h_12 * s_1 - h_11 * s_2


def _crossing(n_i: Scalars, move_i: Scalars) -> Scalars:
    """At what share of the move a coordinate reaches zero; 2 if it does not."""
    crosses = n_i * move_i < 0
    return shared(jnp.where(crosses, -n_i / jnp.where(crosses, move_i, 1), 2))


def _moved(
    n: Components, move: Components, length: Scalars, crossings: Components
) -> Components:
    """Moved and normalised; what would change sign stops at zero."""
    there = vector(
        lambda i: jnp.where(crossings[i] <= length, 0, n[i] + length * move[i])
    )
    per_length = shared(1 / jnp.sqrt(dot(there, there)))
    return vector(lambda i: there[i] * per_length)
