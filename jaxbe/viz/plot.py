"""Plots a state of a scene with matplotlib: its boxes and ellipsoids."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.figure import Figure

from jaxbe.mjx.geom_types import BOX, ELLIPSOID
from jaxbe.viz.solids import (
    BOX_COLOR,
    ELLIPSOID_COLOR,
    REST_COLOR,
    add_faces,
    add_mark,
    add_outline,
    box_faces,
    ellipsoid_faces,
    placed,
)
from jaxbe.viz.view import View

SIDE = 7.2
"""Of each view, inches of 100 pixels."""


def plot(model: Any, view: View, path: Path) -> None:
    """Writes a PNG: the whole scene, and the pair in focus beside it.

    Args:
        model: a `mujoco.MjModel`.
        view: what to draw.
        path: the file to write.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = view.qpos
    mujoco.mj_kinematics(model, data)
    everything = np.flatnonzero(np.isin(model.geom_type, (BOX, ELLIPSOID)))
    views = [("all boxes and ellipsoids", everything.tolist())]
    if view.focus:
        views.append(("the pair", view.focus))
    figure = Figure(figsize=(SIDE * len(views), SIDE), dpi=100, layout="constrained")
    for i, (title, geoms) in enumerate(views):
        axes = figure.add_subplot(1, len(views), i + 1, projection="3d")
        axes.set_title(title)
        _add_geoms(axes, model, data, geoms, view.highlighted())
    for mark in view.known_marks():
        add_mark(axes, mark)
    figure.savefig(path, format="png")


def _add_geoms(
    axes: Any, model: Any, data: Any, geoms: list[int], highlighted: set[int]
) -> None:
    """Adds boxes and ellipsoids, in strong colours those highlighted."""
    parts = []
    for geom in geoms:
        is_highlighted, is_box = geom in highlighted, model.geom_type[geom] == BOX
        size = model.geom_size[geom]
        pose = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        color = BOX_COLOR if is_box else ELLIPSOID_COLOR
        cells = 16 if is_highlighted else 1
        faces = box_faces(size, cells) if is_box else ellipsoid_faces(size)
        parts.append((placed(faces, *pose), color if is_highlighted else REST_COLOR))
        if is_box:
            add_outline(axes, placed(box_faces(size, cells=1), *pose))
    add_faces(axes, parts)
