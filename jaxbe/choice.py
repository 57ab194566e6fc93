"""Choosing between two numbers, also under `vmap` over an explicit axis of a mesh.

An axis that is part of the arrays' types (those of `jax.make_mesh` are, by default) is
one that constants do not have, and JAX refuses to choose between two of them by a
condition that has it; the derivatives of its maximum and minimum do that. There the
constants are multiplied by a one that has the axis, at no cost; everywhere else
these are JAX's own functions.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import AxisType

from jaxbe.types import Flags, Scalars

Numbers = Scalars | np.ndarray | float


def choose(condition: Flags, x: Numbers, y: Numbers) -> Scalars:
    """`jnp.where`, also between two constants."""
    if _may_hide_an_axis(condition):
        one = condition | True
        chosen = jnp.where(condition, times_one(x, one), times_one(y, one))
        # Going backwards, it is this that may be a constant.
        return times_one(chosen, one)
    return jnp.where(condition, x, y)


def maximum(x: Numbers, y: Numbers) -> Scalars:
    """`jnp.maximum`, and its derivative."""
    return _extreme(jnp.maximum, x, y)


def minimum(x: Numbers, y: Numbers) -> Scalars:
    """`jnp.minimum`, and its derivative."""
    return _extreme(jnp.minimum, x, y)


def _extreme(function: Callable[..., Scalars], x: Numbers, y: Numbers) -> Scalars:
    if _may_hide_an_axis(x) or _may_hide_an_axis(y):
        dtype = jnp.result_type(x, y)
        both = (v.astype(dtype) for v in jnp.broadcast_arrays(x, y))
        return _extreme_of_scalars(function, *both)
    return function(x, y)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _extreme_of_scalars(
    function: Callable[..., Scalars], x: Scalars, y: Scalars
) -> Scalars:
    return function(x, y)


@_extreme_of_scalars.defjvp
def _extreme_of_scalars_jvp(
    function: Callable[..., Scalars], primals: Any, tangents: Any
) -> tuple[Scalars, Scalars]:
    """As JAX has it: where both are equal, half of each tangent."""
    x, y = primals
    value = _extreme_of_scalars(function, x, y)
    is_x, is_y = x == value, y == value
    of_x = choose(is_x, 1.0, 0.0) / choose(is_y, 2.0, 1.0)
    of_y = choose(is_y, 1.0, 0.0) / choose(is_x, 2.0, 1.0)
    return value, of_x * tangents[0] + of_y * tangents[1]


def has_explicit_axes(x: Numbers) -> bool:
    """Whether the mesh around has axes that are part of the arrays' types."""
    return AxisType.Explicit in jax.typeof(x).sharding.mesh.axis_types


def _may_hide_an_axis(x: Numbers) -> bool:
    """Whether an explicit axis may be mapped, and none is left that tells JAX of it."""
    return jnp.ndim(x) == 0 and has_explicit_axes(x)


def times_one(x: Numbers, one: Flags) -> Scalars:
    """Of x's own type, weak if it is."""
    return jnp.multiply(x, lax.convert_element_type(one, getattr(x, "dtype", type(x))))
