"""Witness points, normal and distance of a contact, in a scene of MuJoCo's renderer."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from jaxbe.viz.view import (
    NORMAL_COLOR,
    ON_BOX_COLOR,
    ON_ELLIPSOID_COLOR,
    Color,
    Mark,
    Point,
)

POINT_RADIUS, NORMAL_RADIUS, NORMAL_BEYOND = 0.012, 0.006, 0.07
"""By the camera's distance."""


def add_markers(scene: Any, mark: Mark, away: float) -> None:
    """Adds two balls, and an arrow through them.

    Args:
        scene: a `mujoco.MjvScene`.
        mark: a contact.
        away: the camera's distance.
    """
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    for point, color in (
        (mark.on_ellipsoid, ON_ELLIPSOID_COLOR),
        (mark.on_box, ON_BOX_COLOR),
    ):
        _add_geom(scene, sphere, np.array(point), color).size[:] = POINT_RADIUS * away
    start, end = mark.arrow(NORMAL_BEYOND * away)
    arrow = _add_geom(scene, mujoco.mjtGeom.mjGEOM_ARROW, start, NORMAL_COLOR)
    # MuJoCo draws arrows to half their length.
    tip = 2 * end - start
    mujoco.mjv_connector(arrow, arrow.type, NORMAL_RADIUS * away, start, tip)


def add_caption(scene: Any, mark: Mark, away: float, right: Point) -> None:
    """Adds the distance as text, beside the right end of the arrow.

    Args:
        scene: as for `add_markers`.
        mark: as for `add_markers`.
        away: as for `add_markers`.
        right: the direction that is to the right in the picture: so runs the text.
    """
    ends = mark.arrow(1.2 * NORMAL_BEYOND * away)
    place = max(ends, key=lambda end: float(end @ right))
    label = _add_geom(scene, mujoco.mjtGeom.mjGEOM_LABEL, place, (1.0, 1.0, 1.0, 1.0))
    label.label = mark.caption()


def _add_geom(scene: Any, kind: Any, position: Point, color: Color) -> Any:
    """A geom for the eye only, with a number in the segmentation."""
    geom = scene.geoms[scene.ngeom]
    rgba = np.array(color, np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), position, np.eye(3).ravel(), rgba)
    geom.emission = 0.4  # Bright in the dark too.
    geom.segid = geom.objid = scene.ngeom
    scene.ngeom += 1
    return geom
