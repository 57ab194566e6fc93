"""The tasks of `benchmarks.placement`, on the loss and the proofs of the examples.

All are those of examples/2_packing.py: ellipsoids in a container among boxes. The shelf
of examples/1_push_out.py is one with a single ellipsoid.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxbe

sys.path.append(str(Path(__file__).parents[1] / "examples"))

from crate import Instance, instance, random_poses
from fruit import MARGIN, proved  # noqa: F401 (the margin is for the methods)
from fruit import loss as loss_of  # noqa: F401
from placing import Pose, all_separated, ellipsoid_at

push_out = importlib.import_module("1_push_out")
packing = importlib.import_module("2_packing")

FIRST_PARCEL = 6
"""Of the shelf's boxes: those before are its boards."""

SHELF_CENTER = np.float32([-0.04, 0.0, 0.4])
SHELF_ROOM = np.float32([0.262, 0.522, 0.42])
"""Half extents: the shelf's outer sides, and 10 cm in front of it, which is open."""

SURELY = 0.5
"""Of the loss of one wanted margin that is missing whole: then none is negative."""


class Problem(NamedTuple):
    """One instance.

    Attributes:
        task: the boxes, ellipsoids (N,) and container.
        starts: poses (S, N); methods take them in this order.
        wanted: the margin aimed at.
        rate: of Adam at first, the best of those tried, for both gradients.
        sigma: of CMA-ES at first, metres, likewise.
        deep: whether the centre of an ellipsoid of the first start is in a box.
    """

    task: Instance
    starts: Pose
    wanted: float
    rate: float
    sigma: float
    deep: bool

    @property
    def clearance(self) -> float:
        """The distance aimed at where distances are measured, metres."""
        radius = np.prod(self.task.semi_axes, axis=1) ** (1 / 3)
        return float(2 * self.wanted * radius.mean())


def shelf(rng: np.random.Generator, starts: int) -> Problem:
    """The melon somewhere in the shelf; in every second one in a parcel."""
    center, axes, half_extents = (
        np.asarray(x) for x in push_out.SHELF.fields().values()
    )
    box = jaxbe.Box.unchecked(center - SHELF_CENTER, axes, half_extents)
    task = Instance(box, np.float32([push_out.SEMI_AXES]), SHELF_ROOM)
    position = rng.uniform(-1, 1, (starts, 1, 3)) * np.float32([0.2, 0.48, 0.38])
    position -= SHELF_CENTER * np.float32([1, 0, 0])
    if rng.random() < 0.5:
        parcel = rng.integers(FIRST_PARCEL, len(center))
        inside = axes[parcel] @ (rng.uniform(-0.9, 0.9, 3) * half_extents[parcel])
        position[0] = center[parcel] - SHELF_CENTER + inside
    pose = Pose(np.float32(position), np.float32(rng.normal(size=(starts, 1, 4))))
    return Problem(task, pose, push_out.WANTED, 0.1, 0.1, in_a_box(task, pose))


def crate(rng: np.random.Generator, starts: int, fruit: int, density: float) -> Problem:
    """Fruit anywhere in the crate."""
    task = instance(rng, fruit, density)
    pose = random_poses(rng, (starts, fruit))
    return Problem(task, pose, packing.WANTED, 0.03, 0.03, in_a_box(task, pose))


def in_a_box(task: Instance, pose: Pose) -> bool:
    """Whether a centre of the first start is."""
    C, U, e = (np.asarray(x) for x in task.box.fields().values())
    local = np.einsum("mri,nmr->nmi", U, pose.position[0][:, None] - C)
    return bool(np.any(np.all(abs(local) < e, axis=-1)))


class Finished(Exception):
    """The pose is proved, or the time is over."""


class Watch:
    """Keeps the time, tries to prove what a method finds, and keeps the best.

    Attributes:
        solved_after: seconds until the proof, proofs included; None without one.
        best: the pose of the least loss, or the one proved.
        start: the number of the start at work, set by the methods.
    """

    def __init__(self, problem: Problem, budget: float) -> None:
        self._problem, self._budget = problem, budget
        self.solved_after: float | None = None
        self.best: Pose | None = None
        self.start = 0
        self._least = self._refused = np.inf
        self._began = time.perf_counter()

    def elapsed(self) -> float:
        """Seconds since this was made."""
        return time.perf_counter() - self._began

    def show(self, loss: float, pose: Callable[[], Pose]) -> None:
        """Notes a state, its loss in units of one wanted margin missing whole.

        Raises:
            Finished: it is proved, or the time is over.
        """
        if loss < self._least:
            self._least, self.best = loss, pose()
        # A proof refused is tried again when the loss is half of what it was.
        if loss < SURELY and (loss == 0 or loss < self._refused / 2):
            self._refused = loss
            if is_proved(self._problem.task, pose()):
                self.best, self.solved_after = pose(), self.elapsed()
                raise Finished
        if self.elapsed() > self._budget:
            raise Finished


def warm_up(problem: Problem) -> float:
    """Compiles the test of success; seconds."""
    began = time.perf_counter()
    pose = jax.tree.map(lambda x: x[0], problem.starts)
    is_proved(problem.task, pose)
    # It stops at what fails first.
    np.all(all_separated(problem.task.box, place(pose, problem.task.semi_axes)))
    return time.perf_counter() - began


def is_proved(task: Instance, pose: Pose) -> bool:
    """The test of success: for the float32 numbers that the pose rounds to."""
    position, quaternion = (np.asarray(x, np.float32) for x in pose)
    fruit = jax.tree.map(np.asarray, place(Pose(position, quaternion), task.semi_axes))
    return proved(fruit, task)


place: Callable[..., Any] = jax.jit(ellipsoid_at)
