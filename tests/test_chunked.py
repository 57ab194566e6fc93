"""Batches that stay on the host, computed chunk by chunk."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes

LENGTHS = (0.1, 1.0)

VECTOR = (3,)


def pairs(rng, box_batch, ellipsoid_batch, dtype):
    """Bodies in NumPy arrays, the ellipsoids near the boxes, a fair share in touch."""
    return (
        jaxbe.Box.on_host(*fields(rng, box_batch, dtype)),
        jaxbe.Ellipsoid.on_host(*fields(rng, ellipsoid_batch, dtype)),
    )


def fields(rng, batch, dtype):
    body = jaxbe.Box.from_quaternion(
        rng.uniform(-1, 1, (*batch, 3)).astype(dtype),
        rng.normal(size=(*batch, 4)).astype(dtype),
        rng.uniform(*LENGTHS, (*batch, 3)).astype(dtype),
    )
    return [np.array(x) for x in jax.tree.leaves(body)]


def rng(seed=0):
    return np.random.default_rng(seed)


def check_same(found, expected, *, exact):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    leaves = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    for x, y in leaves:
        assert type(x) is np.ndarray
        assert (x.shape, x.dtype) == (y.shape, y.dtype)
        if exact:
            np.testing.assert_array_equal(x, y)
        else:
            scale = float(np.max(np.abs(np.asarray(y)), initial=1))
            atol = 100 * float(np.finfo(y.dtype).eps) * scale
            np.testing.assert_allclose(x, y, rtol=0, atol=atol)
