"""The pairs of the map of extremes: by aspect ratio, distance and dtype."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import extended, scenes
from benchmarks.scenes import Scene

ASPECTS = tuple(10.0**i for i in range(8))
SIZES = (-60, -40, -20, 0, 20, 40, 60)
"""Powers of two, in metres: 8.7e-19 to 1.2e18."""

DISTANCES: tuple[str | float, ...] = (
    "coincident", "deep", "touching", 1e-3, 1.0, 1e3, 1e6,
)  # fmt: skip
"""Centres that coincide; growth distances of 0.01 to 0.9; within a rounding to 0.1 of
1; or the gap between the bodies along the line of centres, in the longest lengths."""

DTYPES = ("float32", "float64", "bfloat16")
COMPUTED = {"float32": np.float32, "float64": np.float64, "bfloat16": np.float32}
"""What the library computes in; its rounding is the measure of all errors."""

ALIGNED = 0.15
"""The share of pairs with axes along the world's: as many ties as can be."""

SAME_AXES = 0.15
"""Of the others, those whose axes are the same: ties but for rounding."""


def pairs(aspect: float, distance: str | float, dtype: str, n: int) -> Scene:
    """Pairs of one cell, rounded to the dtype, in the dtype that is computed in.

    In a third of them both bodies have the aspect ratio, in a third the ellipsoid
    alone, in a third the box: rods, plates and between. The other one is a sphere or
    a cube. The longest lengths are 1 to 2 and within a factor of two.
    """
    rng = np.random.default_rng([int(np.log10(aspect)), DISTANCES.index(distance)])
    scene, offset = _bodies(rng, aspect, n)
    scene = rounded(scene, dtype)
    return rounded(_placed(scene, offset, distance, dtype, rng), dtype)


def rounded(scene: Scene, dtype: str) -> Scene:
    """As the library takes them: axes in bfloat16 are made orthonormal again."""
    if dtype != "bfloat16":
        return scene.astype(COMPUTED[dtype])
    narrow = [jnp.asarray(x, jnp.bfloat16) for x in scene]
    bodies = jaxbe.Box(*narrow[:3]), jaxbe.Ellipsoid(*narrow[3:])
    return Scene(*(np.asarray(x) for b in bodies for x in b.fields().values()))


def scaled(scene: Scene, exponent: int) -> Scene:
    """By a power of two, exactly."""
    return scenes.scaled(scene, scene.a.dtype.type(2.0**exponent))


def _bodies(
    rng: np.random.Generator, aspect: float, n: int
) -> tuple[Scene, np.ndarray]:
    """Bodies about one centre, and offsets K - C, of any length."""
    base = scenes.random(n, int(rng.integers(2**31)))
    aligned = scenes.axis_aligned(base, int(rng.integers(2**31)))
    pick = (rng.random(n) < ALIGNED)[:, None, None]
    U, V = (np.where(pick, *x) for x in ((aligned.U, base.U), (aligned.V, base.V)))
    # Of its own generator: the other pairs are those of maps before.
    draws = np.random.default_rng([n, int(np.log10(aspect))]).random((n, 1, 1))
    V = np.where((draws < SAME_AXES) & ~pick, U, V)
    which = rng.integers(0, 3, n)[:, None]
    e = np.where(which == 1, 1.0, _lengths(rng, aspect, n)) * rng.uniform(1, 2, (n, 1))
    a = np.where(which == 2, 1.0, _lengths(rng, aspect, n)) * rng.uniform(1, 2, (n, 1))
    C = np.where(rng.random((n, 1)) < 0.5, 0, rng.normal(size=(n, 3)))
    k = rng.uniform(-1, 1, (n, 3)) * (e + scenes.half_widths(U, V, a))
    offset = np.einsum("nij,nj->ni", U, k)
    return Scene(C, U, e, C, V, a), offset


def _lengths(rng: np.random.Generator, aspect: float, n: int) -> np.ndarray:
    """1, 1 / aspect, and one of these or between, in any order."""
    between = np.exp(rng.uniform(-np.log(aspect), 0, n))
    middle = np.choose(rng.integers(0, 3, n), [np.full(n, 1 / aspect), 1, between])
    lengths = np.stack([np.ones(n), middle, np.full(n, 1 / aspect)], axis=1)
    return np.take_along_axis(lengths, np.argsort(rng.random((n, 3)), axis=1), axis=1)


def _placed(
    scene: Scene, offset: np.ndarray, distance: Any, dtype: str, rng: Any
) -> Scene:
    """The ellipsoids moved along their offsets to the distance of the cell."""
    n = scene.size
    there = scene._replace(C=np.zeros((n, 3)), K=offset)
    touching = offset / extended.growth_distance(there).value.astype(float)[:, None]
    C = scene.C.astype(float)
    if distance == "coincident":
        return scene._replace(K=C)
    if distance == "deep":
        return scene._replace(K=C + touching * rng.uniform(0.01, 0.9, (n, 1)))
    if distance == "touching":
        # The box at the origin, for an offset of other centres is rounded again.
        least = np.log(float(jnp.finfo(dtype).eps))
        growth = np.exp(rng.uniform(least, np.log(0.1), (n, 1)))
        K = touching * (1 + growth * rng.choice([-1, 1], (n, 1)))
        return scene._replace(C=np.zeros((n, 3)), K=K)
    longest = np.maximum(scene.e.max(axis=1), scene.a.max(axis=1))
    far = distance * longest / np.linalg.norm(touching, axis=1)
    return scene._replace(K=C + touching * (1 + far[:, None]))
