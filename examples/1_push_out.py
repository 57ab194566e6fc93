"""python examples/1_push_out.py --output 1_push_out.gif  (--quick: shorter).

A melon lies in the middle of a shelf's boards and parcels, and in some of them. The
gradient of its margins to all boxes, which has a direction at every depth, moves and
turns it until it has room on all sides; then `jaxbe.certify` proves that it touches
nothing. An intersection's volume or sqrt(q) - 1 would be flat where it starts.
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

SHELF = boxes(
    (0.0, 0.0, 0.0, 0.20, 0.50, 0.012),
    (0.0, 0.0, 0.4, 0.20, 0.50, 0.012),
    (0.0, 0.0, 0.8, 0.20, 0.50, 0.012),
    (0.0, -0.51, 0.4, 0.20, 0.012, 0.42),
    (0.0, 0.51, 0.4, 0.20, 0.012, 0.42),
    (0.21, 0.0, 0.4, 0.012, 0.52, 0.42),
    (0.0, -0.31, 0.54, 0.14, 0.16, 0.12, 6),
    (0.0, 0.35, 0.56, 0.14, 0.11, 0.14, -8),
    (-0.01, -0.30, 0.14, 0.13, 0.15, 0.12, 5),
    (0.02, 0.36, 0.10, 0.10, 0.12, 0.08, 20),
)
"""Three boards, two sides, a back and four parcels: centre, half extents, turn."""

SEMI_AXES = (0.22, 0.11, 0.10)
START = Pose(np.float32([0.0, 0.08, 0.42]), np.float32([0.8, 0.1, 0.1, 0.55]))
WANTED = 0.1
"""The margin that every pair shall have."""


def margins(pose: Pose) -> jax.Array:
    """Of the melon and each of the boxes (N,)."""
    return jaxbe.margin(SHELF, against(ellipsoid_at(pose, jnp.float32(SEMI_AXES))))


def loss(pose: Pose) -> tuple[jax.Array, jax.Array]:
    """What is missing of the room wanted; and the margins."""
    found = margins(pose)
    return jnp.square(jax.nn.relu(WANTED - found)).sum(), found


def push(iterations: int, rate: float) -> tuple[list[Pose], np.ndarray]:
    """All poses on the way, and their margins (iterations, N)."""
    optimiser = optax.adam(rate)

    @jax.jit
    def step(pose: Pose, memory: Any) -> tuple[Pose, Any, jax.Array]:
        (_, found), slope = jax.value_and_grad(loss, has_aux=True)(pose)
        change, memory = optimiser.update(slope, memory)
        return optax.apply_updates(pose, change), memory, found

    pose, memory = START, optimiser.init(START)
    way, seen = [], []
    for _ in track(range(iterations), description="push"):
        way.append(pose)
        pose, memory, found = step(pose, memory)
        seen.append(found)
    return way, np.array(seen)


def draw(file: Path, way: list[Pose], seen: np.ndarray, frames: int) -> None:
    """A film: the melon in the shelf, and its margins."""
    from matplotlib.figure import Figure

    from jaxbe.viz import draw_bodies

    figure = Figure(figsize=(9, 4.5), dpi=72, layout="constrained")
    curves = figure.add_subplot(1, 2, 2)
    curves.plot(seen, color="0.6", lw=1)
    curves.plot(seen.min(axis=1), color="tab:red", lw=2, label="smallest margin")
    curves.axhline(0, color="black", lw=0.8)
    curves.axhline(WANTED, color="tab:green", ls=":", label="wanted")
    now = curves.axvline(0, color="0.3", lw=0.8)
    curves.set(xlabel="iteration", ylabel="margin to each box", ylim=(-1, 1))
    curves.legend(loc="lower right")
    scene = figure.add_subplot(1, 2, 1, projection="3d")

    def frame(i: int) -> None:
        scene.clear()
        melon = ellipsoid_at(way[i], jnp.float32(SEMI_AXES))
        color = "tab:green" if seen[i].min() > 0 else "tab:red"
        style = {"box_color": (0.75, 0.6, 0.4, 0.25), "ellipsoid_color": color}
        draw_bodies(SHELF, melon, scene, **style)
        scene.set(xlim=(-0.35, 0.23), ylim=(-0.53, 0.53), zlim=(-0.02, 0.82))
        scene.set_box_aspect((0.58, 1.06, 0.84), zoom=1.2)
        scene.view_init(18, 205)
        scene.set_axis_off()
        now.set_xdata([i, i])

    times = np.linspace(0, len(way) - 1, frames).astype(int)
    film(file, figure, frame, [*times, *times[-1:].repeat(5)], fps=10)


def main(arguments: Sequence[str] | None = None) -> bool:
    """Pushes, proves and draws; returns whether the melon is proved to be free."""
    options = parser(__doc__, "1_push_out.gif").parse_args(arguments)
    iterations, frames = (60, 3) if options.quick else (70, 35)
    way, seen = push(iterations, rate=0.005)
    free = bool(all_separated(SHELF, ellipsoid_at(way[-1], jnp.float32(SEMI_AXES))))
    moved = 1000 * np.linalg.norm(way[-1].position - START.position)
    draw(options.output, way, seen, frames)
    text = """\
smallest margin {margins[0]:.3f} -> {margins[1]:.3f} by moving {moved_mm:.0f} mm
proved apart from all boxes: {proved_apart}"""
    margins = seen.min(axis=1)[[0, -1]].tolist()
    say(options, text, margins=margins, moved_mm=float(moved), proved_apart=free)
    return free


if __name__ == "__main__":
    main()
