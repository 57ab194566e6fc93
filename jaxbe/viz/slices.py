"""`draw_slice`: level curves of the margin over the ellipsoid's centre."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from jaxbe.margin import margin
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.viz.checks import check_box, check_ellipsoid

LEVELS = np.arange(-1, 1.51, 0.125)
"""Of the function, below zero overlap."""

ROOM = 1.25
"""Of what is drawn, beyond boxes and ellipsoid."""

INK = "#222222"

Function = Callable[[Box, Ellipsoid], jax.Array]
Numbers = NDArray[np.floating[Any]]
Limits = tuple[tuple[float, float], tuple[float, float]]
AtCenter = Callable[[jax.Array], jax.Array]


def draw_slice(
    box: Box,
    ellipsoid: Ellipsoid,
    axes: Any = None,
    *,
    function: Function = margin,
    across: int = 2,
    limits: Limits | None = None,
    levels: Sequence[float] | Numbers = LEVELS,
    resolution: int = 201,
    arrows: int = 19,
) -> Any:
    """Draws a function of the ellipsoid's centre in a plane through this centre.

    Level curves, the one at zero (touching) in black, arrows for the direction of the
    gradient, dots where it has none in the plane; dashed the boxes, cut by this plane,
    and the ellipsoid where it is. With many boxes it is the least over them.

    Args:
        box: one box or a batch (N,).
        ellipsoid: one ellipsoid, no batch.
        axes: axes of matplotlib; new ones in a figure of their own if None.
        function: of box and ellipsoid, differentiable and below zero where they
            overlap.
        across: the world axis that is normal to the plane: 0, 1 or 2.
        limits: of the two other axes, metres; around all bodies if None.
        levels: ascending.
        resolution: points of the grid on each side.
        arrows: from left to right; 0 for none.

    Returns:
        What `contourf` returned, for a colour bar; its `axes` are those drawn on.

    Raises:
        ModuleNotFoundError: no matplotlib (at import).
        TypeError: an argument of the wrong class.
        ValueError: a batch of ellipsoids, boxes with more than one batch axis, or
            another number for `across`.
    """
    check_box(box)
    check_ellipsoid(ellipsoid)
    batch, own = box.check_form(), ellipsoid.check_form()
    if len(batch) > 1 or own:
        raise ValueError(
            "draw_slice draws boxes of shape () or (N,) and one ellipsoid, got batches "
            f"of shapes {batch} and {own}"
        )
    if across not in (0, 1, 2):
        raise ValueError(f"across must be 0, 1 or 2, got {across}")
    if axes is None:
        axes = Figure(figsize=(7, 5.5), layout="constrained").add_subplot()
    boxes = _batch(box, batch or (1,))
    plane = _Plane(ellipsoid, across, limits or _around(boxes, ellipsoid, across))
    at = _least(function, boxes, ellipsoid)
    levels = np.asarray(levels)
    points = plane.grid(resolution, resolution)
    x, y = plane.seen(points)
    values = _over(points, at)
    norm = TwoSlopeNorm(0, levels[0], levels[-1])
    extend = "both" if values.min() < levels[0] else "max"
    filled = axes.contourf(
        x, y, values, levels, cmap="RdBu", norm=norm, extend=extend, alpha=0.85
    )
    axes.contour(x, y, values, levels, colors="white", linewidths=0.5, alpha=0.8)
    axes.contour(x, y, values, [0], colors="black", linewidths=1.8)
    if arrows:
        _draw_arrows(axes, plane, at, arrows)
    _draw_sections(axes, plane, boxes, ellipsoid)
    names = np.delete(["x", "y", "z"], across)
    axes.set(xlim=plane.limits[0], ylim=plane.limits[1], aspect="equal")
    axes.set(xlabel=f"ellipsoid's centre, {names[0]} (m)", ylabel=f"{names[1]} (m)")
    return filled


class _Plane:
    """Points of the plane, across one axis of the world."""

    def __init__(self, ellipsoid: Ellipsoid, across: int, limits: Limits) -> None:
        self.center = np.asarray(ellipsoid.center)
        self.along = [i for i in range(3) if i != across]
        self.limits = limits

    def grid(self, columns: int, rows: int) -> Numbers:
        """Points (rows, columns, 3)."""
        ticks = [
            np.linspace(*ends, n)
            for ends, n in zip(self.limits, (columns, rows), strict=True)
        ]
        points = np.broadcast_to(self.center, (rows, columns, 3)).copy()
        points[..., self.along] = np.stack(np.meshgrid(*ticks), axis=-1)
        return points

    def seen(self, points: Numbers) -> tuple[Numbers, Numbers]:
        """The two coordinates in the plane."""
        first, second = self.along
        return points[..., first], points[..., second]


def _batch(box: Box, batch: tuple[int, ...]) -> Box:
    """All fields with the same batch axis."""
    center, axes, half_extents = box.fields().values()
    return Box.unchecked(
        jnp.broadcast_to(center, (*batch, 3)),
        jnp.broadcast_to(axes, (*batch, 3, 3)),
        jnp.broadcast_to(half_extents, (*batch, 3)),
    )


def _around(boxes: Box, ellipsoid: Ellipsoid, across: int) -> Limits:
    """Limits with room around all bodies, in the two axes of the plane."""
    extents = jnp.einsum("nij,nj->ni", abs(boxes.axes), boxes.half_extents)
    own = jnp.linalg.norm(ellipsoid.axes * ellipsoid.semi_axes[None], axis=-1)
    centers = jnp.concatenate([boxes.center, ellipsoid.center[None]])
    reach = jnp.concatenate([extents, own[None]])
    low, high = (centers - reach).min(axis=0), (centers + reach).max(axis=0)
    middle, half = (low + high) / 2, ROOM * (high - low) / 2
    first, second = (
        (float(middle[i] - half[i]), float(middle[i] + half[i]))
        for i in range(3)
        if i != across
    )
    return first, second


def _least(function: Function, boxes: Box, ellipsoid: Ellipsoid) -> AtCenter:
    """The function's least over the boxes, of the ellipsoid's centre."""

    def at(center: jax.Array) -> jax.Array:
        moved = Ellipsoid.unchecked(center, ellipsoid.axes, ellipsoid.semi_axes)
        return function(boxes, moved).min()

    return at


def _over(points: Numbers, function: Callable[[jax.Array], jax.Array]) -> Numbers:
    """The function of one point at many."""
    flat = jax.jit(jax.vmap(function))(points.reshape(-1, 3))
    return np.asarray(flat).reshape(*points.shape[:-1], *flat.shape[1:])


def _draw_arrows(axes: Any, plane: _Plane, at: AtCenter, columns: int) -> None:
    """The gradient's direction on a coarse grid; a dot where it has none."""
    (left, right), (low, high) = plane.limits
    rows = max(3, round(columns * (high - low) / (right - left)))
    points = plane.grid(columns, rows)[1:-1, 1:-1].reshape(-1, 3)
    gradient = np.stack(plane.seen(_over(points, jax.grad(at))), axis=-1)
    size = np.linalg.norm(gradient, axis=-1, keepdims=True)
    flat = size[..., 0] == 0
    direction = gradient / np.where(size == 0, 1, size)
    style = {"color": INK, "pivot": "mid", "scale": 34, "width": 0.0028}
    x, y = plane.seen(points)
    axes.quiver(x[~flat], y[~flat], *direction[~flat].T, **style, zorder=4)
    axes.plot(x[flat], y[flat], "o", ms=2.2, color=INK, zorder=4)


def _draw_sections(
    axes: Any, plane: _Plane, boxes: Box, ellipsoid: Ellipsoid, resolution: int = 401
) -> None:
    """Where the plane cuts the bodies."""
    points = plane.grid(resolution, resolution)
    x, y = plane.seen(points)
    inside = np.full(points.shape[:-1], np.inf)
    for center, turned, half in zip(
        *map(np.asarray, (boxes.center, boxes.axes, boxes.half_extents)), strict=True
    ):
        own = np.max(abs((points - center) @ turned) - half, axis=-1)
        inside = np.minimum(inside, own)
    rim = {"colors": "#111111", "linewidths": 1.2}
    axes.contour(x, y, inside, [0], linestyles="--", **rim)
    ratio = (points - plane.center) @ ellipsoid.axes / ellipsoid.semi_axes[None, None]
    axes.contour(x, y, np.linalg.norm(ratio, axis=-1), [1], **rim)
