"""Answers and derivatives in numpy's extended precision, at every aspect ratio.

The pair as it is given: k = U^T (K - C), R = U^T V and S = R diag(a^2) R^T, whether
or not the axes are orthonormal to the last digit. The metric is the true inverse of S,
by the cofactors of R: a float's rounding of an axis would else show at aspect ratios
of 1e5. Where numpy has nothing longer than a float64, nor has this.

Every answer is the largest value of a quotient over directions n (in box axes). So it
is evaluated at the n found, where it is stationary, from the numbers given.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.reference import LONG
from benchmarks.scenes import Scene

ORDERS = tuple(itertools.permutations(range(3)))
MOST_STEPS = 200


class Canonical(NamedTuple):
    """k (n, 3), R (n, 3, 3), e, a, S and its adjugate and determinant."""

    k: np.ndarray
    R: np.ndarray
    e: np.ndarray
    a: np.ndarray
    S: np.ndarray
    adjugate: np.ndarray
    determinant: np.ndarray

    def part(self, which: Any) -> Canonical:
        return Canonical(*(x[which] for x in self))


class Answer(NamedTuple):
    """A value, its direction and what its derivatives are made of.

    Attributes:
        value: (n,).
        n: (n, 3), in box axes, such that value = n.k - of_extent E - of_radius s up to
            terms that are constant in the pair.
        of_extent: (n,), the factor of E = e.|n|.
        of_radius: (n,), of s = sqrt(n^T S n).
    """

    value: np.ndarray
    n: np.ndarray
    of_extent: np.ndarray
    of_radius: np.ndarray


def canonical(pairs: Scene) -> Canonical:
    """The canonical pair, without rounding that counts."""
    C, U, e, K, V, a = (x.astype(LONG) for x in pairs)
    R = _product(np.swapaxes(U, 1, 2), V)
    k = np.einsum("nri,nr->ni", U, K - C)
    B = R * a[:, None, :]
    cofactors = (
        _cofactors(R)
        * np.stack([a[:, 1] * a[:, 2], a[:, 2] * a[:, 0], a[:, 0] * a[:, 1]], axis=1)[
            :, None, :
        ]
    )
    determinant = np.sum(B[:, 0] * cofactors[:, 0], axis=1) ** 2
    S, adjugate = (_product(m, np.swapaxes(m, 1, 2)) for m in (B, cofactors))
    return Canonical(k, R, e, a, S, adjugate, determinant)


def scaled_distance(pairs: Scene) -> Answer:
    """sqrt(q), the largest (n.k - E) / s; zero with n = 0 if the centre is inside."""
    pair = canonical(pairs)
    n = nearest(pair, pair.e)[1]
    s = _radius(pair, n)
    inside = s == 0
    n = n / np.where(inside, 1, s)[:, None]
    value = np.where(inside, 0, np.sum(n * pair.k, axis=1) - _extent(pair, n))
    return Answer(value, n, np.ones_like(value), value)


def growth_distance(pairs: Scene, start: np.ndarray | None = None) -> Answer:
    """1 + margin, the largest n.k / (E + s)."""
    pair = canonical(pairs)
    width = np.sqrt(np.einsum("nii->ni", pair.S))
    slab = abs(pair.k) / (pair.e + width)
    alpha = np.max(slab, axis=1)
    face = np.argmax(slab, axis=1)[:, None]
    best = np.zeros_like(pair.k)
    np.put_along_axis(best, face, np.take_along_axis(np.sign(pair.k), face, 1), 1)
    if start is not None:
        alpha = np.maximum(alpha, _quotient(pair, start))
        best = np.where((alpha > np.max(slab, axis=1))[:, None], start, best)

    def step(rows: np.ndarray) -> np.ndarray:
        part = pair.part(rows)
        n = nearest(part, alpha[rows, None] * part.e)[1]
        new = _quotient(part, n)
        better = new > alpha[rows]
        grown = better & (new > alpha[rows] * (1 + 4 * np.finfo(LONG).eps))
        alpha[rows[better]], best[rows[better]] = new[better], n[better]
        return rows[grown]

    _repeat(step, np.flatnonzero(alpha > 0))
    reach = _extent(pair, best) + _radius(pair, best)
    n = best / np.where(reach > 0, reach, 1)[:, None]
    return Answer(alpha, n, alpha, alpha)


def distance(pairs: Scene, start: np.ndarray | None = None) -> Answer:
    """The Euclidean distance of pairs that are apart; zero with n = 0 for others."""
    pair = canonical(pairs)
    q, n = nearest(pair, pair.e)
    apart = q > 1
    low = np.zeros_like(q)
    high = np.sqrt(np.sum(pair.k**2, axis=1)) * np.max(pair.a, axis=1)
    square = np.maximum(np.sum(n * n, axis=1), np.finfo(LONG).tiny)
    mu = _radius(pair, n) ** 2 * np.maximum(_radius(pair, n) - 1, 0) / square
    mu = np.clip(mu if start is None else start, low, high)
    best = n
    value = np.where(apart, along(pair, n), 0)

    def step(rows: np.ndarray) -> np.ndarray:
        part, at = pair.part(rows), mu[rows]
        swollen = inflated(part, at)
        n = nearest(swollen, part.e)[1]
        s = _radius(part, n)
        new = along(part, n)
        better = new > value[rows]
        value[rows[better]], best[rows[better]] = new[better], n[better]
        low[rows] = np.where(s > 1, at, low[rows])
        high[rows] = np.where(s > 1, high[rows], at)
        l, h = low[rows], high[rows]
        newton = at + s * s * (s - 1) / _slope(swollen, part.S, n)
        middle = np.sqrt(np.maximum(l, h * LONG(1e-30)) * h)
        usable = (newton > l) & (newton < h)
        mu[rows] = np.where(usable, newton, middle)
        moved = abs(mu[rows] - at) > 1e-18 * at
        return rows[moved & (h - l > 1e-18 * h) & (s != 1)]

    _repeat(step, np.flatnonzero(apart))
    length = np.sqrt(np.sum(best * best, axis=1))
    n = np.where(apart[:, None], best / np.where(length > 0, length, 1)[:, None], 0)
    one = np.ones_like(value)
    return Answer(value, n, one, one)


def gradient(pairs: Scene, at: Answer) -> Scene:
    """The derivatives of an answer in the six fields, with its n held."""
    C, U, _, K, V, a = (x.astype(LONG) for x in pairs)
    world = np.einsum("nri,ni->nr", U, at.n)
    along = np.einsum("nrp,nr->np", V, world)
    s = np.sqrt(np.sum((a * along) ** 2, axis=1))
    share = a * along * (at.of_radius / np.where(s > 0, s, 1))[:, None]
    reach = a * share
    arm = K - C - np.einsum("nrp,np->nr", V, reach)
    return Scene(
        -world,
        arm[:, :, None] * at.n[:, None, :],
        -at.of_extent[:, None] * abs(at.n),
        world,
        -world[:, :, None] * reach[:, None, :],
        -along * share,
    )


def nearest(pair: Canonical, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The kernel of `jaxbe.kernel` at half extents e: q (n,) and multipliers (n, 3)."""
    low, high = -e - pair.k, e - pair.k
    found = [_candidate(order, low, high, pair) for order in ORDERS]
    keys = np.stack([key for key, *_ in found])
    choice = np.argmin(keys, axis=0)[None]
    q = np.take_along_axis(np.stack([x[1] for x in found]), choice, 0)[0]
    n = np.stack([x[2] for x in found])
    return q, np.take_along_axis(n, choice[..., None], 0)[0]


