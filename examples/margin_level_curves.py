"""Level curves of the margin beside those of sqrt(q) - 1, and both gradients.

A slice of the plane z = 0 through a box; the centre of a long, tilted ellipsoid
moves over it. The margin tells depth and the way out everywhere but in the box's
own centre; sqrt(q) - 1 is flat as soon as the ellipsoid's centre is in the box.

    python examples/margin_level_curves.py --output margin-level-curves.png
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe

REACH = (3.0, 2.4)
HALF_EXTENTS = (1.0, 0.6, 0.5)
SEMI_AXES = (1.3, 0.35, 0.3)
TILT = np.deg2rad(35)
LEVELS = np.arange(-1, 1.51, 0.125)
ARROWS = (19, 15)

Function = Callable[[jaxbe.Box, jaxbe.Ellipsoid], jax.Array]


def sqrt_q_minus_one(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """What the tests of the paper compare with zero."""
    return jaxbe.scaled_distance(box, ellipsoid) - 1


def tilted(angle: float) -> jax.Array:
    """Axes turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    return jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def of_center(function: Function) -> Callable[[jax.Array], jax.Array]:
    """The function of the ellipsoid's centre alone."""
    box = jaxbe.Box(jnp.zeros(3), jnp.eye(3), jnp.array(HALF_EXTENTS))

    def at(center: jax.Array) -> jax.Array:
        axes, lengths = tilted(TILT), jnp.array(SEMI_AXES)
        return function(box, jaxbe.Ellipsoid.unchecked(center, axes, lengths))

    return at


def grid(columns: int, rows: int) -> np.ndarray:
    """Points (rows, columns, 3) of the slice."""
    x = np.linspace(-REACH[0], REACH[0], columns)
    y = np.linspace(-REACH[1], REACH[1], rows)
    return np.stack([*np.meshgrid(x, y), np.zeros((rows, columns), x.dtype)], axis=-1)


def over(points: np.ndarray, function: Callable[[jax.Array], Any]) -> np.ndarray:
    """The function of one point at many."""
    flat = jax.jit(jax.vmap(function))(points.reshape(-1, 3))
    return np.asarray(flat).reshape(*points.shape[:2], *flat.shape[1:])


def draw_levels(axes: Any, function: Function, resolution: int) -> Any:
    """Filled levels, the touching contour and the gradient's arrows."""
    from matplotlib.colors import TwoSlopeNorm

    points = grid(resolution, resolution)
    x, y = points[..., 0], points[..., 1]
    at = of_center(function)
    values = over(points, at)
    norm = TwoSlopeNorm(0, LEVELS[0], LEVELS[-1])
    filled = axes.contourf(
        x, y, values, LEVELS, cmap="RdBu", norm=norm, extend="max", alpha=0.85
    )
    axes.contour(x, y, values, LEVELS, colors="white", linewidths=0.5, alpha=0.8)
    axes.contour(x, y, values, [0], colors="black", linewidths=1.8)
    draw_arrows(axes, at)
    return filled


def draw_arrows(axes: Any, at: Callable[[jax.Array], jax.Array]) -> None:
    """The gradient's direction on a coarse grid; a dot where it vanishes."""
    points = grid(*ARROWS)[1:-1, 1:-1]
    # The coarse grid has the coincident centres, where there is no direction.
    points = points[np.any(points != 0, axis=-1)][None]
    gradient = over(points, jax.grad(at))[..., :2]
    size = np.linalg.norm(gradient, axis=-1, keepdims=True)
    flat = size[..., 0] == 0
    direction = gradient / np.where(size == 0, 1, size)
    style = {"color": "#222222", "pivot": "mid", "scale": 34, "width": 0.0028}
    axes.quiver(
        points[~flat][:, 0], points[~flat][:, 1], *direction[~flat].T, **style, zorder=4
    )
    axes.plot(*points[flat].T[:2], "o", ms=2.2, color="#222222", zorder=4)


def draw_bodies(axes: Any, center: tuple[float, float]) -> None:
    """The box, and the ellipsoid in one of its places."""
    from matplotlib.patches import Ellipse, Rectangle

    w, h = HALF_EXTENTS[:2]
    style = {"fill": False, "edgecolor": "#111111", "lw": 1.2}
    axes.add_patch(Rectangle((-w, -h), 2 * w, 2 * h, **style, ls="--"))
    a, b = SEMI_AXES[:2]
    axes.add_patch(Ellipse(center, 2 * a, 2 * b, angle=np.rad2deg(TILT), **style))
    axes.set(xlim=(-REACH[0], REACH[0]), ylim=(-REACH[1], REACH[1]), aspect="equal")
    axes.set(xlabel="ellipsoid's centre, x", ylabel="y")


def draw(file: Path, resolution: int) -> None:
    """Both functions side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.2), layout="constrained")
    functions = {"margin": jaxbe.margin, r"$\sqrt{q}-1$": sqrt_q_minus_one}
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, function) in zip(panels, functions.items(), strict=True):
        filled = draw_levels(axes, function, resolution)
        draw_bodies(axes, (1.75, 0.35))
        axes.set_title(f"{name}: levels and direction of the gradient", fontsize=11)
    panels[1].set_ylabel("")
    bar = figure.colorbar(filled, ax=panels, shrink=0.9, pad=0.015, ticks=LEVELS[::4])
    bar.set_label("negative: overlap, black: touching, positive: apart")
    figure.savefig(file, dpi=160)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draws."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--output", type=Path, default="margin-level-curves.png")
    parser.add_argument("--resolution", type=int, default=501)
    options = parser.parse_args(arguments)
    draw(options.output, options.resolution)


if __name__ == "__main__":
    main()
