"""The truth for many pairs: proofs in float64, the rational oracle for the rest.

A point of the box within the ellipsoid proves overlap, a direction that separates
proves the reverse; where either inequality holds by more than all rounding can
amount to, it holds. Where the point or direction comes from does not matter.
"""

from __future__ import annotations

import numpy as np

from benchmarks import reference
from tests import oracle

ROUNDING = 64 * np.finfo(np.float64).eps
"""More than gamma_m of every sum below (at most 20 roundings each)."""

CHUNK = 100_000


def overlaps(scene) -> np.ndarray:
    """The exact verdict of every pair, on the very floats given."""
    chunks = range(0, scene.size, CHUNK)
    return np.concatenate([_overlaps(scene.part(slice(i, i + CHUNK))) for i in chunks])


def _overlaps(scene) -> np.ndarray:
    proved, undecided = proofs(scene)
    for i in np.flatnonzero(undecided):
        proved[i] = oracle.overlaps(exact(scene, i))
    return proved


def exact(scene, i) -> oracle.ExactPair:
    return oracle.exact(*(x[i].astype(np.float64).tolist() for x in scene))


def distance_from_touching(scene, i) -> float:
    """|sqrt(q) - 1| of pair i, from the exact q."""
    q = oracle.squared_distance(exact(scene, i))
    # q - 1 is exact: sqrt(float(q)) - 1 would lose the digits wanted.
    return abs(float(q - 1)) / (1 + float(q) ** 0.5)


def worst_wrong(scene, truth, verdicts) -> float:
    """The largest |sqrt(q) - 1| of a pair with a wrong verdict; 0 if there is none.

    Float64 says which of the wrong pairs are the furthest from touching, exact
    arithmetic how far these are.
    """
    wrong = np.flatnonzero(np.asarray(verdicts) != truth)
    estimate = abs(np.sqrt(reference.nearest_in(scene.part(wrong)).q) - 1)
    furthest = wrong[np.argsort(-estimate)[:20]]
    return max((distance_from_touching(scene, i) for i in furthest), default=0.0)


def proofs(scene) -> tuple[np.ndarray, np.ndarray]:
    """(overlap proved, nothing proved), each (n,)."""
    hint = reference.nearest_in(scene)
    overlap = proves_overlap(scene, hint.x)
    separate = proves_separation(scene, hint.multipliers)
    assert not np.any(overlap & separate)
    return overlap, ~(overlap | separate)


def proves_separation(scene, n) -> np.ndarray:
    """Whether n.k > e.|n| + sqrt(n^T S n) beyond doubt."""
    k, R, k_size, R_size = _canonical(scene)
    e, a = scene.e.astype(np.float64), scene.a.astype(np.float64)
    n = n / np.maximum(abs(n).max(axis=1, keepdims=True), 1e-300)
    gap = np.sum(n * k, axis=1) - np.sum(abs(n) * e, axis=1)
    reach = np.linalg.norm(a * np.einsum("nip,ni->np", R, n), axis=1)
    gap_size = np.sum(abs(n) * (k_size + e), axis=1)
    reach_size = np.linalg.norm(a * np.einsum("nip,ni->np", R_size, abs(n)), axis=1)
    return gap - reach > ROUNDING * (gap_size + reach_size)


def proves_overlap(scene, x) -> np.ndarray:
    """Whether |y| <= 1 beyond doubt, for the y with R diag(a) y = x - k.

    R is orthonormal only to the inputs' rounding: with E = I - R^T R,
    R^-1 = (I + E + E^2 (I - E)^-1) R^T.
    """
    k, R, k_size, R_size = _canonical(scene)
    e, a = scene.e.astype(np.float64), scene.a.astype(np.float64)
    assert np.all(abs(x) <= e)
    w = np.einsum("nip,ni->np", R, x - k)
    w_size = np.einsum("nip,ni->np", R_size, abs(x) + k_size)
    E = np.eye(3) - R.transpose(0, 2, 1) @ R
    y = (w + np.einsum("npq,nq->np", E, w)) / a
    defect = np.linalg.norm(E, axis=(1, 2)) + ROUNDING
    neglected = 2 * defect**2 * np.linalg.norm(w_size, axis=1)
    rounding = ROUNDING * (w_size + np.linalg.norm(w_size, axis=1, keepdims=True))
    error = np.linalg.norm((rounding + neglected[:, None]) / a, axis=1)
    length = np.linalg.norm(y, axis=1)
    return (length * (1 + ROUNDING) + error <= 1) & (defect < 0.1)


def _canonical(scene):
    """k and R, and the same sums of absolute values."""
    k, R = reference.canonical(scene)
    U, V = abs(scene.U.astype(np.float64)), abs(scene.V.astype(np.float64))
    # K - C is rounded once, so its size counts, not those of K and C.
    offset = abs(scene.K.astype(np.float64) - scene.C.astype(np.float64))
    k_size = np.einsum("nri,nr->ni", U, offset)
    return k, R, k_size, np.einsum("nri,nrj->nij", U, V)
