"""The static facts of a model's pairs, for `jaxbe.plan`."""

from __future__ import annotations

from typing import Any

from jaxbe.mjx.given import check_pairs
from jaxbe.mjx.pairs import Pairs
from jaxbe.scene_facts import SceneFacts, facts_of_lengths


def scene_facts(pairs: Pairs, model: Any) -> SceneFacts:
    """The facts of the pairs that may collide.

    Args:
        pairs: from `find_pairs`, of the same model.
        model: has `geom_size` (..., ngeom, 3), known when this is called: a
            `mujoco.MjModel`, an `mjx.Model` or a Brax system, also with batch axes.

    Raises:
        TypeError: sizes that are traced, or what is not a model or its pairs.
        ValueError: no pair, sizes that are not positive, or pairs of another model.
    """
    check_pairs(pairs, model)
    if not len(pairs):
        raise ValueError("the model has no pair of an ellipsoid and a box")
    size = model.geom_size
    return facts_of_lengths(
        size[..., pairs.geom[:, 1], :], size[..., pairs.geom[:, 0], :]
    )
