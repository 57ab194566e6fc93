"""Witness points, normal and distance of a contact, in a scene of MuJoCo's renderer."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from jaxbe.cli.picture import (
    NORMAL_COLOR,
    ON_BOX_COLOR,
    ON_ELLIPSOID_COLOR,
    Color,
    Point,
    View,
)

POINT_RADIUS, NORMAL_RADIUS, NORMAL_BEYOND = 0.012, 0.006, 0.07
"""By the camera's distance."""


def add_markers(scene: Any, view: View, away: float) -> None:
    """Adds two balls, and an arrow through them.

    Args:
        scene: a `mujoco.MjvScene`.
        view: with a contact.
        away: the camera's distance.
    """
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    for point, color in (
        (view.on_ellipsoid, ON_ELLIPSOID_COLOR),
        (view.on_box, ON_BOX_COLOR),
    ):
        _add_geom(scene, sphere, np.array(point), color).size[:] = POINT_RADIUS * away
    start, end = view.arrow(NORMAL_BEYOND * away)
    arrow = _add_geom(scene, mujoco.mjtGeom.mjGEOM_ARROW, start, NORMAL_COLOR)
    # MuJoCo draws arrows to half their length.
    tip = 2 * end - start
    mujoco.mjv_connector(arrow, arrow.type, NORMAL_RADIUS * away, start, tip)


def add_caption(scene: Any, view: View, away: float, right: Point) -> None:
    """Adds the distance as text, beside the right end of the arrow.

    Args:
        scene: as for `add_markers`.
        view: as for `add_markers`.
        away: as for `add_markers`.
        right: the direction that is to the right in the picture: so runs the text.
    """
    ends = view.arrow(1.2 * NORMAL_BEYOND * away)
    place = max(ends, key=lambda end: float(end @ right))
    label = _add_geom(scene, mujoco.mjtGeom.mjGEOM_LABEL, place, (1.0, 1.0, 1.0, 1.0))
    label.label = view.caption()


def _add_geom(scene: Any, kind: Any, position: Point, color: Color) -> Any:
    """A geom for the eye only, with a number in the segmentation."""
    geom = scene.geoms[scene.ngeom]
    rgba = np.array(color, np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), position, np.eye(3).ravel(), rgba)
    geom.emission = 0.4  # Bright in the dark too.
    geom.segid = geom.objid = scene.ngeom
    scene.ngeom += 1
    return geom
