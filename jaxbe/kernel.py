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

import jax.numpy as jnp

from jaxbe.components import clip, where
from jaxbe.metric import Metric
from jaxbe.types import Components, Scalars

ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


class Candidate(NamedTuple):
    """One of the six points, by what is left of it after clipping.

    Attributes:
        order: (i, j, l), the order of clipping.
        d_i: x_i - k_i.
        r_j: x_j minus its optimum in the plane of x_i; exactly 0 where not clipped.
        r_l: x_l minus its optimum on the line of x_i, x_j; exactly 0 likewise.
        q: (x - k)^T N (x - k), a sum of three squares.
    """

    order: tuple[int, int, int]
    d_i: Scalars
    r_j: Scalars
    r_l: Scalars
    q: Scalars


def candidates(k: Components, e: Components, m: Metric) -> Iterator[Candidate]:
    """The six points of the theorem, for the box |x_i| <= e_i and the centre k."""
    first = [clip(k[i], e[i]) - k[i] for i in range(3)]
    for i, j, l in ORDERS:
        d_i = first[i]
        m_j = k[j] + m.in_plane[j][i] * d_i
        x_j = clip(m_j, e[j])
        m_l = k[l] - (m.on_line[l][i] * d_i + m.on_line[l][j] * (x_j - k[j]))
        r_j = x_j - m_j
        r_l = clip(m_l, e[l]) - m_l
        q = m.plane[i] * d_i * d_i + m.line[i][l] * r_j * r_j + m.point[l] * r_l * r_l
        yield Candidate((i, j, l), d_i, r_j, r_l, q)


def squared_distance(k: Components, e: Components, m: Metric) -> Scalars:
    """q(k, e): the smallest of the candidates' values."""
    return functools.reduce(jnp.minimum, (c.q for c in candidates(k, e, m)))


def normal(k: Components, e: Components, m: Metric) -> Components:
    """The multipliers n = N (k - x) at the minimiser x, in box axes.

    They point from the box to the ellipsoid's centre and separate the pair, or
    touch it, when q >= 1; zero when k is in the box. Never formed as that
    product, which loses a digit for each power of ten of the aspect ratio:
    coordinates that are free at the minimiser get exact zeros.
    """
    first, *others = candidates(k, e, m)
    best_q, best_n = first.q, _multipliers(first, m)
    for c in others:
        better = c.q < best_q
        best_q = jnp.where(better, c.q, best_q)
        best_n = where(better, _multipliers(c, m), best_n)
    return best_n


def _multipliers(c: Candidate, m: Metric) -> Components:
    i, j, l = c.order
    on_line = m.line[i][l] * c.r_j
    on_point = m.point[l] * c.r_l
    n = {
        i: m.in_plane[j][i] * on_line - m.plane[i] * c.d_i - m.on_line[l][i] * on_point,
        j: -(on_line + m.on_line[l][j] * on_point),
        l: -on_point,
    }
    return n[0], n[1], n[2]
