"""The boxes and ellipsoids of chosen pairs, at the poses of some state."""

from __future__ import annotations

from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe.components import with_rank
from jaxbe.mjx.given import check_given
from jaxbe.mjx.poses import check_computed, geom_poses
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.validate import owned


class HasGeoms(Protocol):
    """Pairs, or candidates: `geom` (..., 2) holds geom ids, [ellipsoid, box]."""

    @property
    def geom(self) -> Any: ...


def gather(pairs: HasGeoms, model: Any, data: Any) -> tuple[Box, Ellipsoid]:
    """Gathers the bodies of each pair, in metres and the world frame.

    NaN poses pass, and it works under `jit`, `vmap` and `grad`. Poses at hand that were
    never computed are refused; traced ones give NaN. So ask `~(margin >= 0)` whether
    bodies may touch, not `margin < 0`, which NaN is not.

    Args:
        pairs: from `find_pairs`, of the same model; or what `filter_contacts` left of
            them, for the same batch of states.
        model: has `geom_size` (..., ngeom, 3), MuJoCo's half extents of boxes and
            semi-axes of ellipsoids: a `mujoco.MjModel`, an `mjx.Model` or a Brax
            system, also with batch axes (domain randomisation).
        data: has `geom_xpos` (..., ngeom, 3) and `geom_xmat` (..., ngeom, 3, 3)
            or (..., ngeom, 9): an `mjx.Data`, a `mujoco.MjData`, a Brax pipeline
            state, also with batch axes. States of Brax's other pipelines have `x`
            instead, the poses of the bodies; the model's `geom_pos`, `geom_quat` and
            `geom_bodyid` are read then.

    Returns:
        A box and an ellipsoid with batch axes (..., P), all of the dtype of the
        poses. The lengths keep the batch axes of `geom_size`, which broadcast.

    Raises:
        TypeError: poses that are not float32 or float64; what is not a model, its data
            or pairs.
        ValueError: shapes that do not fit together; pairs of another model, as far as
            its number of geoms and their types tell; poses that were never computed.
    """
    check_given(pairs, model, data)
    geom = pairs.geom
    return bodies(geom[..., 0], geom[..., 1], model, data)


def bodies(ellipsoid: Any, box: Any, model: Any, data: Any) -> tuple[Box, Ellipsoid]:
    """The bodies of geom ids, arrays of any shape: static, or one a state of data."""
    position, axes = geom_poses(model, data)
    size = owned(model.geom_size, position.dtype)
    _check_same_model(position, size)
    check_computed(data)
    flat = axes.reshape(*axes.shape[:-2], 9)

    def fields(ids: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        turned = _rows(flat, ids)
        turned = turned.reshape(*turned.shape[:-1], 3, 3)
        return _rows(position, ids), turned, _rows(size, ids)

    return Box.unchecked(*fields(box)), Ellipsoid.unchecked(*fields(ellipsoid))


def _rows(x: jax.Array, ids: Any) -> jax.Array:
    """The rows (..., P, n) of x (..., ngeom, n) with these ids (..., P)."""
    if ids.ndim == 1 or isinstance(ids, np.ndarray):
        return x[..., ids, :]
    rank = max(ids.ndim + 1, x.ndim)
    return jnp.take_along_axis(with_rank(x, rank), with_rank(ids[..., None], rank), -2)


def _check_same_model(position: jax.Array, size: jax.Array) -> None:
    if position.shape[-2] != size.shape[-2]:
        raise ValueError(
            f"model and data must have the same geoms, got {size.shape[-2]} in "
            f"geom_size and {position.shape[-2]} in geom_xpos"
        )
