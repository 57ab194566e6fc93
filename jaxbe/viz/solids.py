"""Boxes, ellipsoids and contacts in matplotlib's 3-D axes, in true proportions."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from jaxbe.viz.view import (
    NORMAL_COLOR,
    ON_BOX_COLOR,
    ON_ELLIPSOID_COLOR,
    Color,
    Mark,
)

ELLIPSOID_COLOR = (1.0, 0.25, 0.10, 0.6)
BOX_COLOR = (0.10, 0.45, 1.0, 0.5)
REST_COLOR = (0.6, 0.63, 0.65, 0.15)

NORMAL_BEYOND = 0.1
"""How far the normal goes beyond the points, by the extent of what is plotted."""

Points = NDArray[np.float64]


def add_faces(axes: Any, parts: list[tuple[Points, Color]]) -> None:
    """Adds faces (n, 4, 3) with their colours, and sets the limits around them.

    All as one collection: matplotlib sorts by depth only within one.
    """
    together = np.concatenate([faces for faces, _ in parts])
    colors = [color for faces, color in parts for _ in faces]
    # Without edges opaque faces have seams; translucent ones would have dark ones.
    widths = [0.3 if color[3] == 1 else 0 for color in colors]
    style = {"facecolors": colors, "edgecolors": colors, "linewidths": widths}
    axes.add_collection3d(Poly3DCollection(together, **style, shade=True))
    set_limits(axes, together.reshape(-1, 3))


def add_outline(axes: Any, faces: Points, **style: Any) -> None:
    """The edges of faces (n, 4, 3)."""
    style = {"color": "black", "linewidth": 0.3} | style
    for face in faces:
        axes.plot(*face[[0, 1, 2, 3, 0]].T, **style)


def add_mark(axes: Any, mark: Mark) -> None:
    """Draws witness points and normal over everything, and says what they are."""
    axes.computed_zorder = False
    for name, point, color in (
        ("on the ellipsoid", mark.on_ellipsoid, ON_ELLIPSOID_COLOR),
        ("on the box", mark.on_box, ON_BOX_COLOR),
    ):
        style = {"color": color, "mec": "white", "ms": 8, "ls": "none"}
        axes.plot(*np.array([point]).T, marker="o", label=name, zorder=12, **style)
    limits = axes.get_xlim(), axes.get_ylim(), axes.get_zlim()
    start, end = mark.arrow(NORMAL_BEYOND * float(np.ptp(limits, axis=1).max()))
    arrow = *start, *(end - start)
    rim, fill = {"color": "black", "lw": 5}, {"color": NORMAL_COLOR, "lw": 3}
    axes.quiver(*arrow, arrow_length_ratio=0.1, zorder=11, **rim)
    axes.quiver(*arrow, arrow_length_ratio=0.1, zorder=11, label="normal", **fill)
    axes.legend(title=mark.caption(), loc="upper left")


def placed(faces: Points, axes: Any, center: Any) -> Points:
    """Faces turned by axes (3, 3) and moved to a centre (3,)."""
    turned = faces @ np.asarray(axes, float).T
    return np.asarray(turned + np.asarray(center, float))


def box_faces(half_extents: Points, cells: int) -> Points:
    """The faces of a box at the origin in cells x cells parts, (n, 4, 3).

    Large faces would be sorted wrongly by depth.
    """
    ticks = np.linspace(-1, 1, cells + 1)
    grid = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    square = quadrilaterals(grid)
    faces = [
        np.insert(square, axis, side, axis=-1)
        for axis, side in itertools.product(range(3), (-1, 1))
    ]
    return np.concatenate(faces) * half_extents


def ellipsoid_faces(semi_axes: Points, rings: int = 16) -> Points:
    """Quadrilaterals that cover an ellipsoid at the origin, (n, 4, 3)."""
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings + 1),
        np.linspace(0, 2 * np.pi, 2 * rings + 1),
        indexing="ij",
    )
    r = np.sin(polar)
    grid = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.cos(polar)], axis=-1)
    return quadrilaterals(grid) * semi_axes


def quadrilaterals(grid: Points) -> Points:
    """The cells of a grid of points (m, n, d), as corners (cells, 4, d)."""
    corners = [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]]
    return np.stack(corners, axis=2).reshape(-1, 4, grid.shape[-1])


def set_limits(axes: Any, points: Points) -> None:
    """One scale on all axes."""
    low, high = points.min(axis=0), points.max(axis=0)
    for set_limit, start, stop in zip(
        (axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, strict=True
    ):
        set_limit(start, stop)
    axes.set_box_aspect(high - low, zoom=0.9)
    axes.locator_params(nbins=4)
    for set_label, name in zip(
        (axes.set_xlabel, axes.set_ylabel, axes.set_zlabel), "xyz", strict=True
    ):
        set_label(f"{name} (m)")
