"""`draw_pair`: one box, one ellipsoid, and how they touch."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

from jaxbe.contact import contact
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.viz.checks import check_box, check_ellipsoid
from jaxbe.viz.solids import (
    BOX_COLOR,
    ELLIPSOID_COLOR,
    REST_COLOR,
    Points,
    add_faces,
    add_mark,
    add_outline,
    box_faces,
    ellipsoid_faces,
    placed,
    quadrilaterals,
)
from jaxbe.viz.view import Mark

PLANE_COLOR = (0.2, 0.7, 0.3, 0.3)
PLANE_SIZE = 0.8
"""Half its side, by the longest length of the two bodies."""


def draw_pair(box: Box, ellipsoid: Ellipsoid, axes: Any = None) -> Any:
    """Draws a pair with its witness points and contact normal.

    Apart: the plane half way between the witness points, across the normal, which has
    one body on either side. Overlapping: the shortest way out that was found, from the
    ellipsoid's deepest point, and in grey where the ellipsoid then touches.

    Args:
        box: one box, no batch.
        ellipsoid: one ellipsoid.
        axes: 3-D axes of matplotlib; new ones in a figure of their own if None.

    Returns:
        The axes; `axes.figure.savefig(file)` writes them.

    Raises:
        ModuleNotFoundError: no matplotlib (at import).
        TypeError: an argument of the wrong class.
        ValueError: a batch of pairs; or numbers that are not finite.
    """
    check_box(box)
    check_ellipsoid(ellipsoid)
    shapes = box.check_form(), ellipsoid.check_form()
    if shapes != ((), ()):
        raise ValueError(
            f"draw_pair draws one pair, got batches of shapes {shapes[0]} and "
            f"{shapes[1]}"
        )
    mark = Mark.of(jax.jit(contact)(box, ellipsoid))
    if not mark.known():
        raise ValueError("draw_pair needs finite numbers, and the distance is not")
    if axes is None:
        figure = Figure(figsize=(7, 7), layout="constrained")
        axes = figure.add_subplot(projection="3d")
    bodies = _box_faces(box, 16), _ellipsoid_faces(ellipsoid)
    parts = list(zip(bodies, (BOX_COLOR, ELLIPSOID_COLOR), strict=True))
    if mark.distance > 0:
        parts.append((_plane(mark, _longest(box, ellipsoid)), PLANE_COLOR))
    else:
        way = np.subtract(mark.on_box, mark.on_ellipsoid)
        parts.append((bodies[1] + way, REST_COLOR))
    add_faces(axes, parts)
    add_outline(axes, _box_faces(box, 1))
    add_mark(axes, mark)
    if mark.distance <= 0:
        _add_way_out(axes, mark)
    return axes


def _box_faces(box: Box, cells: int) -> Points:
    faces = box_faces(np.asarray(box.half_extents, float), cells)
    return placed(faces, box.axes, box.center)


def _ellipsoid_faces(ellipsoid: Ellipsoid) -> Points:
    faces = ellipsoid_faces(np.asarray(ellipsoid.semi_axes, float))
    return placed(faces, ellipsoid.axes, ellipsoid.center)


def _longest(box: Box, ellipsoid: Ellipsoid) -> float:
    lengths = np.concatenate([box.half_extents, ellipsoid.semi_axes])
    return float(lengths.max())


def _plane(mark: Mark, longest: float) -> Points:
    """A square across the normal, in parts (n, 4, 3)."""
    _, _, across = np.linalg.svd(np.array([mark.normal]))
    ticks = np.linspace(-1, 1, 13) * PLANE_SIZE * longest
    grid = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    return np.asarray(quadrilaterals(grid) @ across[1:] + mark.middle())


def _add_way_out(axes: Any, mark: Mark) -> None:
    way = np.subtract(mark.on_box, mark.on_ellipsoid)
    rim, fill = {"color": "black", "lw": 4}, {"color": "white", "lw": 2}
    arrow = *mark.on_ellipsoid, *way
    axes.quiver(*arrow, arrow_length_ratio=0.2, zorder=13, **rim)
    axes.quiver(
        *arrow, arrow_length_ratio=0.2, zorder=13, **fill, label="shortest way out"
    )
    axes.legend(title=mark.caption(), loc="upper left", facecolor="0.85")
