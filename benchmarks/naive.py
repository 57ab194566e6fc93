"""What a competent user writes in JAX without the theory: try all 27 active sets.

The yardstick of `benchmarks.throughput`. For one pair, meant for `jax.vmap`: matrix
products, closed forms for the free coordinates (one division or Cramer's rule),
a mask for those outside the box, the smallest value. Of five such versions tried
on a CPU this one was the fastest.
"""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp

import jaxbe

ACTIVE_SETS = tuple(itertools.product((-1, 0, 1), repeat=3))


def overlap(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """Whether one box and one ellipsoid, without batch axes, overlap."""
    k = box.axes.T @ (ellipsoid.center - box.center)
    R = box.axes.T @ ellipsoid.axes
    N = (R / (ellipsoid.semi_axes**2)[None, :]) @ R.T
    values = (value(sigma, k, box.half_extents, N) for sigma in ACTIVE_SETS)
    return functools.reduce(jnp.minimum, values) <= 1


def value(
    sigma: tuple[int, ...], k: jax.Array, e: jax.Array, N: jax.Array
) -> jax.Array:
    """The quadratic at the optimum of one active set; infinity if not in the box."""
    d = _optimum([s * e[i] - k[i] if s else None for i, s in enumerate(sigma)], N)
    q = sum(N[i, i] * d[i] * d[i] for i in range(3)) + 2 * (
        N[0, 1] * d[0] * d[1] + N[0, 2] * d[0] * d[2] + N[1, 2] * d[1] * d[2]
    )
    for i in range(3):
        if sigma[i] == 0:
            q = jnp.where(abs(k[i] + d[i]) <= e[i], q, jnp.inf)
    return q


def _optimum(d: list[jax.Array | None], N: jax.Array) -> list[jax.Array]:
    """Fills in the free coordinates (None) of the offset x - k."""
    free = [i for i in range(3) if d[i] is None]
    fixed = [i for i in range(3) if d[i] is not None]
    if len(free) == 1:
        (i,), (j, l) = free, fixed
        d[i] = -(N[i, j] * d[j] + N[i, l] * d[l]) / N[i, i]
    elif len(free) == 2:
        (i, j), (l,) = free, fixed
        determinant = N[i, i] * N[j, j] - N[i, j] ** 2
        d[i] = (N[i, j] * N[j, l] - N[j, j] * N[i, l]) / determinant * d[l]
        d[j] = (N[i, j] * N[i, l] - N[i, i] * N[j, l]) / determinant * d[l]
    elif len(free) == 3:
        d = [jnp.zeros_like(N[0, 0])] * 3
    return d
