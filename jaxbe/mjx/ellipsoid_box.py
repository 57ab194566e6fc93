"""The collision function of an ellipsoid and a box, as MJX's driver calls it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbe.contact import contact
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Matrices, Scalars, Vectors

STEPS = 4
"""Of `jaxbe.contact`: one more than by default, for bodies that overlap deeply."""

Collision = tuple[Scalars, Vectors, Matrices]
"""Distance, position and frame, as in MJX's `collision_types`."""


def ellipsoid_box(model: Any, data: Any, key: Any, geom: jax.Array) -> Collision:
    """One contact a pair, apart or not: the driver itself drops those apart.

    Args:
        model: has `geom_size` (ngeom, 3).
        data: has `geom_xpos` (ngeom, 3) and `geom_xmat` (ngeom, 3, 3).
        key: how the driver groups pairs; not used.
        geom: (P, 2) geom ids, [ellipsoid, box].

    Returns:
        The distance (P,) in metres, negative when they overlap; the position (P, 3),
        half way between the witness points; and the frame (P, 3, 3), in its rows the
        unit normal from the ellipsoid to the box and the two directions with which
        MJX makes any normal a right-handed frame. Of the dtype of the poses. Accuracy,
        derivatives and NaN as of `jaxbe.contact`.
    """
    del key
    position = data.geom_xpos
    size = jnp.asarray(model.geom_size, position.dtype)
    found: Collision = _collide(position, data.geom_xmat, size, geom)
    return found


ellipsoid_box.ncon = 1  # type: ignore[attr-defined]


# One compiled program where MJX is called without `jit`.
@jax.jit
def _collide(
    position: Vectors, axes: Matrices, size: Vectors, geom: jax.Array
) -> Collision:
    ellipsoid, box = geom[:, 0], geom[:, 1]
    touch = contact(
        Box.unchecked(position[box], axes[box], size[box]),
        Ellipsoid.unchecked(position[ellipsoid], axes[ellipsoid], size[ellipsoid]),
        steps=STEPS,
    )
    return touch.distance, touch.position, _frames(touch.normal)


def _frames(normals: Vectors) -> Matrices:
    """The frames that MJX makes of unit normals."""
    from mujoco.mjx._src.math import make_frame

    # MJX promotes dtypes, also where the user's settings forbid it.
    with jax.numpy_dtype_promotion("standard"):
        frames: Matrices = jax.vmap(make_frame)(normals)
    return frames
