"""python examples/5_largest_ellipsoid.py --output 5_largest_ellipsoid.png  (--quick).

The largest ellipsoid that fits among boxes: semi-axes and pose are the variables of an
augmented Lagrangian on the margins, from many starts in one vmap; at the end it is
scaled until `jaxbe.certify` proves it apart from all boxes. In a room between flat walls
the problem is convex, too, and SciPy's solver of that one knows the answer; among
parcels on a shelf there is no such solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from placing import Pose, against, all_separated, boxes, ellipsoid_at, parser
from rich.progress import track
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, HalfspaceIntersection

import jaxbe

SHELF = boxes(
    (0.0, 0.0, -0.05, 0.5, 0.5, 0.05),
    (0.0, 0.0, 0.65, 0.5, 0.5, 0.05),
    (0.55, 0.0, 0.3, 0.05, 0.5, 0.4),
    (-0.55, 0.0, 0.3, 0.05, 0.5, 0.4),
    (0.0, 0.55, 0.3, 0.6, 0.05, 0.4),
    (0.0, -0.55, 0.3, 0.6, 0.05, 0.4),
    (0.25, 0.2, 0.15, 0.15, 0.2, 0.15, 25),
    (-0.3, -0.25, 0.1, 0.15, 0.15, 0.1, -30),
    (-0.25, 0.3, 0.45, 0.18, 0.12, 0.15, 10),
)
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


def room(rng: np.random.Generator, walls: int = 10) -> tuple[jaxbe.Box, np.ndarray]:
    """Slabs around a polytope, and its rows (n, h): it is where n.x <= h."""
    spread = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    more = rng.normal(size=(walls - 6, 3))
    n = np.concatenate([spread, -spread, more / np.linalg.norm(more, axis=1)[:, None]])
    h = rng.uniform(0.3, 0.6, walls)
    axes = np.linalg.svd(n[:, None, :])[2].swapaxes(1, 2)[..., ::-1]
    slab = np.broadcast_to(np.float32([2, 2, 0.2]), (walls, 3))
    center = np.float32(n * (h + 0.2)[:, None])
    return jaxbe.Box(center, np.float32(axes), slab), np.column_stack([n, h])


def convex_volume(rows: np.ndarray) -> float:
    """Of the largest ellipsoid {d + L u} in a polytope: log det L is concave."""
    n, h = rows[:, :3], rows[:, 3]
    entries = np.tril_indices(3)

    def factor(x: np.ndarray) -> np.ndarray:
        L = np.zeros((3, 3))
        L[entries] = x[3:]
        return L

    def slack(x: np.ndarray) -> np.ndarray:
        return h - n @ x[:3] - np.linalg.norm(n @ factor(x), axis=1)

    def minus_log(x: np.ndarray) -> float:
        return -np.log(np.maximum(np.diag(factor(x)), 1e-9)).sum()

    start = np.concatenate([np.zeros(3), 0.1 * np.eye(3)[entries]])
    rule = {"type": "ineq", "fun": slack}
    options = {"maxiter": 500, "ftol": 1e-12}
    found = minimize(minus_log, start, constraints=rule, options=options)
    return float(4 / 3 * np.pi * np.exp(-found.fun))


def starts(rng: np.random.Generator, box: jaxbe.Box, count: int, spread: Any) -> Shape:
    """Small balls (count,) around a middle; most touch nothing."""
    low, high = spread
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
    halfspaces = np.column_stack([rows[:, :3], -rows[:, 3]])
    corners = HalfspaceIntersection(halfspaces, np.zeros(3)).intersections
    hull = ConvexHull(corners)
    style = {"color": (0.4, 0.6, 0.8, 0.25), "linewidth": 0}
    left.plot_trisurf(*corners.T, triangles=hull.simplices, **style)
    for i, a in enumerate(rows):
        for b in rows[:i]:
            on_both = abs(corners @ np.stack([a, b])[:, :3].T - (a[3], b[3])) < 1e-9
            edge = corners[on_both.all(axis=1)]
            left.plot(*edge.T, color="0.2", lw=0.8)
    low, high = corners.min(axis=0), corners.max(axis=0)
    left.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    left.set_box_aspect(high - low)
    parcels = jax.tree.map(lambda x: x[jnp.array([0, 4, 6, 7, 8])], SHELF)
    style = {"box_color": (0.75, 0.6, 0.4, 0.4), "ellipsoid_color": "tab:orange"}
    draw_bodies(parcels, both[1], right, **style)
    right.view_init(25, -70)
    left.set_title("between flat walls: as the convex solver says")
    right.set_title("among parcels on a shelf (three sides not drawn)")
    for axes in (left, right):
        axes.set_axis_off()
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> float:
    """Grows both and draws; returns the volume by that of the convex solver."""
    options = parser(__doc__, "5_largest_ellipsoid.png").parse_args(arguments)
    count, rounds = (4, 6) if options.quick else (64, 30)
    rng = np.random.default_rng(options.seed)
    walls, rows = room(rng)
    program = grower(rounds, 100)
    near = (np.full(3, -0.1), np.full(3, 0.1))
    one, volumes = largest(walls, starts(rng, walls, count, near), program, rounds)
    known = convex_volume(rows)
    share = float(volumes.max() / known)
    print(
        f"room: {1e3 * volumes.max():.3f} l proved, {1e3 * known:.3f} l by SciPy's",
        end="",
    )
    print(
        f" convex solver: {share:.2%}; {np.mean(volumes > 0.99 * known):.0%} of the starts"
    )
    inside = (np.float32([-0.4, -0.4, 0.1]), np.float32([0.4, 0.4, 0.5]))
    other, volumes = largest(SHELF, starts(rng, SHELF, count, inside), program, rounds)
    print(f"shelf: {1e3 * volumes.max():.3f} l proved; starts end at", end=" ")
    print(np.unique(np.round(1e3 * volumes, 1)).tolist(), "l")
    draw(options.output, rows, [one, other])
    return share


if __name__ == "__main__":
    main()
