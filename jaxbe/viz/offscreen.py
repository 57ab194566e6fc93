"""Renders a state with MuJoCo: `python -m jaxbe.viz.offscreen OUT.png < view.json`.

A process of its own, see `jaxbe.viz.picture`. The whole scene; and if a pair is in
focus this beside it, with everything else translucent.
"""

from __future__ import annotations

import itertools
import json
import os
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxbe.viz.markers import add_caption, add_markers
from jaxbe.viz.mujoco_log import warnings_to
from jaxbe.viz.view import Color, Mark, Point, View

SIDE = 720
"""Of each view, pixels."""

ELLIPSOID_COLOR = (1.0, 0.25, 0.10)
BOX_COLOR = (0.10, 0.45, 1.0)
SEE_THROUGH, INSIDE_SEEN = 0.55, 0.3
REST_ALPHA = 0.1

MARK_SIZE_IN_WHOLE = 0.6
"""Of points and arrows, by those of the close view."""

DIRECTIONS = tuple(itertools.product(range(0, 360, 30), (-15, -40)))
"""Azimuths and elevations to choose from for the close view, degrees."""

Image = NDArray[np.uint8]
Direction = tuple[float, float]


def main() -> None:
    """Reads the view from standard input and writes the picture."""
    view = View.from_json(json.load(sys.stdin))
    with warnings_to(lambda text: print(text, file=sys.stderr)):
        image = render(view)
    Path(sys.argv[1]).write_bytes(png(image))


def render(view: View) -> Image:
    """Renders the views side by side, (height, width, 3)."""
    model = _load(view.scene)
    data = mujoco.MjData(model)
    data.qpos[:] = view.qpos
    mujoco.mj_forward(model, data)
    model.vis.global_.offwidth = model.vis.global_.offheight = SIDE
    # Collision geoms are often in a group that is not shown.
    model.geom_group[list(view.highlighted())] = 0
    point = _meeting_point(data, view)
    _remove_floor_above(model, data, point)
    renderer = mujoco.Renderer(model, SIDE, SIDE)
    try:
        if not view.focus:
            return _whole(renderer, data, point, view, view.known_marks())
        whole = _whole(renderer, data, point, view, [])
        close = _close(renderer, data, _close_camera(renderer, data, view, point), view)
    finally:
        renderer.close()
    return np.concatenate([whole, close], axis=1)


def _load(scene: str) -> Any:
    """The model, from XML or as it was saved."""
    # As bytes: the name of a file need not be UTF-8.
    file = os.fsencode(scene)
    if scene.endswith(".mjb"):
        return mujoco.MjModel.from_binary_path(file)
    return mujoco.MjModel.from_xml_path(file)


def png(image: Image) -> bytes:
    """Encodes an RGB image, without another library."""
    height, width, _ = image.shape
    header = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    rows = np.pad(image.reshape(height, -1), ((0, 0), (1, 0)))  # filter 0: none
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body))
        + kind
        + body
        + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in (
            (b"IHDR", header),
            (b"IDAT", zlib.compress(rows.tobytes())),
            (b"IEND", b""),
        )
    )


def _meeting_point(data: Any, view: View) -> Point:
    """Half way between the witness points, or what comes nearest to that."""
    marks = view.known_marks()
    if marks:
        return np.asarray(np.mean([mark.middle() for mark in marks], axis=0))
    if view.focus:
        return np.asarray(data.geom_xpos[view.focus].mean(axis=0))
    return np.asarray(data.model.stat.center)


def _remove_floor_above(model: Any, data: Any, point: Point) -> None:
    """Makes planes invisible that have the point behind them: they would hide it."""
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        if _in_box_frame(data, int(geom), point)[2] < 0:
            model.geom_matid[geom] = -1
            model.geom_rgba[geom, 3] = 0


def _in_box_frame(data: Any, geom: int, point: Point) -> Point:
    axes = data.geom_xmat[geom].reshape(3, 3)
    return np.asarray(axes.T @ (point - data.geom_xpos[geom]))


