"""The poses of a model's geoms in some state."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe.components import dot, matrix, split_matrix, split_vector, stack, vector
from jaxbe.shapes import rotation_matrix
from jaxbe.types import Matrices, Vectors
from jaxbe.validate import is_readable, owned


def geom_poses(model: Any, data: Any) -> tuple[Vectors, Matrices]:
    """The geoms' positions (..., ngeom, 3) and axes (..., ngeom, 3, 3), in columns.

    Args:
        model: as for `jaxbe.mjx.gather`.
        data: has `geom_xpos` and `geom_xmat`, or else Brax's `x`, the poses of all
            bodies but the world.
    """
    if not hasattr(data, "geom_xpos"):
        return _from_links(model, data.x)
    position, axes = owned(data.geom_xpos), owned(data.geom_xmat)
    return position, axes.reshape(*position.shape[:-1], 3, 3)


def check_computed(data: Any) -> None:
    """No rotation is zero: that is memory which was never written to.

    Of it NaN would come, which is not below zero, so that nothing ever touched. Poses
    that are traced pass unread.

    Raises:
        ValueError: the poses of one of the states, or of the only one, are all zero.
    """
    if hasattr(data, "geom_xpos"):
        position, rotation = data.geom_xpos, data.geom_xmat
    else:
        position, rotation = data.x.pos, data.x.rot
    if not is_readable(rotation):
        return
    axes = tuple(range(np.ndim(position) - 2, np.ndim(rotation)))
    # Where they are: one flag is fetched.
    with jax.ensure_compile_time_eval():
        is_missing = bool((rotation == 0).all(axis=axes).any())
    if np.size(rotation) and is_missing:
        raise ValueError(
            "data: its geoms' poses were never computed: call "
            "mujoco.mj_forward(model, data) or mjx.kinematics(model, data) first"
        )


def _from_links(model: Any, x: Any) -> tuple[Vectors, Matrices]:
    """Body frame times geom frame, written out: no matrix unit of lower precision."""
    rank = x.pos.ndim - 1
    position = _of_bodies(x.pos, [0, 0, 0])[..., model.geom_bodyid, :]
    wxyz = _of_bodies(x.rot, [1, 0, 0, 0])[..., model.geom_bodyid, :]
    dtype = position.dtype
    body = split_matrix(rotation_matrix(wxyz), rank)
    geom = split_matrix(rotation_matrix(jnp.asarray(model.geom_quat, dtype)), rank)
    offset = split_vector(jnp.asarray(model.geom_pos, dtype), rank)
    axes = matrix(lambda i, j: dot(body[i], vector(lambda l: geom[l][j])))
    moved = stack(vector(lambda i: position[..., i] + dot(body[i], offset)))
    return moved, jnp.stack([stack(row) for row in axes], axis=-2)


def _of_bodies(links: jax.Array, world: list[int]) -> jax.Array:
    """The world's own entry before those of the links."""
    shape = (*links.shape[:-2], 1, links.shape[-1])
    first = jnp.broadcast_to(jnp.asarray(world, links.dtype), shape)
    return jnp.concatenate([first, links], axis=-2)
