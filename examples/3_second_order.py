"""python examples/3_second_order.py --output 3_second_order.png  (--quick: shorter).

The margin has second derivatives. An ellipsoid shall come as near as it can to a target
in a corner of boxes and keep off them all: a log barrier on its margins, six variables.
From many starts in one vmap, with one line search for all: steepest descent and L-BFGS
(gradients only) against Newton's method (the margins' Hessian) and Gauss-Newton (the
barrier's curvature, from the margins' gradients); and Adam.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from command_line import parser, say
from descent import (
    ARRIVED,
    METHODS,
    STEPS,
    Descent,
    Objective,
    descend,
    log_barrier,
    summary,
    turned,
)
from placing import Pose, against, boxes, ellipsoid_at
from rich.console import Console
from rich.table import Table

import jaxbe

CORNER = boxes(
    (0.0, 0.0, -0.1, 1.0, 1.0, 0.1, 0),
    (0.6, 0.0, 0.3, 0.1, 0.9, 0.5, 12),
    (0.0, 0.65, 0.3, 0.9, 0.1, 0.5, -7),
    (0.25, -0.25, 0.1, 0.15, 0.12, 0.15, 30),
    (-0.45, 0.15, 0.1, 0.12, 0.15, 0.2, -20),
)
SEMI_AXES = np.float32([0.35, 0.12, 0.08])
TARGET = np.float32([0.5, 0.5, 0.0])
BARRIER = 0.01
"""The weight of the logarithms beside the squared way left (m^2)."""


def pose(x: jax.Array, start: Pose) -> Pose:
    """Moved by x[:3] metres and turned by x[3:] radians or so."""
    return Pose(start.position + x[:3], turned(start.quaternion, x[3:]))


def margin(x: jax.Array, start: Pose, box: jaxbe.Box) -> jax.Array:
    """To the box, or all boxes (N,)."""
    return jaxbe.margin(box, ellipsoid_at(pose(x, start), SEMI_AXES), steps=3)


def objective(x: jax.Array, start: Pose) -> jax.Array:
    """The squared way left, and the barrier."""
    left = jnp.square(pose(x, start).position - TARGET).sum()
    return left + BARRIER * log_barrier(margin(x, start, CORNER))


def gauss_newton(x: jax.Array, start: Pose) -> jax.Array:
    """The objective's Hessian (6, 6), but for the margins' own."""
    slopes = jax.vmap(jax.grad(margin), in_axes=(None, None, 0))(x, start, CORNER)
    slopes /= margin(x, start, CORNER)[:, None]
    return 2 * jnp.diag(jnp.float32([1, 1, 1, 0, 0, 0])) + BARRIER * slopes.T @ slopes


GOAL = Objective(objective, gauss_newton)


def starts(count: int, seed: int) -> Pose:
    """Poses (count,) that touch nothing."""
    rng = np.random.default_rng(seed)
    position = rng.uniform((-0.3, -0.7, 0.1), (0.4, 0.4, 0.6), (20 * count, 3))
    drawn = Pose(np.float32(position), np.float32(rng.normal(size=(20 * count, 4))))
    size = np.linalg.norm(drawn.quaternion, axis=-1, keepdims=True)
    drawn = Pose(drawn.position, drawn.quaternion / size)
    found = jax.jit(jaxbe.margin)(CORNER, against(ellipsoid_at(drawn, SEMI_AXES)))
    free = np.flatnonzero(found.min(axis=-1) > 0.02)[:count]
    return jax.tree.map(lambda x: x[free], drawn)


def report(rows: dict[str, dict[str, float | None]]) -> None:
    """Prints a table."""
    table = Table("", *rows["Newton"], title=f"until the gradient is below {ARRIVED:g}")
    for name, row in rows.items():
        table.add_row(name, *("-" if x is None else f"{x:.0f}" for x in row.values()))
    Console().print(table)


def draw(file: Path, start: Pose, found: dict[str, Descent]) -> None:
    """A start and its end, and the gradients by step and by time."""
    from matplotlib.figure import Figure

    from jaxbe.viz import draw_bodies

    figure = Figure(figsize=(13, 4.2), dpi=100, layout="constrained")
    scene = figure.add_subplot(1, 3, 1, projection="3d")
    first = jax.tree.map(lambda x: x[0], start)
    last = pose(found["Newton"].x[0], first)
    both = Pose(*map(jnp.stack, zip(first, last, strict=True)))
    colors = [(0.5, 0.5, 0.5, 0.4), (0.9, 0.3, 0.1, 1.0)]
    style = {"box_color": (0.4, 0.6, 0.8, 0.3), "ellipsoid_color": colors}
    draw_bodies(CORNER, ellipsoid_at(both, SEMI_AXES), scene, **style)
    scene.plot(*TARGET[:, None], "k*", ms=10, zorder=20)
    scene.set(xlim=(-0.75, 0.8), ylim=(-0.75, 0.8), zlim=(-0.2, 0.9))
    scene.set_box_aspect((1.55, 1.55, 1.1), zoom=1.3)
    scene.view_init(30, 228)
    scene.set_axis_off()
    scene.set_title("a start, where Newton ends, the target")
    for i, axis in enumerate(("step", "time of one descent (ms)")):
        axes = figure.add_subplot(1, 3, i + 2)
        for name, one in found.items():
            unit = (1, 1e3 * one.seconds)[i]
            x = unit * np.arange(1, one.gradient.shape[1] + 1)
            low, middle, high = np.quantile(one.gradient, [0.1, 0.5, 0.9], axis=0)
            (line,) = axes.loglog(x, middle, label=name)
            axes.fill_between(x, low, high, color=line.get_color(), alpha=0.15)
        axes.axhline(ARRIVED, color="0.3", ls=":")
        axes.set(xlabel=axis, ylabel="gradient: median, 10 to 90 %", ylim=(1e-5, None))
        axes.legend(fontsize=8)
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> dict[str, float | None]:
    """Descends, reports and draws; returns the median numbers of steps."""
    options = parser(__doc__, "3_second_order.png").parse_args(arguments)
    count, scale = (8, 0.5) if options.quick else (64, 1.0)
    names = ("Newton", "L-BFGS") if options.quick else METHODS
    start = starts(count, options.seed)
    found = {
        name: descend(name, GOAL, start, int(scale * STEPS[name])) for name in names
    }
    draw(options.output, start, found)
    rows = {name: summary(one) for name, one in found.items()}
    report(rows)
    text = "a Hessian takes as long as {hessian_by_gradient:.1f} gradients"
    say(
        options, text, methods=rows, hessian_by_gradient=GOAL.hessian_by_gradient(start)
    )
    return {name: row["steps, median"] for name, row in rows.items()}


if __name__ == "__main__":
    main()
