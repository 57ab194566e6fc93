"""Under `jax_debug_nans` and `jax_debug_infs`, run eagerly, legal pairs raise nothing.

There each operation is checked by itself, also those whose results are not chosen.
"""

import contextlib
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes

EYE = np.eye(3)
PAIRS = {
    "aligned": ([0, 0, 0], [1, 1, 1], [3, 0, 0], [0.3, 0.2, 0.1]),
    "inside": ([0, 0, 0], [1, 1, 1], [0.1, 0.2, 0.05], [0.3, 0.3, 0.3]),
    "coincident": ([0, 0, 0], [1, 1, 1], [0, 0, 0], [0.3, 0.2, 0.1]),
    "vertex": ([0, 0, 0], [1, 1, 1], [2, 2, 2], [0.5, 0.5, 0.5]),
    "touching": ([0, 0, 0], [1, 1, 1], [1.5, 0, 0], [0.5, 0.5, 0.5]),
    "point": ([0, 0, 0], [0, 0, 0], [2, 2, 0], [0.5, 0.5, 0.5]),
    "plate": ([0, 0, 0], [1, 1, 0], [0.5, 0.2, 0.1], [0.5, 0.4, 0.3]),
    "far": ([0, 0, 0], [1, 1, 1], [1e4, 2, 0], [0.5, 0.2, 0.1]),
}


def bodies(dtype):
    """Special pairs and random ones, in one batch."""
    special = [
        np.array([(x[0], x[1], x[2], x[3])[i] for x in PAIRS.values()], float)
        for i in range(4)
    ]
    random = scenes.random(200, seed=3)
    axes = np.broadcast_to(EYE, (len(PAIRS), 3, 3))
    given = (special[0], axes, special[1], special[2], axes, special[3])
    both = (np.concatenate(x) for x in zip(given, random, strict=True))
    return scenes.Scene(*both).astype(dtype).bodies()


@contextlib.contextmanager
def flag(name):
    jax.config.update(name, True)
    try:
        yield
    finally:
        jax.config.update(name, False)


def second_derivative(function, box, ellipsoid):
    """Of the sum, along one direction in the box's centres."""

    def value(center):
        moved = jaxbe.Box.unchecked(center, box.axes, box.half_extents)
        return function(moved, ellipsoid).sum()

    ones = jnp.ones_like(box.center)
    return jax.jvp(jax.grad(value), (box.center,), (ones,))


signed_distance = functools.partial(jaxbe.signed_distance, steps=1)
FUNCTIONS = {
    **{m: functools.partial(jaxbe.overlap, method=m) for m in jaxbe.METHODS},
    "scaled_distance": jaxbe.scaled_distance,
    "margin": jaxbe.margin,
    "margin_bounds": jaxbe.margin_bounds,
    "certify": jaxbe.certify,
    "contact": functools.partial(jaxbe.contact, steps=1),
    "distance_bounds": functools.partial(jaxbe.distance_bounds, steps=1),
    "Hessian of margin": functools.partial(second_derivative, jaxbe.margin),
    "Hessian of signed_distance": functools.partial(second_derivative, signed_distance),
}


@pytest.mark.parametrize("checked", ["jax_debug_nans", "jax_debug_infs"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_not_chosen_is_finite_too(name, checked):
    pairs = bodies(np.float32)
    with flag(checked):
        jax.block_until_ready(FUNCTIONS[name](*pairs))