def _whole_camera(model: Any, point: Point) -> Any:
    """The model's own view, moved if the state is far from where it looks."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    if np.linalg.norm(point - camera.lookat) > model.stat.extent / 3:
        camera.lookat[:] = point
    return camera


def _close_camera(renderer: Any, data: Any, view: View, point: Point) -> Any:
    """A camera on the pair in focus, from where geoms and normal are seen best."""
    ellipsoid, box = view.focus
    model = renderer.model
    camera = mujoco.MjvCamera()
    camera.lookat[:] = point
    size = min(model.geom_rbound[ellipsoid], model.geom_rbound[box])
    marks = view.known_marks()
    away = max([6 * float(size), *(3 * abs(mark.distance) for mark in marks)])

    def aim(direction: Direction) -> None:
        camera.azimuth, camera.elevation = direction
        depth = max(_depth(data, geom, point, direction) for geom in view.focus)
        camera.distance = away + depth

    def visible(direction: Direction) -> float:
        aim(direction)
        _update_close(renderer, data, camera, view)
        ids = _segments(renderer)
        areas = (np.sum(ids == ellipsoid) + 1) * (np.sum(ids == box) + 1)
        forward = _forward(direction)
        crosses = [np.cross(forward, mark.normal) for mark in marks]
        sideways = [float(np.linalg.norm(x)) for x in crosses] or [1.0]
        return float(areas * np.mean(sideways))

    aim(max(DIRECTIONS, key=visible))
    return camera


def _forward(direction: Direction) -> Point:
    """Where a camera looks, a unit vector."""
    azimuth, elevation = np.radians(direction)
    level = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
    return np.asarray(np.cos(elevation) * level)


def _segments(renderer: Any) -> NDArray[np.int32]:
    """The number of the object at every pixel, -1 where there is none."""
    renderer.enable_segmentation_rendering()
    ids = np.array(renderer.render()[..., 0])
    renderer.disable_segmentation_rendering()
    return ids


def _depth(data: Any, geom: int, point: Point, direction: Direction) -> float:
    """How far it is from a point in a geom to its surface, towards the camera."""
    model = data.model
    length = mujoco.mju_rayGeom(
        data.geom_xpos[geom],
        data.geom_xmat[geom],
        model.geom_size[geom],
        point,
        -_forward(direction),
        model.geom_type[geom],
    )
    return max(0.0, float(length))


def _whole(
    renderer: Any, data: Any, point: Point, view: View, marks: list[Mark]
) -> Image:
    """The whole scene, with contacts over it."""
    camera = _whole_camera(renderer.model, point)
    _update(renderer, data, camera, _colors(view), 1)
    return _marked(renderer, camera, marks, MARK_SIZE_IN_WHOLE)


def _close(renderer: Any, data: Any, camera: Any, view: View) -> Image:
    """The pair in focus, with its contact over it."""
    _update_close(renderer, data, camera, view)
    # Translucent geoms would throw shadows too.
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    return _marked(renderer, camera, view.known_marks(), 1)


def _marked(renderer: Any, camera: Any, marks: list[Mark], size: float) -> Image:
    """The scene; witness points and normals over it, hidden by nothing."""
    if not marks:
        return np.array(renderer.render())
    scene, away = renderer.scene, size * camera.distance
    x, y, _ = _forward((camera.azimuth, camera.elevation))
    right = np.array([y, -x, 0])

    def caption() -> None:
        if len(marks) == 1:
            add_caption(scene, marks[0], away, right)

    caption()
    image = np.array(renderer.render())
    scene.ngeom = 0
    for mark in marks:
        add_markers(scene, mark, away)
    caption()
    marked = _segments(renderer)[..., None] >= 0
    return np.where(marked, np.array(renderer.render()), image)


def _colors(view: View) -> dict[int, Color]:
    pairs = [pair for pair in [*view.pairs, view.focus] if pair]
    ellipsoids = {ellipsoid: (*ELLIPSOID_COLOR, 1.0) for ellipsoid, _ in pairs}
    return ellipsoids | {box: (*BOX_COLOR, SEE_THROUGH) for _, box in pairs}


def _update_close(renderer: Any, data: Any, camera: Any, view: View) -> None:
    """The larger one is translucent: the other may be inside."""
    size = renderer.model.geom_rbound
    ellipsoid, box = view.focus
    alphas = (1.0, INSIDE_SEEN) if size[box] > size[ellipsoid] else (INSIDE_SEEN, 1.0)
    colors = {ellipsoid: (*ELLIPSOID_COLOR, alphas[0]), box: (*BOX_COLOR, alphas[1])}
    _update(renderer, data, camera, colors, REST_ALPHA)


def _update(
    renderer: Any, data: Any, camera: Any, colors: dict[int, Color], rest_alpha: float
) -> None:
    """Fills the renderer's scene and paints it."""
    renderer.update_scene(data, camera)
    for geom in renderer.scene.geoms[: renderer.scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in colors:
            geom.matid = -1
            geom.rgba[:] = colors[geom.objid]
        else:
            # A skin hides the geoms in it.
            is_skin = geom.objtype == mujoco.mjtObj.mjOBJ_SKIN
            geom.rgba[3] *= REST_ALPHA if is_skin else rest_alpha
        geom.transparent = geom.rgba[3] < 1


if __name__ == "__main__":
    main()
