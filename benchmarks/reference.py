"""References in numpy, float64, by enumeration: none of jaxbe's formulas.

With delta = (k - sigma e) on the active coordinates A of a sign pattern sigma,
the multipliers are lambda = S_AA^-1 delta. Where sigma lambda >= 0 the value
delta . lambda is a lower bound of q, and the best of these bounds is q.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

LONG = np.longdouble


class Nearest(NamedTuple):
    """q (n,), its minimiser x in the box (n, 3) and multipliers (n, 3), box axes."""

    q: np.ndarray
    x: np.ndarray
    multipliers: np.ndarray


def scaled_distance(scene: Any) -> np.ndarray:
    """sqrt(q) of each pair: they overlap exactly if it is at most 1."""
    return np.sqrt(nearest_in(scene).q)


def value_along(scene: Any, normal: np.ndarray) -> np.ndarray:
    """The signed distance along normals (from ellipsoid to box), of any length.

    In extended precision, for the floats as they are: w.(K - C) - sum e_i |u_i.w| -
    sqrt(sum (a_p v_p.w)^2) for the unit w. No direction gives more than the distance.
    """
    C, U, e, K, V, a = (x.astype(LONG) for x in scene)
    w = -normal.astype(LONG)
    w = w / np.linalg.norm(w.astype(float), axis=1, keepdims=True)
    w = w / np.sqrt(np.sum(w * w, axis=1, keepdims=True))
    extent = np.sum(e * abs(np.einsum("nri,nr->ni", U, w)), axis=1)
    radius = np.sqrt(np.sum((a * np.einsum("nrp,nr->np", V, w)) ** 2, axis=1))
    return (np.sum(w * (K - C), axis=1) - extent - radius).astype(np.float64)


def canonical(scene: Any) -> tuple[np.ndarray, np.ndarray]:
    """K (n, 3) and R (n, 3, 3), in float64."""
    C, U, _, K, V, _ = (x.astype(np.float64) for x in scene)
    return np.einsum("nri,nr->ni", U, K - C), np.einsum("nri,nrj->nij", U, V)


def shape_matrix(R: np.ndarray, a: np.ndarray) -> np.ndarray:
    """S = R diag(a^2) R^T."""
    scaled = R * a[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)


def nearest(k: np.ndarray, e: np.ndarray, S: np.ndarray) -> Nearest:
    """The nearest point of the box in the metric S^-1, over all 26 active sets."""
    n = k.shape[0]
    best = Nearest(np.zeros(n), np.clip(k, -e, e), np.zeros((n, 3)))
    for sides in itertools.product((0, -1, 1), repeat=3):
        active = [i for i in range(3) if sides[i]]
        if not active:
            continue
        s = np.array([sides[i] for i in active], float)
        delta = k[:, active] - s * e[:, active]
        multipliers = np.linalg.solve(S[:, active][:, :, active], delta[..., None])[
            ..., 0
        ]
        q = np.sum(delta * multipliers, axis=1)
        better = np.all(s * multipliers >= 0, axis=1) & (q > best.q)
        x = k - np.einsum("nia,na->ni", S[:, :, active], multipliers)
        x[:, active] = s * e[:, active]
        best.q[better] = q[better]
        best.x[better] = np.clip(x, -e, e)[better]
        best.multipliers[better] = 0
        rows = np.flatnonzero(better)
        best.multipliers[rows[:, None], active] = multipliers[better]
    return best


def nearest_in(scene: Any) -> Nearest:
    """The nearest points of the pairs of a `benchmarks.scenes.Scene`."""
    k, R = canonical(scene)
    return nearest(
        k, scene.e.astype(np.float64), shape_matrix(R, scene.a.astype(np.float64))
    )


def growth_distance(scene: Any, steps: int = 12) -> np.ndarray:
    """The factor by which both bodies must be scaled about their centres to touch."""
    k, R = canonical(scene)
    e, a = scene.e.astype(np.float64), scene.a.astype(np.float64)
    S = shape_matrix(R, a)
    alpha = np.max(abs(k) / (e + np.sqrt(np.einsum("nii->ni", S))), axis=1)
    for _ in range(steps):
        found = nearest(k, alpha[:, None] * e, S)
        extent = np.sum(e * abs(found.multipliers), axis=1)
        alpha = (found.q + alpha * extent) / (extent + np.sqrt(found.q))
    return alpha


def growth_by_bisection(scene: Any) -> np.ndarray:
    """The growth distance by bisection, to about 16 digits: see `bisect_growth`."""
    C, U, e, K, V, a = (x.astype(np.longdouble) for x in scene)
    k, R = np.einsum("nri,nr->ni", U, K - C), np.einsum("nri,nrj->nij", U, V)
    return bisect_growth(k, R, e, a)


def bisect_growth(
    k: np.ndarray, R: np.ndarray, e: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """The root of sqrt(q(k, alpha e)) = alpha for canonical pairs, by bisection.

    Every number at its exact value, sums in extended precision (64 bits on x86; a
    float64's 53 where numpy has nothing longer): the inverses lose the square of
    the aspect ratio. Bisection in float64 proposes narrow brackets; where extended
    precision does not confirm one it begins anew.

    Returns:
        (n,), of the extended type.
    """
    parts = range(0, k.shape[0], 5000)
    results = [
        _bisect_part(*(x[i : i + 5000].astype(np.longdouble) for x in (k, R, e, a)))
        for i in parts
    ]
    return np.concatenate(results) if results else np.zeros(0, np.longdouble)


class _Patches(NamedTuple):
    """Multipliers slope * alpha + offset (19, 3, n) of every sign pattern.

    Only of those with a positive side: with k >= 0 the others have delta >= 0 and
    multipliers <= 0, so their value is no bound above zero.
    """

    sides: np.ndarray
    offset: np.ndarray
    slope: np.ndarray

    def part(self, which: np.ndarray) -> _Patches:
        return _Patches(self.sides, self.offset[..., which], self.slope[..., which])


def _bisect_part(
    k: np.ndarray, R: np.ndarray, e: np.ndarray, a: np.ndarray
) -> np.ndarray:
    # Mirrored into the octant k >= 0.
    octant = np.where(k < 0, -1, 1).astype(k.dtype)
    k, R = abs(k), octant[:, :, None] * R
    patches = _patches(k, e, shape_matrix(R, a))
    k, e = k.T, e.T
    # The ellipsoid alone must reach the centre of the box at the latest.
    wide = np.zeros_like(k[0]), np.sqrt(np.maximum(_squared(patches, k, e, 0), 0))
    rough = _Patches(*(x.astype(np.float64) for x in patches))
    found = _root(rough, k.astype(np.float64), e.astype(np.float64), *wide, 28)
    found = found.astype(k.dtype)
    low, high = found * (1 - 1e-6), found * (1 + 1e-6)
    sound = (_gap(patches, k, e, high) <= 0) & (_gap(patches, k, e, low) >= 0)
    alpha = _root(patches, k, e, low, high, 0)
    rest = ~sound
    if np.any(rest):
        wide = tuple(x[rest] for x in wide)
        alpha[rest] = _root(patches.part(rest), k[:, rest], e[:, rest], *wide, 90)
    return alpha


def _root(
    patches: _Patches,
    k: np.ndarray,
    e: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    bisections: int,
) -> np.ndarray:
    """Bisection, and in the bracket that remains three steps of false position."""
    low, high = low.astype(k.dtype), high.astype(k.dtype)
    for _ in range(bisections):
        middle = (low + high) / 2
        beyond = _gap(patches, k, e, middle) > 0
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    at_low, at_high = _gap(patches, k, e, low), _gap(patches, k, e, high)
    for _ in range(3):
        # The gap is convex: the chord's root is on the upper side of the true one.
        fall = at_low - at_high
        share = np.where(fall > 0, at_low / np.where(fall > 0, fall, 1), 0)
        high = low + np.clip(share, 0, 1) * (high - low)
        at_high = _gap(patches, k, e, high)
    return high


def _gap(
    patches: _Patches, k: np.ndarray, e: np.ndarray, alpha: np.ndarray
) -> np.ndarray:
    """sqrt(q) - alpha: positive as long as the bodies grown by alpha are apart."""
    return np.sqrt(_squared(patches, k, e, alpha)) - alpha


def _squared(patches: _Patches, k: np.ndarray, e: np.ndarray, alpha: Any) -> np.ndarray:
    """q(k, alpha e), as in `nearest`; k and e are (3, n)."""
    sides = patches.sides[..., None]
    multipliers = patches.offset + patches.slope * alpha
    q = np.sum((k - sides * (alpha * e)) * multipliers, axis=1)
    feasible = np.all(sides * multipliers >= 0, axis=1)
    return np.max(np.where(feasible, q, 0), axis=0)


def _patches(k: np.ndarray, e: np.ndarray, S: np.ndarray) -> _Patches:
    patterns = [s for s in itertools.product((0, -1, 1), repeat=3) if 1 in s]
    offset = np.zeros((19, 3, k.shape[0]), k.dtype)
    slope = np.zeros_like(offset)
    for position, sides in enumerate(patterns):
        active = [i for i in range(3) if sides[i]]
        inverse = _inverse(S[:, active][:, :, active])
        s = np.array([sides[i] for i in active], k.dtype)
        offset[position, active] = np.einsum("nij,nj->in", inverse, k[:, active])
        slope[position, active] = -np.einsum("nij,nj->in", inverse, s * e[:, active])
    return _Patches(np.array(patterns, k.dtype), offset, slope)


def _inverse(m: np.ndarray) -> np.ndarray:
    """Inverses by cofactors, of any numpy type (numpy.linalg has float64 only)."""
    size = m.shape[-1]
    if size == 1:
        return 1 / m
    if size == 2:
        adjugate = np.stack([m[:, 1, 1], -m[:, 0, 1], -m[:, 1, 0], m[:, 0, 0]], axis=1)
        determinant = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]
        return adjugate.reshape(-1, 2, 2) / determinant[:, None, None]
    rows = [np.cross(m[:, (i + 1) % 3], m[:, (i + 2) % 3]) for i in range(3)]
    determinant = np.sum(m[:, 0] * rows[0], axis=1)
    return np.stack(rows, axis=2) / determinant[:, None, None]
