"""The point of the box that is nearest to the ellipsoid's centre in its metric.

q(k, e) = min over |x_i| <= e_i of (x - k)^T N (x - k), the squared distance of
section 4 of the paper: from the centre of the sphere to the parallelepiped that
the box becomes when the ellipsoid is mapped to the unit sphere.

Theorem. For each of the six orders (i, j, l) clip one coordinate after the other
at its conditional optimum (see `jaxbe.metric`). The best of the six points is
the minimiser.

Proof. If k is in the box, every order gives k. Else the segment from k to the
minimiser enters the box where the minimiser is (inside, moving towards k would
improve it), through a face visible from k: x_i = clip(k_i) for some i. In the
plane of that face the problem is the same with one dimension less, the
conditional optimum in place of k: so x_j = clip(m_j) for one of the other two,
and on that line x_l = clip(m_l).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import NamedTuple

from jaxbe.choice import choose, minimum
from jaxbe.components import clip, vector, where
from jaxbe.metric import Metric
from jaxbe.types import Components, Flags, Scalars

ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


class Candidate(NamedTuple):
    """One of the six points, by what is left of it after clipping.

    Attributes:
        order: (i, j, l), the order of clipping.
        d: x - k.
        r_j: d_j minus its optimum in the plane of x_i; exactly 0 where not clipped.
        r_l: d_l minus its optimum on the line of x_i, x_j; exactly 0 likewise.
        q: (x - k)^T N (x - k), a sum of three squares.
    """

    order: tuple[int, int, int]
    d: Components
    r_j: Scalars
    r_l: Scalars
    q: Scalars


class Nearest(NamedTuple):
    """The minimiser.

    Attributes:
        q: (x - k)^T N (x - k).
        x: the nearest point of the box, in box coordinates.
        d: x - k.
        n: the multipliers N (k - x): they point from the box to the ellipsoid's
            centre, are normal to the ellipsoid through x, and separate the pair
            when q > 1. Zero, to rounding, where x is free, and when k is in the box.
        active: where x is on the bounds of the box.
    """

    q: Scalars
    x: Components
    d: Components
    n: Components
    active: tuple[Flags, Flags, Flags]


def candidates(k: Components, e: Components, m: Metric) -> Iterator[Candidate]:
    """The six points of the theorem, for the box |x_i| <= e_i and the centre k.

    All is reckoned from k: in a box much larger than the ellipsoid x itself has not the
    digits, and x - k taken from it would contradict the residuals.
    """
    low, high = _bounds(k, e)
    first = vector(lambda i: clip(0, low[i], high[i]))
    for i, j, l in ORDERS:
        d_i = first[i]
        t_j = m.in_plane[j][i] * d_i
        d_j = clip(t_j, low[j], high[j])
        t_l = -(m.on_line[l][i] * d_i + m.on_line[l][j] * d_j)
        d_l = clip(t_l, low[l], high[l])
        r_j = d_j - t_j
        r_l = d_l - t_l
        q = m.plane[i] * d_i * d_i + m.line[i][l] * r_j * r_j + m.point[l] * r_l * r_l
        d = _in_place((i, j, l), d_i, d_j, d_l)
        yield Candidate((i, j, l), d, r_j, r_l, q)


def squared_distance(k: Components, e: Components, m: Metric) -> Scalars:
    """q(k, e): the smallest of the candidates' values."""
    return functools.reduce(minimum, (c.q for c in candidates(k, e, m)))


def nearest(k: Components, e: Components, m: Metric) -> Nearest:
    """The best of the candidates, with its multipliers.

    The best has the smallest sum of q and its complementarity gap, which is zero at
    the minimiser: candidates whose q is equal to rounding can have multipliers that
    differ by the square root of that.
    """
    low, high = _bounds(k, e)
    first, *others = candidates(k, e, m)
    n = _multipliers(first, m)
    best = (first.q + _gap(first, n, low, high), first.q, first.d, n)
    for c in others:
        n = _multipliers(c, m)
        key = c.q + _gap(c, n, low, high)
        better = key < best[0]
        best = (
            choose(better, key, best[0]),
            choose(better, c.q, best[1]),
            where(better, c.d, best[2]),
            where(better, n, best[3]),
        )
    _, q, d, n = best
    # Not where n is zero: a free coordinate of a sphere has an n of rounding alone.
    on_bound = [(d[i] <= low[i]) | (d[i] >= high[i]) for i in range(3)]
    active = (on_bound[0], on_bound[1], on_bound[2])
    return Nearest(q, vector(lambda i: k[i] + d[i]), d, n, active)


def _bounds(k: Components, e: Components) -> tuple[Components, Components]:
    """The box as seen from k: the range of d = x - k."""
    return vector(lambda i: -e[i] - k[i]), vector(lambda i: e[i] - k[i])


def _gap(c: Candidate, n: Components, low: Components, high: Components) -> Scalars:
    """Complementarity, e.|n| - n.x >= 0: zero if n pushes x against the bounds alone.

    The bounds are compared with d before the product, so that it is an exact zero. The
    coordinate clipped last has none: n_l = -N_ll r_l pushes the way it was clipped.
    """
    i, j, _ = c.order

    def slack(p: int) -> Scalars:
        return n[p] * (choose(n[p] < 0, low[p], high[p]) - c.d[p])

    return slack(i) + slack(j)


def _multipliers(c: Candidate, m: Metric) -> Components:
    """N (k - x) from the three residuals.

    Never formed as that product, which loses a digit for each power of ten of the
    aspect ratio.
    """
    i, j, l = c.order
    on_line = m.line[i][l] * c.r_j
    on_point = m.point[l] * c.r_l
    n_i = m.in_plane[j][i] * on_line - m.plane[i] * c.d[i] - m.on_line[l][i] * on_point
    n_j = -(on_line + m.on_line[l][j] * on_point)
    return _in_place(c.order, n_i, n_j, -on_point)


def _in_place(order: tuple[int, int, int], *values: Scalars) -> Components:
    """The vector whose component order[0] is values[0], and so on."""
    return vector(lambda axis: values[order.index(axis)])
