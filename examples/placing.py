"""python examples/1_push_out.py  # or 2 to 5: this file is imported, not run.

What the examples of placement share: poses as variables, proofs for what `jaxbe` does
not answer (ellipsoid against ellipsoid, ellipsoid in a container), and films.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

import jaxbe

PROVED = 1e-12
"""By how much of its terms a sum in float64 must exceed zero to prove its sign."""


class Pose(NamedTuple):
    """Position (..., 3) in metres and quaternion (..., 4), wxyz, of ellipsoids."""

    position: jax.Array
    quaternion: jax.Array


def ellipsoid_at(pose: Pose, semi_axes: Any) -> jaxbe.Ellipsoid:
    """The ellipsoid with this pose; quaternions need not have length one."""
    return jaxbe.Ellipsoid.from_quaternion(
        *pose, jnp.broadcast_to(semi_axes, pose[0].shape)
    )


def boxes(*rows: tuple[float, ...]) -> jaxbe.Box:
    """Boxes (N,) of rows of centre, half extents and, in degrees, a turn about z."""
    table = np.array([(*row, 0.0)[:7] for row in rows], np.float32)
    half = np.deg2rad(table[:, 6]) / 2
    zero = np.zeros_like(half)
    wxyz = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
    return jaxbe.Box.from_quaternion(table[:, :3], wxyz, table[:, 3:6])


def against(ellipsoid: jaxbe.Ellipsoid) -> jaxbe.Ellipsoid:
    """Ellipsoids (...,) as (..., 1): each against all of the boxes (N,)."""
    center, axes, lengths = ellipsoid.fields().values()
    return jaxbe.Ellipsoid.unchecked(
        center[..., None, :], axes[..., None, :, :], lengths[..., None, :]
    )


@jax.jit
def all_separated(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """Whether each ellipsoid (...,) is proved apart from all of the boxes (N,)."""
    return jnp.all(jaxbe.certify(box, against(ellipsoid)).verdict == -1, axis=-1)


def film(
    file: Path, figure: Any, draw: Callable[[Any], Any], frames: Iterable[Any], fps: int
) -> None:
    """Writes a GIF: `draw` changes the figure for each of the frames."""
    from matplotlib.animation import PillowWriter

    writer = PillowWriter(fps=fps)
    with writer.saving(figure, str(file), dpi=figure.dpi):
        for frame in track(list(frames), description="film"):
            draw(frame)
            writer.grab_frame()
