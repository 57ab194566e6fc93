"""python examples/3_second_order.py  # or 5: this file is imported, not run.

Gradients, Hessians and one line search for batches of small problems; Newton's step.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

LENGTHS = 2.0 ** -jnp.arange(12.0)
"""Of the steps tried, all at once: no loop in the search."""

FLATTEST = 1e-4
"""Curvatures below that, by the largest, are taken as that."""


class Objective:
    """A function of x (n,) and more, infinite where x is not allowed, for batches.

    Each of its derivatives is compiled once, for all descents.
    """

    def __init__(self, function: Callable[..., jax.Array]) -> None:
        self.gradient = jax.jit(jax.vmap(jax.grad(function)))
        self.hessian = jax.jit(jax.vmap(jax.jacfwd(jax.grad(function))))
        self._search = jax.jit(jax.vmap(functools.partial(_search, function)))

    def search(self, x: jax.Array, way: jax.Array, *more: Any) -> jax.Array:
        """The best of some points x + length * way, or x; all of shape (B, n)."""
        return self._search(x, way, *more)


def _search(function: Any, x: jax.Array, way: jax.Array, *more: Any) -> jax.Array:
    lengths = jnp.append(LENGTHS, 0).astype(x.dtype)
    tried = x + lengths[:, None] * way
    values = jax.vmap(lambda x: function(x, *more))(tried)
    return tried[jnp.argmin(jnp.where(jnp.isnan(values), jnp.inf, values))]


@jax.jit
@jax.vmap
def newton_way(gradient: jax.Array, hessian: jax.Array) -> jax.Array:
    """Newton's step (B, n); down also where the curvature is negative."""
    curvature, axes = jnp.linalg.eigh(hessian)
    size = jnp.abs(curvature)
    size = jnp.maximum(size, FLATTEST * size.max())
    return -axes @ ((axes.T @ gradient) / size)


def log_barrier(margins: jax.Array) -> jax.Array:
    """Minus the sum of their logarithms; infinite if one is not positive."""
    allowed = jnp.all(margins > 0)
    logs = jnp.log(jnp.where(margins > 0, margins, 1)).sum()
    return jnp.where(allowed, -logs, jnp.inf)


def turned(quaternion: jax.Array, r: jax.Array) -> jax.Array:
    """A quaternion (4,) turned by r (3,), small: by about |r| radians."""
    w, v = quaternion[0], quaternion[1:]
    half = r / 2
    scalar = w - half @ v
    return jnp.concatenate([scalar[None], v + w * half + jnp.cross(half, v)])
