"""The distance's programs: branch-free, and no loop too large to compile well."""

import functools

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from jaxbe import Box, Ellipsoid
from jaxbe.distance import MAX_STEPS
from jaxbe.mjx.ellipsoid_box import STEPS
from tests import programs
from tests.test_margin_form import LARGEST

pytestmark = pytest.mark.bulk


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="fuses in other ways")
@pytest.mark.parametrize(
    "steps",
    [3, STEPS, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, MAX_STEPS))],
)
def test_no_loop_is_too_large(steps, dtype):
    """At the default count and that of MJX's contacts, which is the largest loop."""
    bodies = scenes.random(1000).astype(dtype).bodies()
    function = jax.vmap(functools.partial(jaxbe.contact, steps=steps))
    assert programs.largest_expression(function, *bodies) <= LARGEST


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="fuses in other ways")
@pytest.mark.parametrize("batch", ["broadcast", "vmap"])
def test_nor_where_poses_share_their_lengths(batch):
    """As `jaxbe.mjx.gather` gives them: one set of lengths for all states."""
    pairs = scenes.random(8 * 16).astype(np.float32)
    C, U, K, V = (x.reshape(8, 16, *x.shape[1:]) for x in (*pairs[:2], *pairs[3:5]))
    e, a = pairs.e[:16], pairs.a[:16]

    def distance(C, U, K, V):
        box, ellipsoid = Box.unchecked(C, U, e), Ellipsoid.unchecked(K, V, a)
        return jaxbe.signed_distance(box, ellipsoid)

    function = jax.vmap(distance) if batch == "vmap" else distance
    assert programs.largest_expression(function, C, U, K, V) <= LARGEST


@pytest.mark.parametrize("query", [jaxbe.contact, jaxbe.distance_bounds])
def test_branch_free(query):
    bodies = scenes.random(64).bodies()
    programs.check_branch_free(jax.vmap(query), *bodies)


def test_gradient_is_branch_free():
    bodies = scenes.random(64).bodies()

    def total(box, ellipsoid):
        return jaxbe.signed_distance(box, ellipsoid).sum()

    programs.check_branch_free(jax.grad(total, argnums=(0, 1)), *bodies)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="keeps other arrays")
@pytest.mark.parametrize("name", ["contact", "distance_bounds"])
def test_few_arrays_beside_inputs_and_outputs(name):
    """In bytes a float32 pair; what loops share had taken 100 to 160."""
    bodies = scenes.random(1000).astype(np.float32).bodies()
    compiled = jax.jit(jax.vmap(getattr(jaxbe, name))).lower(*bodies).compile()
    assert compiled.memory_analysis().temp_size_in_bytes / 1000 < 50
