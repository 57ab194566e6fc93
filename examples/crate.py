"""python examples/2_packing.py  # this file is imported, not run.

Random instances of fruit in a crate among parcels, and their picture.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from placing import Pose, ellipsoid_at

import jaxbe

CRATE = np.float32([0.5, 0.4, 0.3])
"""Half extents, metres; its centre is the origin."""


class Instance(NamedTuple):
    """A crate's obstacles, boxes (M,), its fruit: semi-axes (N, 3), and itself."""

    box: jaxbe.Box
    semi_axes: np.ndarray
    crate: np.ndarray = CRATE


def instance(
    rng: np.random.Generator, fruit: int, density: float, obstacles: int = 4
) -> Instance:
    """Parcels anywhere in the crate; fruit that fill so much of what they leave."""
    box = jaxbe.Box.from_quaternion(
        np.float32(rng.uniform(-0.5, 0.5, (obstacles, 3)) * CRATE),
        np.float32(rng.normal(size=(obstacles, 4))),
        np.float32(rng.uniform(0.04, 0.12, (obstacles, 3))),
    )
    semi_axes = rng.uniform(0.6, 1.4, (fruit, 3))
    volume = 4 / 3 * np.pi * semi_axes.prod(axis=1).sum()
    scale = (density * free_volume(rng, box) / volume) ** (1 / 3)
    return Instance(box, np.float32(scale * semi_axes))


def free_volume(
    rng: np.random.Generator, box: jaxbe.Box, points: int = 20_000
) -> float:
    """Of the crate without the boxes, by Monte Carlo, cubic metres."""
    C, U, e = (np.asarray(x) for x in box.fields().values())
    x = rng.uniform(-1, 1, (points, 1, 3)) * CRATE
    inside = np.all(abs(np.einsum("mri,pmr->pmi", U, x - C)) < e, axis=-1)
    return float(8 * CRATE.prod() * (1 - inside.any(axis=1).mean()))


def random_poses(rng: np.random.Generator, batch: tuple[int, ...]) -> Pose:
    """Anywhere in the crate, any way up."""
    position = rng.uniform(-0.9, 0.9, (*batch, 3)) * CRATE
    return Pose(np.float32(position), np.float32(rng.normal(size=(*batch, 4))))


def draw(
    file: Path, task: Instance, start: Pose, packed: Pose, loss: Any, proved: Any
) -> None:
    """The best start, what became of it, and the losses (starts, T) of all."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    from jaxbe.viz import draw_bodies

    best = int(np.argmin(np.where(proved, loss[:, -1], np.inf)))
    figure = Figure(figsize=(13, 4.2), dpi=90, layout="constrained")
    hues = colormaps["Set3"](np.arange(len(task.semi_axes)) % 12)
    for i, (title, pose) in enumerate(
        {"a random start": start, "packed, and proved": packed}.items()
    ):
        scene = figure.add_subplot(1, 3, i + 1, projection="3d")
        one = ellipsoid_at(jax.tree.map(lambda x: x[best], pose), task.semi_axes)
        style = {"box_color": (0.45, 0.35, 0.25, 1.0), "ellipsoid_color": hues}
        draw_bodies(task.box, one, scene, rings=12, **style)
        x, y, z = CRATE
        corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)]).T
        for height in (-z, z):
            scene.plot(*corners, height, color="0.2", lw=1)
        for corner in corners.T[:4]:
            scene.plot(*corner[:, None].repeat(2, 1), (-z, z), color="0.2", lw=1)
        scene.set(xlim=(-x, x), ylim=(-y, y), zlim=(-z, z), title=title)
        scene.set_box_aspect(CRATE, zoom=1.05)
        scene.set_axis_off()
    curves = figure.add_subplot(1, 3, 3)
    for ok, color, name in (
        (False, "0.7", "not proved"),
        (True, "tab:green", "proved"),
    ):
        chosen = loss[proved == ok][:100].T
        curves.semilogy(np.maximum(chosen, 1e-7), color=color, lw=0.5)
        share = np.mean(proved == ok)
        curves.plot([], color=color, label=f"{name}: {share:.0%} of the starts")
    curves.set(xlabel="iteration", ylabel="loss (1e-7: none)")
    curves.legend()
    figure.savefig(file)
