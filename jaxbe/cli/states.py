"""States of the scene: random or from a file, and the poses of its geoms there."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxbe.cli.errors import InputError
from jaxbe.cli.files import check_is_file
from jaxbe.cli.shown import shown

Floats = NDArray[np.floating[Any]]

FREE = int(mujoco.mjtJoint.mjJNT_FREE)
BALL = int(mujoco.mjtJoint.mjJNT_BALL)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)

_ARCHIVE = b"PK\3\4"
"""How an .npz file starts."""

_UNIFORMS = {FREE: 6, BALL: 3, SLIDE: 1, HINGE: 1}
"""How many random numbers a joint of each type takes."""


class States(NamedTuple):
    """States that are made when they are asked for.

    Attributes:
        total: how many there are.
        rows: gives those from start to stop, (stop - start, nq).
    """

    total: int
    rows: Callable[[int, int], Floats]


class Poses(NamedTuple):
    """The poses of all geoms in n states, in the world frame.

    Attributes:
        geom_xpos: (n, ngeom, 3), metres.
        geom_xmat: (n, ngeom, 9), rotation matrices by rows.
    """

    geom_xpos: Floats
    geom_xmat: Floats


def random_states(model: Any, count: int, seed: int) -> States:
    """Draws states inside the joint ranges; `jaxbe --help` says how.

    Every state has its own place in one stream of random numbers, so that it does
    not depend on the size of the batches.
    """
    width = sum(_UNIFORMS[kind] for kind in model.jnt_type)

    def rows(start: int, stop: int) -> Floats:
        stream = np.random.PCG64(seed).advance(start * width)
        uniforms = np.random.Generator(stream).random((stop - start, width))
        return sample_qpos(model, uniforms)

    return States(count, rows)


def states_from_file(model: Any, path: Path) -> States:
    """Reads states from an .npy file, a batch at a time.

    Raises:
        InputError: not an .npy file of finite real numbers (N, nq) or (nq,).
    """
    qpos = _open_array(path)
    if qpos.dtype.kind not in "fiu":
        raise InputError(f"{shown(path)}: qpos must be real numbers, got {qpos.dtype}")
    rows = qpos[None] if qpos.ndim == 1 else qpos
    if rows.ndim != 2 or rows.shape[1] != model.nq or not len(rows):
        raise InputError(
            f"{shown(path)}: qpos must have shape (N, {model.nq}) or ({model.nq},), "
            f"got {qpos.shape}"
        )
    _check_finite(path, rows)
    return States(len(rows), lambda start, stop: rows[start:stop].astype(float))


def forward_kinematics(model: Any, data: Any, qpos: Floats, poses: Poses) -> None:
    """Computes poses with MuJoCo C, one state after the other.

    Args:
        model: a `mujoco.MjModel`.
        data: its `mujoco.MjData`, overwritten.
        qpos: (n, nq).
        poses: written in place, its first n rows.

    Raises:
        InputError: poses that are not finite.
    """
    with np.errstate(over="ignore"):
        for i, row in enumerate(qpos):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            poses.geom_xpos[i] = data.geom_xpos
            poses.geom_xmat[i] = data.geom_xmat
    if not all(np.isfinite(x[: len(qpos)]).all() for x in poses):
        raise InputError("states so large that the poses of geoms are not finite")


def sample_qpos(model: Any, uniforms: Floats) -> Floats:
    """Maps uniform numbers in [0, 1) to states, (n, k) to (n, nq)."""
    qpos = np.tile(model.qpos0, (len(uniforms), 1))
    start = 0
    for joint, kind in enumerate(model.jnt_type):
        u = uniforms[:, start : start + _UNIFORMS[kind]]
        start += _UNIFORMS[kind]
        value = _sample_joint(model, joint, u)
        address = model.jnt_qposadr[joint]
        qpos[:, address : address + value.shape[1]] = value
    return qpos


def _sample_joint(model: Any, joint: int, u: Floats) -> Floats:
    kind, address = model.jnt_type[joint], model.jnt_qposadr[joint]
    is_limited, (low, high) = model.jnt_limited[joint], model.jnt_range[joint]
    extent = model.stat.extent
    if kind == FREE:
        start = model.qpos0[address : address + 3]
        position = start + extent * (2 * u[:, :3] - 1)
        return np.concatenate([position, _random_rotation(u[:, 3:])], axis=1)
    if kind == BALL:
        return _bounded_rotation(u, high) if is_limited else _random_rotation(u)
    if not is_limited:
        reach = np.pi if kind == HINGE else extent
        low, high = model.qpos0[address] - reach, model.qpos0[address] + reach
    return np.asarray(low + (high - low) * u)


def _random_rotation(u: Floats) -> Floats:
    """Quaternions (n, 4), uniform over the rotations, from (n, 3).

    Source:
        K. Shoemake, "Uniform random rotations", Graphics Gems III, 1992.
    """
    angle1, angle2 = 2 * np.pi * u[:, 1], 2 * np.pi * u[:, 2]
    r1, r2 = np.sqrt(1 - u[:, 0]), np.sqrt(u[:, 0])
    parts = r2 * np.cos(angle2), r1 * np.sin(angle1), r1 * np.cos(angle1)
    return np.stack([*parts, r2 * np.sin(angle2)], axis=1)


def _bounded_rotation(u: Floats, limit: float) -> Floats:
    """Quaternions (n, 4): a uniform axis, a uniform angle up to the limit."""
    half_angle, azimuth, z = limit * u[:, 0] / 2, 2 * np.pi * u[:, 1], 2 * u[:, 2] - 1
    r = np.sqrt(1 - z * z)
    axis = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)
    return np.concatenate(
        [np.cos(half_angle)[:, None], np.sin(half_angle)[:, None] * axis], axis=1
    )


def _open_array(path: Path) -> NDArray[Any]:
    check_is_file(path)
    try:
        return _mapped(path)
    except OSError as error:
        raise InputError(f"cannot read {shown(path)}: {error.strerror}") from None
    except Exception as error:
        # A header is an expression of Python: there is no end to what can be wrong.
        raise InputError(
            f"{shown(path)} is not an .npy file of numbers: {error}"
        ) from None


def _mapped(path: Path) -> NDArray[Any]:
    """The array, not read: the file may be larger than memory."""
    with path.open("rb") as file:
        if file.read(len(_ARCHIVE)) == _ARCHIVE:
            raise ValueError("it is an archive of arrays")
    # NumPy's remarks on old and odd headers are no part of the report.
    with warnings.catch_warnings(action="ignore"):
        return np.lib.format.open_memmap(path, mode="r")


def _check_finite(path: Path, rows: NDArray[Any], step: int = 10_000) -> None:
    for start in range(0, len(rows), step):
        ok = np.isfinite(rows[start : start + step]).all(axis=1)
        if not ok.all():
            row = start + int(np.argmin(ok))
            raise InputError(f"{shown(path)}: row {row} is not finite")
