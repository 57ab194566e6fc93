"""The scene of `reach_env.py` from above: imported, not run."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from reach_env import TARGET, Reach


def draw_scene(axes: Any, env: Reach) -> None:
    """The boxes and the middle of the targets."""
    from matplotlib.patches import Rectangle

    place = _placed(env, np.zeros(3))
    for i in np.flatnonzero(env.mj_model.geom_type == mujoco.mjtGeom.mjGEOM_BOX):
        x, y, angle, half = _seen(env, place, i)
        corner = (x - half[0], y - half[1])
        style = {"angle": angle, "rotation_point": "center", "color": "0.3"}
        axes.add_patch(Rectangle(corner, *(2 * half), **style))
    axes.plot(*TARGET, "*", ms=12, color="tab:green", zorder=5)
    axes.set(xlim=(-0.85, 0.65), ylim=(-0.67, 0.67), aspect="equal")
    axes.set(xlabel="x (m)", ylabel="y (m)")


def draw_hand(axes: Any, env: Reach, qpos: np.ndarray, **style: Any) -> None:
    """Palm and fingers at slides and wrist (3,)."""
    from matplotlib.patches import Ellipse

    place = _placed(env, qpos)
    for i in np.flatnonzero(env.mj_model.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        x, y, angle, half = _seen(env, place, i)
        axes.add_patch(Ellipse((x, y), *(2 * half), angle=angle, **style))


def sweep(axes: Any, env: Reach, path: np.ndarray, hands: int = 7) -> None:
    """The hand at times of its path (T, 3), evenly along the way, later is darker."""
    way = np.cumsum(np.abs(np.diff(path, axis=0, prepend=path[:1])).sum(axis=1))
    times = np.searchsorted(way, np.linspace(0, way[-1], hands))
    for shade, time in zip(np.linspace(0.25, 0.9, hands), times, strict=True):
        draw_hand(axes, env, path[time], color="tab:blue", alpha=shade)


def _placed(env: Reach, qpos: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(env.mj_model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(env.mj_model, data)
    return data


def _seen(
    env: Reach, data: mujoco.MjData, geom: int
) -> tuple[float, float, float, Any]:
    """Centre, angle in degrees and half lengths (2,) of a geom, from above."""
    x, y, _ = data.geom_xpos[geom]
    angle = np.rad2deg(np.arctan2(data.geom_xmat[geom][3], data.geom_xmat[geom][0]))
    return x, y, angle, env.mj_model.geom_size[geom, :2]
