"""Vectors and matrices as tuples of arrays, one array a component.

The kernels compute on components, not on arrays of vectors: a whole test is then one
elementwise expression, no 3x3 product is left to a matrix unit of lower precision, and
stacked intermediates never reach memory.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax

from jaxbe.choice import choose, maximum, minimum
from jaxbe.types import (
    ComponentMatrix,
    Components,
    Flags,
    Matrices,
    Scalars,
    Vectors,
)


def vector(entry: Callable[[int], Scalars]) -> Components:
    """The vector with the components entry(0), entry(1), entry(2)."""
    return entry(0), entry(1), entry(2)


def matrix(entry: Callable[[int, int], Scalars]) -> ComponentMatrix:
    """The matrix with the components entry(row, column)."""
    return (
        vector(lambda j: entry(0, j)),
        vector(lambda j: entry(1, j)),
        vector(lambda j: entry(2, j)),
    )


def split_vector(x: Vectors, rank: int) -> Components:
    """The components of an array (..., 3), with `rank` batch axes each."""
    x = with_rank(x, rank + 1)
    return vector(lambda i: x[..., i])


def split_matrix(x: Matrices, rank: int) -> ComponentMatrix:
    """The components of an array (..., 3, 3), with `rank` batch axes each."""
    x = with_rank(x, rank + 2)
    return matrix(lambda i, j: x[..., i, j])


def stack(x: Components) -> Vectors:
    """The array (..., 3) with these components."""
    return jnp.stack(jnp.broadcast_arrays(*x), axis=-1)


def dot(x: Components, y: Components) -> Scalars:
    """The scalar product."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def column(m: ComponentMatrix, j: int) -> Components:
    """Column j of a matrix."""
    return vector(lambda i: m[i][j])


def largest(x: Components) -> Scalars:
    """The largest component; NaN if one is NaN."""
    return maximum(maximum(x[0], x[1]), x[2])


def smallest(x: Components) -> Scalars:
    """The smallest component; NaN if one is NaN."""
    return minimum(minimum(x[0], x[1]), x[2])


def is_zero(x: Components) -> Flags:
    """Whether all components are zero."""
    return (x[0] == 0) & (x[1] == 0) & (x[2] == 0)


def times(m: ComponentMatrix, x: Components) -> Components:
    """The product of a matrix and a vector."""
    return vector(lambda i: dot(m[i], x))


def where(condition: Flags, x: Components, y: Components) -> Components:
    """Componentwise `choose`."""
    return vector(lambda i: choose(condition, x[i], y[i]))


def clip(x: Scalars | float, low: Scalars, high: Scalars) -> Scalars:
    """Restricts x to [low, high]; NaN stays NaN."""
    return maximum(low, minimum(x, high))


def with_rank(x: jax.Array, rank: int) -> jax.Array:
    """Adds leading axes of length one, up to so many axes."""
    return lax.expand_dims(x, range(rank - x.ndim))
