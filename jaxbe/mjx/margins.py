"""From which distance on MuJoCo makes contacts."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe.mjx.pairs import Pairs
from jaxbe.types import ArrayLike


def contact_distance(pairs: Pairs, model: Any) -> jax.Array:
    """Margin plus gap of each pair, (..., P) metres.

    MuJoCo C detects contacts nearer than this, of which those nearer than the margin
    act; MJX makes all, and lets the latter act. Before 3.13 the larger of two margins
    counted, not their sum, and the gap was part of the margin: this is more, then.
    Where the model overrides contacts, its own margin is taken if it is larger.
    """
    return jnp.maximum(_of_model(model), _of_pairs(pairs, model))


def _of_model(model: Any) -> ArrayLike:
    """The margin that overrides all others; minus infinity if none does."""
    # Where there is a model there is MuJoCo.
    import mujoco

    option = getattr(model, "opt", None)
    bit = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
    if option is None or not int(option.enableflags) & bit:
        return -np.inf
    return option.o_margin


def _of_pairs(pairs: Pairs, model: Any) -> jax.Array:
    of_geom = _reach(model.geom_margin, model.geom_gap)
    bound = of_geom[..., pairs.geom[:, 0]] + of_geom[..., pairs.geom[:, 1]]
    if not len(pairs.explicit):
        return bound
    row, element = pairs.explicit.T
    of_pair = _reach(model.pair_margin, model.pair_gap)[..., element]
    # An element twice in the model makes two contacts: the larger margin counts.
    return bound.at[..., row].set(-jnp.inf).at[..., row].max(of_pair)


def _reach(margin: ArrayLike, gap: ArrayLike) -> jax.Array:
    """Neither below zero: then the sum of two is not less than the larger one."""
    return jnp.maximum(jnp.asarray(margin), 0) + jnp.maximum(jnp.asarray(gap), 0)