def inflated(pair: Canonical, mu: np.ndarray) -> Canonical:
    """With S + mu I in place of S; R and a are left as they are."""
    S, adjugate = pair.S, pair.adjugate
    identity = np.eye(3, dtype=S.dtype)
    trace, trace_2 = (np.einsum("nii->n", m) for m in (S, adjugate))
    swollen = adjugate + mu[:, None, None] * (
        (trace + mu)[:, None, None] * identity - S
    )
    determinant = pair.determinant + mu * (trace_2 + mu * (trace + mu))
    return pair._replace(
        S=S + mu[:, None, None] * identity, adjugate=swollen, determinant=determinant
    )


def _candidate(
    order: tuple[int, ...], low: np.ndarray, high: np.ndarray, pair: Canonical
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Its q plus the complementarity gap, its q and its multipliers."""
    i, j, l = order
    S, N, D = pair.S, pair.adjugate, pair.determinant
    d_i = np.clip(0, low[:, i], high[:, i])
    t_j = S[:, i, j] / S[:, i, i] * d_i
    d_j = np.clip(t_j, low[:, j], high[:, j])
    t_l = -(N[:, l, i] * d_i + N[:, l, j] * d_j) / N[:, l, l]
    d_l = np.clip(t_l, low[:, l], high[:, l])
    r_j, r_l = d_j - t_j, d_l - t_l
    line, point = S[:, i, i] / N[:, l, l] * r_j, N[:, l, l] / D * r_l
    q = d_i * d_i / S[:, i, i] + line * r_j + point * r_l
    n = np.zeros_like(low)
    n[:, l] = -point
    n[:, j] = -(line + N[:, l, j] / D * r_l)
    n[:, i] = S[:, i, j] / S[:, i, i] * line - d_i / S[:, i, i] - N[:, l, i] / D * r_l
    d = np.stack([d_i, d_j, d_l], axis=1)[:, np.argsort(order)]
    gap = np.sum(n * (np.where(n < 0, low, high) - d), axis=1)
    return q + gap, q, n


def _slope(pair: Canonical, S: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Minus half the derivative of s^2 in mu, on the active set."""
    active = n != 0
    both = active[:, :, None] & active[:, None, :]
    m = np.where(both, pair.S, np.eye(3, dtype=S.dtype))
    cofactors = _cofactors(m)
    inverse = cofactors / np.sum(m[:, 0] * cofactors[:, 0], axis=1)[:, None, None]
    support = np.where(active, np.einsum("nij,nj->ni", S, n), 0)
    slope = np.einsum("ni,nij,nj->n", support, inverse, n)
    return np.where(slope > 0, slope, np.finfo(LONG).max)


def _repeat(step: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> None:
    """Steps for the rows that still move."""
    for _ in range(MOST_STEPS):
        if not rows.size:
            return
        rows = step(rows)


def _quotient(pair: Canonical, n: np.ndarray) -> np.ndarray:
    reach = _extent(pair, n) + _radius(pair, n)
    return np.sum(n * pair.k, axis=1) / np.where(reach > 0, reach, 1)


def along(pair: Canonical, n: np.ndarray) -> np.ndarray:
    """The distance along n; minus infinity for n = 0."""
    length = np.sqrt(np.sum(n * n, axis=1))
    value = np.sum(n * pair.k, axis=1) - _extent(pair, n) - _radius(pair, n)
    return np.where(length > 0, value / np.where(length > 0, length, 1), -np.inf)


def _extent(pair: Canonical, n: np.ndarray) -> np.ndarray:
    return np.sum(pair.e * abs(n), axis=1)


def _radius(pair: Canonical, n: np.ndarray) -> np.ndarray:
    along = pair.a * np.einsum("nip,ni->np", pair.R, n)
    return np.sqrt(np.sum(along * along, axis=1))


def _product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.einsum("nij,njk->nik", x, y)


def _cofactors(m: np.ndarray) -> np.ndarray:
    """The matrix of cofactors: the determinant times the inverse, transposed."""
    rows = [np.cross(m[:, (i + 1) % 3], m[:, (i + 2) % 3]) for i in range(3)]
    return np.stack(rows, axis=1)
