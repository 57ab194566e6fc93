"""References in numpy, float64, by enumeration: none of jaxbe's formulas.

With delta = (k - sigma e) on the active coordinates A of a sign pattern sigma,
the multipliers are lambda = S_AA^-1 delta. Where sigma lambda >= 0 the value
delta . lambda is a lower bound of q, and the best of these bounds is q.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np


class Nearest(NamedTuple):
    """q (n,), its minimiser x in the box (n, 3) and multipliers (n, 3), box axes."""

    q: np.ndarray
    x: np.ndarray
    multipliers: np.ndarray


def scaled_distance(scene: Any) -> np.ndarray:
    """sqrt(q) of each pair: they overlap exactly if it is at most 1."""
    return np.sqrt(nearest_in(scene).q)


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
