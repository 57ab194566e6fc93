"""What is missing of the distances wanted, by MuJoCo C, in float64.

Ellipsoids are bodies without joints (mocap) whose poses are set; explicit pairs say who
meets whom, so that one call of `mj_collision` measures many variants of a scene, a loop
in C: all members of a population, or a scene and the same with one number moved, where
only the ellipsoid that moves is measured again.
"""

from __future__ import annotations

import functools
import timeit
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from benchmarks.placement_tasks import Instance, Pose, Problem
from benchmarks.scenes import proper

VARIABLES = 6
"""Of one ellipsoid: its displacement and turn, all in metres."""

STEP = 1e-6
"""Of finite differences, metres."""

TOLERANCE, ITERATIONS = 1e-6, 100
"""Of MuJoCo's convex collisions, metres; with its default of 35, depths jump."""

EXACT = 1e-9, 400
"""The same for the distances reported."""

NEAR, FAR = 1e-3, 10.0
"""Metres: what is found within the first is not measured within the second."""

Body = tuple[int, Sequence[int]]
"""The number of an ellipsoid in its task, and the earlier bodies that it meets."""


class Scene:
    """Distances of bodies to the boxes, the walls and each other."""

    def __init__(
        self,
        task: Instance,
        bodies: Sequence[Body],
        reach: float,
        accuracy: tuple[float, int] = (TOLERANCE, ITERATIONS),
    ) -> None:
        """`reach`: in metres; larger distances are not measured."""
        spec = mujoco.MjSpec()
        spec.memory = 2**22 + 2**12 * len(bodies) * (10 + len(task.box.center))
        spec.option.ccd_tolerance, spec.option.ccd_iterations = accuracy
        fixed = [*_add_boxes(spec, task), *_add_walls(spec, task)]
        self._fixed = len(fixed)
        for number, (fruit, others) in enumerate(bodies):
            name = f"e{number}"
            spec.worldbody.add_body(mocap=True).add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                size=task.semi_axes[fruit],
            )
            for other in (*fixed, *(f"e{i}" for i in others)):
                spec.add_pair(geomname1=other, geomname2=name, margin=reach)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def measure(
        self, position: np.ndarray, quaternion: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of all pairs within reach: both bodies, and the distance (C,).

        The first is negative for boxes and walls; the second is the later one.
        """
        self.data.mocap_pos[:], self.data.mocap_quat[:] = position, quaternion
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        contact = self.data.contact
        geoms = contact.geom - self._fixed
        return geoms.min(axis=1), geoms.max(axis=1), contact.dist


def _add_boxes(spec: Any, task: Instance) -> list[str]:
    C, U, e = (np.asarray(x, np.float64) for x in task.box.fields().values())
    for i in range(len(C)):
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, proper(U[i]).ravel())
        _add_fixed(spec, f"b{i}", "BOX", C[i], quaternion, e[i])
    return [f"b{i}" for i in range(len(C))]


def _add_walls(spec: Any, task: Instance) -> list[str]:
    """Planes whose normals, along their z, point into the container."""
    for i in range(3):
        for side in (-1, 1):
            position, quaternion = np.zeros(3), np.zeros(4)
            position[i] = side * float(task.crate[i])
            mujoco.mju_quatZ2Vec(quaternion, -np.sign(position))
            _add_fixed(spec, f"w{i}{side}", "PLANE", position, quaternion, [1, 1, 1])
    return [f"w{i}{side}" for i in range(3) for side in (-1, 1)]


def _add_fixed(
    spec: Any, name: str, kind: str, position: Any, quaternion: Any, size: Any
) -> None:
    spec.worldbody.add_geom(
        name=name,
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"),
        pos=position,
        quat=quaternion,
        size=size,
    )


class Moves:
    """Poses as a start and variables x (..., N, 6), zero at the start.

    The first three are the displacement, the others a turn about the centre: its
    rotation vector times the mean radius, so that all are metres.
    """

    def __init__(self, problem: Problem, start: int) -> None:
        self._position = np.float64(problem.starts.position[start])
        q = np.float64(problem.starts.quaternion[start])
        self._quaternion = q / np.linalg.norm(q, axis=-1, keepdims=True)
        self._radius = radius(problem.task)

    def pose(self, x: np.ndarray) -> Pose:
        """The poses (..., N) of these variables."""
        half = x[..., 3:] / (2 * self._radius)
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        turn = np.sinc(angle / np.pi) * half
        return Pose(
            self._position + x[..., :3],
            _product(np.concatenate([np.cos(angle), turn], -1), self._quaternion),
        )


def radius(task: Instance) -> float:
    """Of spheres as large as the ellipsoids, on average."""
    return float((np.prod(task.semi_axes, axis=1) ** (1 / 3)).mean())


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Of quaternions (..., 4)."""
    w, v, u, r = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    real = w * u - np.sum(v * r, axis=-1, keepdims=True)
    return np.concatenate([real, w * r + u * v + np.cross(v, r)], axis=-1)


class Loss:
    """The losses of a population, one after another in one call of MuJoCo."""

    def __init__(self, problem: Problem, population: int = 1) -> None:
        self._clearance, self._shape = problem.clearance, (population, -1)
        n = len(problem.task.semi_axes)
        bodies = [
            (i, range(n * p, n * p + i)) for p in range(population) for i in range(n)
        ]
        self._scene = Scene(problem.task, bodies, self._clearance)

    def __call__(self, pose: Pose) -> np.ndarray:
        """Of poses (P, N): the losses (P,)."""
        position, quaternion = pose
        _, last, distance = self._scene.measure(
            position.reshape(-1, 3), quaternion.reshape(-1, 4)
        )
        each = np.square(1 - distance / self._clearance)
        of_body = np.bincount(last, each, self._scene.model.nmocap)
        return of_body.reshape(self._shape).sum(axis=1)


class Differences:
    """The loss and its gradient by forward differences, in one call of MuJoCo."""

    def __init__(self, problem: Problem) -> None:
        self._clearance, self._n = problem.clearance, len(problem.task.semi_axes)
        fruit = range(self._n)
        bodies: list[Body] = [(i, range(i)) for i in fruit]
        for i in fruit:
            bodies += [(i, [j for j in fruit if j != i])] * VARIABLES
        self._scene = Scene(problem.task, bodies, self._clearance)

    def __call__(self, moves: Moves, x: np.ndarray) -> tuple[float, np.ndarray]:
        """At x (N, 6): the loss, and its derivatives (N, 6)."""
        now = moves.pose(x)
        moved = moves.pose(x + STEP * np.eye(VARIABLES)[:, None])
        every = [
            np.concatenate([a, np.swapaxes(b, 0, 1).reshape(-1, a.shape[1])])
            for a, b in zip(now, moved, strict=True)
        ]
        first, last, distance = self._scene.measure(*every)
        each = np.square(1 - distance / self._clearance)
        count = functools.partial(np.bincount, minlength=self._n)
        still = last < self._n
        met = still & (first >= 0)
        own = count(last[still], each[still]) + count(first[met], each[met])
        copies = np.bincount(last[~still] - self._n, each[~still], self._n * VARIABLES)
        slope = (copies.reshape(self._n, VARIABLES) - own[:, None]) / STEP
        return float(each[still].sum()), slope


def least_distance(problem: Problem, pose: Pose) -> float:
    """The smallest signed distance of all pairs, metres."""
    bodies = [(i, range(i)) for i in range(len(problem.task.semi_axes))]
    # MuJoCo finds depths of bodies grown by half the reach: a long one blurs them.
    for reach in (NEAR, FAR):
        scene = Scene(problem.task, bodies, reach, EXACT)
        distance = scene.measure(*(np.float64(x) for x in pose))[2]
        if len(distance):
            break
    return float(distance.min())


def seconds(problem: Problem, repeats: int = 5) -> dict[str, float]:
    """Of all distances of the first start: by one call, and by one call a pair."""
    bodies: list[Body] = [(i, range(i)) for i in range(len(problem.task.semi_axes))]
    scene = Scene(problem.task, bodies, problem.clearance)
    pose = [np.float64(x[0]) for x in problem.starts]
    scene.measure(*pose)
    model, data = scene.model, scene.data
    pairs = list(zip(model.pair_geom1, model.pair_geom2, strict=True))

    def by_pairs() -> None:
        mujoco.mj_kinematics(model, data)
        for one, other in pairs:
            mujoco.mj_geomDistance(model, data, one, other, problem.clearance, None)

    together = functools.partial(scene.measure, *pose)
    calls = {"mj_collision": together, "mj_geomDistance": by_pairs}
    return {
        name: min(timeit.repeat(call, number=1, repeat=repeats))
        for name, call in calls.items()
    }
