"""`render`: a MuJoCo scene with its contacts."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.image import imread
from numpy.typing import ArrayLike, NDArray

from jaxbe.contact import Contact
from jaxbe.viz.picture import draw
from jaxbe.viz.view import Mark, View


def render(
    model: Any,
    data: Any,
    contacts: Contact | None = None,
    *,
    geom: ArrayLike | Sequence[Sequence[int]] = (),
) -> NDArray[np.uint8]:
    """Renders a scene, with witness points and normals over it.

    MuJoCo renders, in a process of its own, with the OpenGL that the environment
    variable MUJOCO_GL names, or else EGL or OSMesa; where there is none matplotlib
    plots the boxes and ellipsoids of the scene.

    Args:
        model: a `mujoco.MjModel`.
        data: a `mujoco.MjData` or `mjx.Data` of one state, of which `qpos`,
            `mocap_pos` and `mocap_quat` are read.
        contacts: of any batch shape, world frame: what `jaxbe.contact` answers. Those
            that are not finite are left out.
        geom: (P, 2), geom ids [ellipsoid, box], as in `Pairs.geom` and
            `Candidates.geom`: pairs to colour red and blue.

    Returns:
        An RGB image (height, width, 3).

    Raises:
        ModuleNotFoundError: no mujoco or matplotlib (at import).
        TypeError: another kind of model.
    """
    if not isinstance(model, mujoco.MjModel):
        given = type(model).__name__
        raise TypeError(f"model must be a mujoco.MjModel, got {given}")
    model = copy.copy(model)
    mocap = model.body_mocapid >= 0
    order = model.body_mocapid[mocap]
    model.body_pos[mocap] = np.asarray(data.mocap_pos)[order]
    model.body_quat[mocap] = np.asarray(data.mocap_quat)[order]
    pairs = np.asarray(geom, int).reshape(-1, 2).tolist()
    with tempfile.TemporaryDirectory() as folder:
        scene, path = Path(folder) / "scene.mjb", Path(folder) / "picture.png"
        mujoco.mj_saveModel(model, str(scene), None)
        qpos = np.asarray(data.qpos, float).tolist()
        draw(model, View(str(scene), qpos, pairs, [], _marks(contacts)), path)
        image = imread(path)[..., :3]
    return np.asarray(np.rint(255 * image), np.uint8)


def _marks(contacts: Contact | None) -> list[Mark]:
    """One for each contact of a batch."""
    if contacts is None:
        return []
    rows = zip(
        np.ravel(contacts.distance),
        *(np.reshape(x, (-1, 3)) for x in contacts[1:]),
        strict=True,
    )
    return [Mark.of(Contact(*row)) for row in rows]
