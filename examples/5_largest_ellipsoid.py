"""python examples/5_largest_ellipsoid.py --output 5_largest_ellipsoid.png  (--quick).

The largest ellipsoid that fits among boxes: semi-axes and pose are the variables of an
augmented Lagrangian on the margins, from many starts in one vmap; at the end it is
scaled until `jaxbe.certify` proves it apart from all boxes. Between flat walls the
problem is convex, too, and SciPy's solver of that one knows the answer; among parcels
on a shelf there is no such solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from command_line import parser, say
from placing import Pose, against, all_separated, ellipsoid_at
from rich.progress import track
from rooms import SHELF, convex_volume, draw_polytope, room

import jaxbe

WEIGHT = 30.0
"""Of a missing margin's square, beside the logarithm of the volume."""


class Shape(NamedTuple):
    """An ellipsoid as variables: its pose, and the logarithms of its semi-axes."""

    pose: Pose
    log_axes: jax.Array


def ellipsoid(shape: Shape) -> jaxbe.Ellipsoid:
    """The ellipsoid."""
    return ellipsoid_at(shape.pose, jnp.exp(shape.log_axes))


def lagrangian(
    shape: Shape, multipliers: jax.Array, box: jaxbe.Box
) -> tuple[jax.Array, jax.Array]:
    """Minus the volume's logarithm, margins below zero; the next multipliers."""
    margins = jaxbe.margin(box, against(ellipsoid(shape)))
    following = jax.nn.relu(multipliers - WEIGHT * margins)
    return jnp.square(following).sum() / (2 * WEIGHT) - shape.log_axes.sum(), following


def grower(rounds: int, steps: int) -> Any:
    """One round after another: Adam on a Lagrangian, then its multipliers."""
    rate = optax.exponential_decay(0.02, rounds * steps, 1e-3)
    optimiser = optax.adam(rate)

    def grow(shape: Shape, memory: Any, multipliers: jax.Array, box: jaxbe.Box) -> Any:
        def step(carry: Any, _: None) -> Any:
            shape, memory = carry
            slope, _ = jax.grad(lagrangian, has_aux=True)(shape, multipliers, box)
            change, memory = optimiser.update(slope, memory)
            return (optax.apply_updates(shape, change), memory), None

        (shape, memory), _ = jax.lax.scan(step, (shape, memory), length=steps)
        return shape, memory, lagrangian(shape, multipliers, box)[1]

    return optimiser, jax.jit(jax.vmap(grow, in_axes=(0, 0, 0, None)))


def largest(
    box: jaxbe.Box, start: Shape, program: Any, rounds: int
) -> tuple[jaxbe.Ellipsoid, np.ndarray]:
    """The best of all starts (S,), proved; and the volumes of all, 0 if not proved."""
    optimiser, grow = program
    shape, memory = start, jax.vmap(optimiser.init)(start)
    multipliers = jnp.zeros((len(start.log_axes), len(box.center)))
    for _ in track(range(rounds), description="grow"):
        shape, memory, multipliers = grow(shape, memory, multipliers, box)
    low, high = np.full(len(multipliers), 0.5), np.full(len(multipliers), 1.1)
    for _ in range(20):
        middle = (low + high) / 2
        free = np.asarray(all_separated(box, scaled(shape, middle)))
        low, high = np.where(free, middle, low), np.where(free, high, middle)
    found = scaled(shape, low)
    proved = np.asarray(all_separated(box, found))
    volumes = 4 / 3 * np.pi * np.asarray(found.semi_axes, float).prod(axis=-1) * proved
    best = int(np.argmax(volumes))
    return jax.tree.map(lambda x: x[best], found), volumes


def scaled(shape: Shape, factor: np.ndarray) -> jaxbe.Ellipsoid:
    """The ellipsoids (S,) with other sizes."""
    size = jnp.log(jnp.float32(factor))[:, None]
    return ellipsoid(shape._replace(log_axes=shape.log_axes + size))


def starts(rng: np.random.Generator, count: int, low: Any, high: Any) -> Shape:
    """Small balls (count,) between two corners."""
    position = rng.uniform(low, high, (count, 3))
    pose = Pose(np.float32(position), np.float32(rng.normal(size=(count, 4))))
    return Shape(pose, np.full((count, 3), np.log(0.05), np.float32))


def draw(file: Path, rows: np.ndarray, both: list[jaxbe.Ellipsoid]) -> None:
    """The polytope and the shelf, each with its largest ellipsoid."""
    from matplotlib.figure import Figure

    from jaxbe.viz import draw_bodies

    figure = Figure(figsize=(11, 5), dpi=100, layout="constrained")
    left, right = (figure.add_subplot(1, 2, i, projection="3d") for i in (1, 2))
    draw_bodies(None, both[0], left, ellipsoid_color="tab:orange")
    draw_polytope(left, rows)
    parcels = jax.tree.map(lambda x: x[jnp.array([0, 4, 6, 7, 8])], SHELF)
    style = {"box_color": (0.75, 0.6, 0.4, 0.4), "ellipsoid_color": "tab:orange"}
    draw_bodies(parcels, both[1], right, **style)
    right.view_init(25, -70)
    right.set_box_aspect((1.2, 1.1, 0.8), zoom=1.1)
    left.set_title("between flat walls: as the convex solver says")
    right.set_title("among parcels on a shelf (four sides not drawn)")
    for axes in (left, right):
        axes.set_axis_off()
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> float:
    """Grows both and draws; returns the volume by that of the convex solver."""
    options = parser(__doc__, "5_largest_ellipsoid.png").parse_args(arguments)
    count, rounds = (4, 25) if options.quick else (64, 30)
    rng = np.random.default_rng(options.seed)
    walls, rows = room(rng)
    program = grower(rounds, 100)
    one, volumes = largest(walls, starts(rng, count, -0.1, 0.1), program, rounds)
    known = convex_volume(rows)
    share = float(volumes.max() / known)
    near = float(np.mean(volumes > 0.99 * known))
    inside = starts(rng, count, (-0.4, -0.4, 0.1), (0.4, 0.4, 0.5))
    other, volumes = largest(SHELF, inside, program, rounds)
    draw(options.output, rows, [one, other])
    text = """\
room: {share:.2%} of the volume by SciPy's convex solver proved, {near:.0%} of starts
within 1 %; shelf: {shelf:.6f} m3 proved; starts end at {ends} l"""
    ends = np.unique(np.round(1e3 * volumes, 1)).tolist()
    say(options, text, share=share, near=near, shelf=float(volumes.max()), ends=ends)
    return share


if __name__ == "__main__":
    main()
