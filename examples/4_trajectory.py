"""python examples/4_trajectory.py --output 4_trajectory.gif  (--quick: shorter).

A flat flying robot, an ellipsoid, has to get through an upright slot, then through a
level one. All way points are moved at once: short and smooth, and by the gradient of
the margins off boxes that are thicker by a clearance on all sides. `jaxbe.certify`
proves each way point apart from these, so the clearance is guaranteed there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from command_line import parser, say
from placing import Pose, against, all_separated, boxes, ellipsoid_at, film
from rich.progress import track

import jaxbe

WALLS = boxes(
    (-0.6, -0.68, 0.0, 0.06, 0.5, 0.8),
    (-0.6, 0.68, 0.0, 0.06, 0.5, 0.8),
    (0.6, 0.0, 0.82, 0.06, 1.18, 0.65),
    (0.6, 0.0, -0.52, 0.06, 1.18, 0.32),
    (0.0, 0.55, -0.2, 0.15, 0.15, 0.6, 30),
)
"""An upright slot 36 cm wide, a level one of 37 cm, and a pillar between."""
SEMI_AXES = np.float32([0.36, 0.36, 0.09])
START, GOAL = np.float32([-1.5, 0.35, -0.2]), np.float32([1.5, 0.2, 0.0])
LEVEL = np.float32([1, 0, 0, 0])

CLEARANCE = 0.02
"""Guaranteed at all way points, metres."""

WANTED = 0.1
"""The margin to the thicker boxes at which the penalty ends."""


def thicker(box: jaxbe.Box, clearance: float) -> jaxbe.Box:
    """What is apart from these boxes is further than the clearance from the others.

    They contain the boxes grown by a ball; a micrometre more is for rounding.
    """
    half_extents = box.half_extents + (clearance + 1e-6)
    return jaxbe.Box(box.center, box.axes, half_extents)


def whole(path: Pose) -> Pose:
    """The free way points (T,) between start and goal."""
    first, last = Pose(START, LEVEL), Pose(GOAL, LEVEL)
    unit = path.quaternion / jnp.linalg.norm(path.quaternion, axis=-1, keepdims=True)
    free = Pose(path.position, unit)
    return jax.tree.map(lambda a, x, b: jnp.stack([a, *x, b]), first, free, last)


def loss(path: Pose, box: jaxbe.Box) -> tuple[jax.Array, jax.Array]:
    """Length, turning, jerks and missing margins; and the margins (T, N)."""
    position, quaternion = whole(path)
    margins = jaxbe.margin(box, against(ellipsoid_at(path, SEMI_AXES)))
    missing = jnp.square(jax.nn.relu(WANTED - margins)).sum()
    steps = [jnp.square(jnp.diff(x, n=1, axis=0)).sum() for x in (position, quaternion)]
    bends = [jnp.square(jnp.diff(x, n=2, axis=0)).sum() for x in (position, quaternion)]
    return 20 * missing + sum(steps) + 20 * sum(bends), margins


def straight(way_points: int, seed: int) -> Pose:
    """From start to goal as the crow flies, level but for a little noise."""
    t = np.linspace(0, 1, way_points, dtype=np.float32)[1:-1, None]
    noise = np.random.default_rng(seed).normal(scale=0.05, size=(4,))
    return Pose(START + t * (GOAL - START), np.float32(LEVEL + noise + 0 * t))


def plan(path: Pose, iterations: int) -> tuple[list[Pose], np.ndarray]:
    """All paths on the way to the best, and their smallest margins."""
    optimiser = optax.adam(optax.cosine_decay_schedule(0.02, iterations))

    @jax.jit
    def step(path: Pose, memory: Any, box: jaxbe.Box) -> tuple[Pose, Any, jax.Array]:
        (_, margins), slope = jax.value_and_grad(loss, has_aux=True)(path, box)
        change, memory = optimiser.update(slope, memory)
        return optax.apply_updates(path, change), memory, margins.min()

    memory, box = optimiser.init(path), thicker(WALLS, CLEARANCE)
    paths, smallest = [path], []
    for _ in track(range(iterations), description="plan"):
        path, memory, margin = step(path, memory, box)
        paths.append(path)
        smallest.append(margin)
    return paths, np.array(smallest)


def draw(file: Path, paths: list[Pose], smallest: np.ndarray, frames: int) -> None:
    """A film: how the path is found, then the flight along it."""
    from matplotlib.figure import Figure

    from jaxbe.viz import draw_bodies

    figure = Figure(figsize=(7, 4.2), dpi=72)
    scene = figure.add_axes((-0.2, -0.24, 1.4, 1.5), projection="3d")

    def frame(shown: tuple[str, Pose, Any]) -> None:
        title, path, which = shown
        scene.clear()
        robots = ellipsoid_at(
            jax.tree.map(lambda x: x[np.array(which)], whole(path)), SEMI_AXES
        )
        style = {"box_color": (0.5, 0.55, 0.6, 0.35), "ellipsoid_color": "tab:orange"}
        draw_bodies(WALLS, robots, scene, rings=10, **style)
        scene.plot(*whole(path).position.T, color="black", lw=1, zorder=20)
        scene.set(xlim=(-1.9, 1.9), ylim=(-1.2, 1.2), zlim=(-0.85, 1.3))
        scene.set_box_aspect((3.8, 2.4, 2.15), zoom=1.03)
        scene.view_init(28, -55)
        scene.set_axis_off()
        figure.suptitle(title, fontsize=12)

    count = len(paths[-1].position) + 2
    some = np.linspace(0, count - 1, 9).astype(int)
    early = np.unique(np.geomspace(1, len(smallest), frames).astype(int)) - 1
    title = "iteration {}, margin {:.2f}".format
    found = [(title(i, smallest[i]), paths[i], some) for i in early]
    text = f"{100 * CLEARANCE:.0f} cm guaranteed at every way point"
    way = np.linspace(0, count - 1, 2 * frames).astype(int)
    film(file, figure, frame, [*found, *((text, paths[-1], [i]) for i in way)], fps=8)


def main(arguments: Sequence[str] | None = None) -> bool:
    """Plans, proves and draws; returns whether all way points have the clearance."""
    options = parser(__doc__, "4_trajectory.gif").parse_args(arguments)
    points, iterations, frames = (24, 200, 2) if options.quick else (48, 600, 18)
    paths, smallest = plan(straight(points, options.seed), iterations)
    robots = ellipsoid_at(whole(paths[-1]), SEMI_AXES)
    safe = np.asarray(all_separated(thicker(WALLS, CLEARANCE), robots))
    nearest = jax.jit(jaxbe.signed_distance)(WALLS, against(robots)).min()
    draw(options.output, paths, smallest, frames)
    text = """\
smallest margin {margins[0]:.2f} -> {margins[1]:.2f}; {proved} of {points} way points
proved {clearance:g} m clear; the nearest comes to {nearest:.3f} m of a box"""
    found = {"proved": int(safe.sum()), "points": len(safe), "nearest": float(nearest)}
    margins = smallest[[0, -1]].tolist()
    say(options, text, margins=margins, clearance=CLEARANCE, **found)
    return bool(safe.all())


if __name__ == "__main__":
    main()
