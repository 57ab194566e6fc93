"""`draw_bodies`: many boxes and ellipsoids."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure

from jaxbe.shapes import Box, Ellipsoid
from jaxbe.viz.checks import check_box, check_ellipsoid
from jaxbe.viz.solids import (
    BOX_COLOR,
    ELLIPSOID_COLOR,
    Points,
    add_faces,
    add_outline,
    box_faces,
    ellipsoid_faces,
    placed,
)

OUTLINE = {"color": "0.15", "linewidth": 0.6}


def draw_bodies(
    box: Box | None = None,
    ellipsoid: Ellipsoid | None = None,
    axes: Any = None,
    *,
    box_color: Any = BOX_COLOR,
    ellipsoid_color: Any = ELLIPSOID_COLOR,
    rings: int = 16,
) -> Any:
    """Draws boxes and ellipsoids in true proportions.

    Args:
        box: of any batch shape; at least one of both is needed.
        ellipsoid: of any batch shape.
        axes: 3-D axes of matplotlib; new ones in a figure of their own if None.
        box_color: a colour of matplotlib, or one for each.
        ellipsoid_color: a colour of matplotlib, or one for each.
        rings: how finely ellipsoids are drawn.

    Returns:
        The axes; `axes.figure.savefig(file)` writes them.

    Raises:
        ModuleNotFoundError: no matplotlib (at import).
        TypeError: an argument of the wrong class.
        ValueError: nothing to draw.
    """
    if box is not None:
        check_box(box)
    if ellipsoid is not None:
        check_ellipsoid(ellipsoid)
    boxes, ellipsoids = _each(box, box_color), _each(ellipsoid, ellipsoid_color)
    if not (boxes or ellipsoids):
        raise ValueError("draw_bodies needs a box or an ellipsoid at least, got none")
    if axes is None:
        figure = Figure(figsize=(7, 7), layout="constrained")
        axes = figure.add_subplot(projection="3d")
    parts = []
    for (center, turned, half), color in boxes:
        parts.append((placed(box_faces(half, 8), turned, center), color))
        add_outline(axes, placed(box_faces(half, 1), turned, center), **OUTLINE)
    for (center, turned, half), color in ellipsoids:
        faces = ellipsoid_faces(half, rings)
        parts.append((placed(faces, turned, center), color))
    add_faces(axes, parts)
    return axes


def _each(
    body: Box | Ellipsoid | None, color: Any
) -> list[tuple[tuple[Points, ...], Any]]:
    """Centre, axes, lengths and colour of each of a batch."""
    if body is None:
        return []
    batch = body.check_form()
    fields = [
        np.asarray(jnp.broadcast_to(x, (*batch, *shape)), float).reshape(-1, *shape)
        for x, shape in zip(body.fields().values(), ((3,), (3, 3), (3,)), strict=True)
    ]
    count = len(fields[0])
    colors = np.broadcast_to(to_rgba_array(color), (count, 4))
    return list(zip(zip(*fields, strict=True), map(tuple, colors), strict=True))
