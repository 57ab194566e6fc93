"""Pairs in numpy: the six arrays of each kind of scene the kernels must survive."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxbe
from tests import reference


class Scene(NamedTuple):
    """Batches of n pairs: (n, 3), (n, 3, 3), (n, 3) for either body."""

    C: np.ndarray
    U: np.ndarray
    e: np.ndarray
    K: np.ndarray
    V: np.ndarray
    a: np.ndarray

    def astype(self, dtype) -> Scene:
        return Scene(*(x.astype(dtype) for x in self))

    def take(self, index) -> Scene:
        return Scene(*(x[index] for x in self))

    @property
    def n(self) -> int:
        return self.C.shape[0]

    def bodies(self) -> tuple[jaxbe.Box, jaxbe.Ellipsoid]:
        C, U, e, K, V, a = (jnp.asarray(x) for x in self)
        return jaxbe.Box(C, U, e), jaxbe.Ellipsoid(K, V, a)


def rotations(rng, n) -> np.ndarray:
    """Uniform rotations, orthonormal to rounding."""
    q = rng.normal(size=(n, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack(
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
            ),
            np.stack(
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
            ),
            np.stack(
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
            ),
        ]
    ).transpose(2, 0, 1)


def log_uniform(rng, n, low, high) -> np.ndarray:
    return np.exp(rng.uniform(np.log(low), np.log(high), size=(n, 3)))


def random(n, seed=0, low=0.05, high=2.0) -> Scene:
    """Lengths log-uniform in [low, high], centres such that many pairs overlap."""
    rng = np.random.default_rng(seed)
    half_extents, semi_axes = (
        log_uniform(rng, n, low, high),
        log_uniform(rng, n, low, high),
    )
    reach = np.linalg.norm(half_extents, axis=1) + semi_axes.max(axis=1)
    spread = 0.35 * reach[:, None] * rng.normal(size=(n, 3))
    center = rng.normal(size=(n, 3))
    return Scene(
        center, rotations(rng, n), half_extents,
        center + spread, rotations(rng, n), semi_axes,
    )  # fmt: skip


def near_touching(scene: Scene, seed=1, growth=1e-9) -> Scene:
    """The ellipsoids moved along K - C to a growth distance within 1 +- growth."""
    alpha = reference.growth_distance(scene)
    wanted = 1 + growth * np.random.default_rng(seed).uniform(-1, 1, size=scene.n)
    offset = (scene.K - scene.C) * (wanted / alpha)[:, None]
    # The box at the origin: an offset of other centres would be rounded again.
    return scene._replace(C=np.zeros_like(scene.C), K=offset)


def flattened(scene: Scene, zero_extents: int, seed=2) -> Scene:
    """1, 2 or 3 random half extents set to zero: plates, rods, points."""
    rng = np.random.default_rng(seed)
    order = np.argsort(rng.random((scene.n, 3)), axis=1)
    return scene._replace(e=np.where(order < zero_extents, 0.0, scene.e))


def spheres(scene: Scene) -> Scene:
    return scene._replace(a=np.repeat(scene.a[:, :1], 3, axis=1))


def axis_aligned(scene: Scene, seed=3) -> Scene:
    """All axes permuted and mirrored unit vectors: as many ties as can be."""
    rng = np.random.default_rng(seed)

    def signed_permutations():
        order = np.argsort(rng.random((scene.n, 3)), axis=1)
        signs = rng.choice([-1.0, 1.0], size=(scene.n, 1, 3))
        return np.eye(3)[order] * signs

    return scene._replace(U=signed_permutations(), V=signed_permutations())


def coincident(scene: Scene) -> Scene:
    return scene._replace(K=scene.C.copy())


def permuted(scene: Scene, seed=4) -> Scene:
    """The same bodies with axes relabelled and mirrored."""
    rng = np.random.default_rng(seed)
    p = np.argsort(rng.random((scene.n, 3)), axis=1)
    r = np.argsort(rng.random((scene.n, 3)), axis=1)

    def columns(m, order):
        signs = rng.choice([-1.0, 1.0], size=(scene.n, 1, 3))
        return np.take_along_axis(m, order[:, None, :], axis=2) * signs

    return scene._replace(
        U=columns(scene.U, p), e=np.take_along_axis(scene.e, p, axis=1),
        V=columns(scene.V, r), a=np.take_along_axis(scene.a, r, axis=1),
    )  # fmt: skip


def scaled(scene: Scene, factor) -> Scene:
    return scene._replace(
        C=scene.C * factor, e=scene.e * factor, K=scene.K * factor, a=scene.a * factor
    )


def shifted(scene: Scene, offset) -> Scene:
    """Both bodies moved, in the dtype of the scene: coordinates are rounded."""
    return scene._replace(C=scene.C + offset, K=scene.K + offset)
