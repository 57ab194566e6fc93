"""The boxes and ellipsoids of chosen pairs, at the poses of some state."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbe.mjx.pairs import Pairs
from jaxbe.shapes import Box, Ellipsoid


def gather(pairs: Pairs, model: Any, data: Any) -> tuple[Box, Ellipsoid]:
    """Gathers the bodies of each pair, in metres and the world frame.

    Values are not read, so NaN poses pass: works under `jit`, `vmap` and `grad`.

    Args:
        pairs: from `find_pairs`, of the same model.
        model: has `geom_size` (..., ngeom, 3), MuJoCo's half extents of boxes and
            semi-axes of ellipsoids: a `mujoco.MjModel`, an `mjx.Model` or a Brax
            system, also with batch axes (domain randomisation).
        data: has `geom_xpos` (..., ngeom, 3) and `geom_xmat` (..., ngeom, 3, 3)
            or (..., ngeom, 9): an `mjx.Data`, a `mujoco.MjData`, a Brax pipeline
            state of the MJX backend, also with batch axes.

    Returns:
        A box and an ellipsoid with batch axes (..., P), all of the dtype of the
        poses. The lengths keep the batch axes of `geom_size`, which broadcast.

    Raises:
        TypeError: poses that are not float32 or float64.
        ValueError: shapes that do not fit together, or pairs of a larger model.
    """
    position = jnp.asarray(data.geom_xpos)
    axes = jnp.asarray(data.geom_xmat).reshape(*position.shape[:-1], 3, 3)
    size = jnp.asarray(model.geom_size, position.dtype)
    _check_same_model(pairs, position, size)
    ellipsoid, box = pairs.geom[:, 0], pairs.geom[:, 1]
    return (
        Box.unchecked(position[..., box, :], axes[..., box, :, :], size[..., box, :]),
        Ellipsoid.unchecked(
            position[..., ellipsoid, :],
            axes[..., ellipsoid, :, :],
            size[..., ellipsoid, :],
        ),
    )


def _check_same_model(pairs: Pairs, position: jax.Array, size: jax.Array) -> None:
    """JAX would clamp an index that is out of range and answer for another geom."""
    if position.shape[-2] != size.shape[-2]:
        raise ValueError(
            f"model and data must have the same geoms, got {size.shape[-2]} in "
            f"geom_size and {position.shape[-2]} in geom_xpos"
        )
    if len(pairs) and pairs.geom.max() >= size.shape[-2]:
        raise ValueError(
            f"pairs name geom {pairs.geom.max()}, the model has {size.shape[-2]} "
            "geoms: find them in this model"
        )
