"""Random box-ellipsoid pairs as numpy arrays, for benchmarks and tests.

Every kind of scene is a function of a seed, or of another scene: `random` draws,
the others bend what was drawn (near touching, flat, aligned, far away, ...).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import jaxbe
from benchmarks import reference

LENGTHS = (0.05, 2.0)
"""Half extents and semi-axes are log-uniform in this range: aspect ratios to 40."""

REACH = 1.15
"""Ellipsoids' centres are uniform in the slab box B' (section 5 of the paper: the
bounding box of the Minkowski sum) grown by this factor: 43.7 % of pairs overlap."""


class Scene(NamedTuple):
    """n boxes and n ellipsoids, in the letters of the paper.

    Attributes:
        C: (n, 3) centres of the boxes.
        U: (n, 3, 3) their axes, in columns.
        e: (n, 3) their half extents.
        K: (n, 3) centres of the ellipsoids.
        V: (n, 3, 3) their axes, in columns.
        a: (n, 3) their semi-axes.
    """

    C: np.ndarray
    U: np.ndarray
    e: np.ndarray
    K: np.ndarray
    V: np.ndarray
    a: np.ndarray

    @property
    def size(self) -> int:
        """The number of pairs."""
        return self.C.shape[0]

    @property
    def aspect(self) -> np.ndarray:
        """The largest over the smallest semi-axis of each ellipsoid."""
        return self.a.max(axis=1) / self.a.min(axis=1)

    @property
    def spread(self) -> np.ndarray:
        """The longest of each pair's six lengths over its smallest semi-axis."""
        longest = np.maximum(self.a.max(axis=1), self.e.max(axis=1))
        return longest / self.a.min(axis=1)

    def astype(self, dtype: npt.DTypeLike) -> Scene:
        """The same pairs, rounded."""
        return Scene(*(x.astype(dtype) for x in self))

    def part(self, which: Any) -> Scene:
        """Some of the pairs: `which` is a slice, a mask or indices."""
        return Scene(*(x[which] for x in self))

    def bodies(self) -> tuple[jaxbe.Box, jaxbe.Ellipsoid]:
        """The pairs on JAX's default device, values unchecked."""
        return jaxbe.Box.unchecked(*self[:3]), jaxbe.Ellipsoid.unchecked(*self[3:])


def random(
    n: int, seed: int = 0, *, low: float = LENGTHS[0], high: float = LENGTHS[1]
) -> Scene:
    """Rotations uniform, lengths log-uniform, centres within reach of each other.

    Args:
        n: how many pairs.
        seed: the same seed gives the same scene.
        low: the smallest half extent and semi-axis.
        high: the largest; high / low bounds the aspect ratios.
    """
    rng = np.random.default_rng(seed)
    U, V = (rotations(rng.normal(size=(n, 4))) for _ in range(2))
    e, a = (np.exp(rng.uniform(np.log(low), np.log(high), (n, 3))) for _ in range(2))
    C = rng.normal(size=(n, 3))
    k = REACH * rng.uniform(-1, 1, size=(n, 3)) * (e + half_widths(U, V, a))
    return Scene(C, U, e, C + np.einsum("nij,nj->ni", U, k), V, a)


def half_widths(U: np.ndarray, V: np.ndarray, a: np.ndarray) -> np.ndarray:
    """The ellipsoid's half widths along the box's axes: l of section 5."""
    R = np.swapaxes(U, 1, 2) @ V
    return np.linalg.norm(R * a[:, None, :], axis=2)


