"""From which distance on MuJoCo makes contacts."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbe.mjx.given import check_model
from jaxbe.mjx.pairs import Ids, Pairs
from jaxbe.types import ArrayLike


def contact_distance(pairs: Pairs, model: Any) -> jax.Array:
    """Margin plus gap of each pair, (..., P) metres.

    MuJoCo C detects contacts nearer than this, of which those nearer than the margin
    act; MJX makes all, and lets the latter act. Before 3.5.0 the larger of two geoms'
    margins counted, not their sum, and before 3.9.0 the gap was part of the margin:
    this is more, then. Where the model overrides contacts its own margin is taken for
    every pair's, beside the pair's gap.

    Raises:
        TypeError: a model without margins.
        ValueError: `<pair>` elements that the model has not.
    """
    check_model(model, "geom_margin", "geom_gap")
    of_geom = _of_geoms(pairs, model)
    if not len(pairs.explicit):
        return of_geom
    row, element = pairs.explicit.T
    of_pair = _of_elements(model, element)
    # An element twice in the model makes two contacts: the larger margin counts.
    return of_geom.at[..., row].set(-jnp.inf).at[..., row].max(of_pair)


def _of_geoms(pairs: Pairs, model: Any) -> jax.Array:
    """By the two geoms alone, (..., P)."""
    margin, gap = (
        x[..., pairs.geom[:, 0]] + x[..., pairs.geom[:, 1]]
        for x in (_from_zero(model.geom_margin), _from_zero(model.geom_gap))
    )
    return _overridden(margin, model) + gap


def _of_elements(model: Any, element: Ids) -> jax.Array:
    """By `<pair>` elements (n,), which overrule their geoms: (..., n)."""
    check_model(model, "pair_margin", "pair_gap")
    count = model.pair_margin.shape[-1]
    if element.max() >= count:
        raise ValueError(
            f"pairs name the model's <pair> element {element.max()}, the model has "
            f"{count} of them: find the pairs in this model"
        )
    margin, gap = _from_zero(model.pair_margin), _from_zero(model.pair_gap)
    return _overridden(margin[..., element], model) + gap[..., element]


def _overridden(margin: jax.Array, model: Any) -> jax.Array:
    """The margins, or that of a model which overrides them all."""
    # Where there is a model there is MuJoCo.
    import mujoco

    option = getattr(model, "opt", None)
    bit = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
    if option is None or not int(option.enableflags) & bit:
        return margin
    return jnp.full_like(margin, _from_zero(option.o_margin))


def _from_zero(length: ArrayLike) -> jax.Array:
    """Not below zero, where MuJoCo's contacts begin at the latest.

    And the sum of two margins is not less than the larger one.
    """
    return jnp.maximum(jnp.asarray(length), 0)
