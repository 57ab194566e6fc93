"""Renders a state with MuJoCo: `python -m jaxbe.cli.render OUT.png < view.json`.

A process of its own, see `jaxbe.cli.picture`. Two views side by side: the whole
scene, and the pair in focus with everything else translucent.
"""

from __future__ import annotations

import itertools
import json
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxbe.cli.picture import View

SIDE = 720
"""Of each view, pixels."""

ELLIPSOID_COLOR = (1.0, 0.25, 0.10, 1.0)
BOX_COLOR = (0.10, 0.45, 1.0, 0.55)
REST_ALPHA = 0.15

DIRECTIONS = tuple(itertools.product(range(0, 360, 30), (-15, -40)))
"""Azimuths and elevations to choose from for the close view, degrees."""

Image = NDArray[np.uint8]
Point = NDArray[np.float64]
Color = tuple[float, float, float, float]


def main() -> None:
    """Reads the view from standard input and writes the picture."""
    view = View(*json.load(sys.stdin))
    Path(sys.argv[1]).write_bytes(png(render(view)))


def render(view: View) -> Image:
    """Renders both views, (height, width, 3)."""
    model = mujoco.MjModel.from_xml_path(view.scene)
    data = mujoco.MjData(model)
    data.qpos[:] = view.qpos
    mujoco.mj_forward(model, data)
    model.vis.global_.offwidth = model.vis.global_.offheight = SIDE
    # Collision geoms are often in a group that is not shown.
    model.geom_group[list(view.highlighted())] = 0
    point = _meeting_point(model, data, view.focus)
    _remove_floor_above(model, data, point)
    renderer = mujoco.Renderer(model, SIDE, SIDE)
    try:
        _update(renderer, data, _whole_camera(model, point), _colors(view.pairs()), 1)
        whole = np.array(renderer.render())
        _update_close(renderer, data, _close_camera(renderer, data, view, point), view)
        close = np.array(renderer.render())
    finally:
        renderer.close()
    return np.concatenate([whole, close], axis=1)


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


def _meeting_point(model: Any, data: Any, focus: list[int]) -> Point:
    """Half way between the ellipsoid's centre and the nearest point of the box."""
    ellipsoid, box = focus
    k = _in_box_frame(data, box, data.geom_xpos[ellipsoid])
    nearest = np.clip(k, -model.geom_size[box], model.geom_size[box])
    axes = data.geom_xmat[box].reshape(3, 3)
    return np.asarray(data.geom_xpos[box] + axes @ (nearest + k) / 2)


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
    """A camera on the pair in focus, from where both geoms are seen best."""
    ellipsoid, box = view.focus
    model = renderer.model
    camera = mujoco.MjvCamera()
    camera.lookat[:] = point
    away = 8 * min(model.geom_rbound[ellipsoid], model.geom_rbound[box])

    def aim(direction: tuple[int, int]) -> None:
        camera.azimuth, camera.elevation = direction
        camera.distance = away + _depth_in_box(model, data, box, point, direction)

    def visible(direction: tuple[int, int]) -> float:
        aim(direction)
        _update_close(renderer, data, camera, view)
        renderer.enable_segmentation_rendering()
        ids = renderer.render()[..., 0]
        renderer.disable_segmentation_rendering()
        return float((np.sum(ids == ellipsoid) + 1) * (np.sum(ids == box) + 1))

    aim(max(DIRECTIONS, key=visible))
    return camera


def _depth_in_box(
    model: Any, data: Any, box: int, point: Point, direction: tuple[int, int]
) -> float:
    """How far it is from a point in the box to its surface, towards the camera."""
    azimuth, elevation = np.radians(direction)
    level = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
    ray = -np.cos(elevation) * data.geom_xmat[box].reshape(3, 3).T @ level
    p = _in_box_frame(data, box, point)
    with np.errstate(divide="ignore"):
        exits = (model.geom_size[box] - np.sign(ray) * p) / abs(ray)
    return max(0.0, float(exits.min()))


def _colors(pairs: list[list[int]]) -> dict[int, Color]:
    ellipsoids = {ellipsoid: ELLIPSOID_COLOR for ellipsoid, _ in pairs}
    return ellipsoids | {box: BOX_COLOR for _, box in pairs}


def _update_close(renderer: Any, data: Any, camera: Any, view: View) -> None:
    _update(renderer, data, camera, _colors([view.focus]), REST_ALPHA)


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