def rotations(wxyz: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions (n, 4); uniform if these are normal draws."""
    w, x, y, z = (wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def proper(axes: np.ndarray) -> np.ndarray:
    """Axes of the same body that make a rotation."""
    return axes * np.array([1, 1, np.sign(np.linalg.det(axes))])


def near_touching(scene: Scene, seed: int = 1, growth: float = 1e-9) -> Scene:
    """The ellipsoids moved along K - C to a growth distance within 1 +- growth."""
    alpha = reference.growth_distance(scene)
    wanted = 1 + growth * np.random.default_rng(seed).uniform(-1, 1, size=scene.size)
    offset = (scene.K - scene.C) * (wanted / alpha)[:, None]
    # The box at the origin: an offset of other centres would be rounded again.
    return scene._replace(C=np.zeros_like(scene.C), K=offset)


def flattened(scene: Scene, zero_extents: int, seed: int = 2) -> Scene:
    """1, 2 or 3 random half extents set to zero: plates, rods, points."""
    rng = np.random.default_rng(seed)
    order = np.argsort(rng.random((scene.size, 3)), axis=1)
    return scene._replace(e=np.where(order < zero_extents, 0.0, scene.e))


def spheres(scene: Scene) -> Scene:
    """The first semi-axis in all directions."""
    return scene._replace(a=np.repeat(scene.a[:, :1], 3, axis=1))


def axis_aligned(scene: Scene, seed: int = 3) -> Scene:
    """All axes permuted and mirrored unit vectors: as many ties as can be."""
    rng = np.random.default_rng(seed)

    def signed_permutations() -> np.ndarray:
        order = np.argsort(rng.random((scene.size, 3)), axis=1)
        signs = rng.choice([-1.0, 1.0], size=(scene.size, 1, 3))
        return np.eye(3)[order] * signs

    return scene._replace(U=signed_permutations(), V=signed_permutations())


def spheroids(scene: Scene) -> Scene:
    """The last two semi-axes equal."""
    return scene._replace(a=scene.a[:, [0, 1, 1]])


def cubes(scene: Scene) -> Scene:
    """The first half extent in all directions."""
    return scene._replace(e=np.repeat(scene.e[:, :1], 3, axis=1))


def equal_lengths(scene: Scene) -> Scene:
    """The box's half extents are the ellipsoid's semi-axes."""
    return scene._replace(e=scene.a.copy())


def same_axes(scene: Scene) -> Scene:
    """The ellipsoid's axes are the box's: rounding alone remains of six products."""
    return scene._replace(V=scene.U.copy())


def yawed(scene: Scene, seed: int = 5) -> Scene:
    """The ellipsoid's axes are the box's, turned about the last one."""
    half = np.random.default_rng(seed).uniform(-np.pi, np.pi, scene.size) / 2
    zero = np.zeros_like(half)
    turn = rotations(np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1))
    return scene._replace(V=scene.U @ turn)


def lattice(scene: Scene, seed: int = 6) -> Scene:
    """Whole numbers for all lengths and centres, axes along the world's."""
    rng = np.random.default_rng(seed)
    e, a = (rng.integers(1, 4, (scene.size, 3)).astype(float) for _ in range(2))
    K = rng.integers(-6, 7, (scene.size, 3)).astype(float)
    return axis_aligned(scene._replace(C=np.zeros_like(K), K=K, e=e, a=a))


def lattice_of_balls(scene: Scene) -> Scene:
    """A lattice of spheres, whose own axes are not along it."""
    return spheres(lattice(scene))._replace(V=scene.V)


def on_planes(scene: Scene, seed: int = 7) -> Scene:
    """The ellipsoid's centre in planes of the box's faces: one, two, three or none."""
    k = np.einsum("nri,nr->ni", scene.U, scene.K - scene.C)
    is_on = np.random.default_rng(seed).random(k.shape) < 0.5
    k = np.where(is_on, np.sign(k) * scene.e, k)
    return scene._replace(K=scene.C + np.einsum("nij,nj->ni", scene.U, k))


def coincident(scene: Scene) -> Scene:
    """The ellipsoid centred in the box."""
    return scene._replace(K=scene.C.copy())


def permuted(scene: Scene, seed: int = 4) -> Scene:
    """The same bodies with axes relabelled and mirrored."""
    rng = np.random.default_rng(seed)
    p = np.argsort(rng.random((scene.size, 3)), axis=1)
    r = np.argsort(rng.random((scene.size, 3)), axis=1)

    def columns(m: np.ndarray, order: np.ndarray) -> np.ndarray:
        signs = rng.choice([-1.0, 1.0], size=(scene.size, 1, 3))
        return np.take_along_axis(m, order[:, None, :], axis=2) * signs

    return scene._replace(
        U=columns(scene.U, p), e=np.take_along_axis(scene.e, p, axis=1),
        V=columns(scene.V, r), a=np.take_along_axis(scene.a, r, axis=1),
    )  # fmt: skip


def scaled(scene: Scene, factor: Any) -> Scene:
    """All lengths and coordinates times a factor."""
    return scene._replace(
        C=scene.C * factor, e=scene.e * factor, K=scene.K * factor, a=scene.a * factor
    )


def shifted(scene: Scene, offset: Any) -> Scene:
    """Both bodies moved, in the dtype of the scene: coordinates are rounded."""
    return scene._replace(C=scene.C + offset, K=scene.K + offset)


ROUND_OR_ALIGNED: dict[str, Callable[[Scene], Scene]] = {
    "spheres": spheres,
    "spheroids": spheroids,
    "axis-aligned": axis_aligned,
    "axis-aligned-spheres": lambda s: spheres(axis_aligned(s)),
    "same-axes": same_axes,
    "same-axes-rods": lambda s: flattened(same_axes(s), 2),
    "same-axes-spheroids": lambda s: spheroids(same_axes(s)),
    "yawed": yawed,
    "yawed-plates": lambda s: flattened(yawed(s), 1),
    "lattice": lattice,
    "lattice-of-balls": lattice_of_balls,
    "on-planes": on_planes,
    "on-planes-spheres": lambda s: on_planes(spheres(s)),
    "on-planes-same-axes": lambda s: on_planes(same_axes(s)),
    "cubes-and-spheres": lambda s: cubes(spheres(s)),
    "plates-and-spheres": lambda s: flattened(spheres(s), 1),
    "equal-lengths": equal_lengths,
    "equal-lengths-same-axes": lambda s: equal_lengths(same_axes(s)),
}
"""What people build, of a random scene: rounding alone decides what is zero there."""
