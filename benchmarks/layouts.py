"""A function of pairs in the two layouts that users have.

By vmap: arrays (N, 3) and (N, 3, 3), a pair's numbers side by side. By components:
arrays (3, N) and (3, 3, N), turned inside jit, which costs nothing: each number of all
pairs is contiguous in memory.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import scenes

LAYOUTS = ("components", "vmap")


@functools.cache
def by_vmap(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one pair, jitted, for bodies with a leading axis."""
    return jax.jit(jax.vmap(function))


@functools.cache
def by_components(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same for six arrays with the batch in the last axis; results likewise."""

    def turned(*arrays: jax.Array) -> Any:
        batch_first = [jnp.moveaxis(x, -1, 0) for x in arrays]
        box = jaxbe.Box.unchecked(*batch_first[:3])
        ellipsoid = jaxbe.Ellipsoid.unchecked(*batch_first[3:])
        results = jax.vmap(function)(box, ellipsoid)
        return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), results)

    return jax.jit(turned)


def component_arrays(pairs: scenes.Scene) -> tuple[jax.Array, ...]:
    """The pairs with the batch in the last axis, in their dtype."""
    return tuple(
        jnp.asarray(np.ascontiguousarray(np.moveaxis(x, 0, -1))) for x in pairs
    )


def programs(
    function: Callable[..., Any], pairs: scenes.Scene
) -> dict[str, tuple[Callable[..., Any], tuple[Any, ...]]]:
    """The function and its arguments, by layout."""
    return {
        "components": (by_components(function), component_arrays(pairs)),
        "vmap": (by_vmap(function), pairs.bodies()),
    }
