"""The margin's programs: few loops, and none too large to compile well."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from jaxbe import _xla
from jaxbe.growth import MAX_STEPS
from tests import programs

LARGEST = 3000
"""Operations in a loop: beyond, XLA's CPU backend runs a thousand times slower."""

AT_ONCE = _xla.GROWTH_LIMIT.at_once
COUNTS = (0, 3, AT_ONCE, AT_ONCE + 1, MAX_STEPS)
FIELDS = [
    (body, field)
    for body, kind in enumerate((jaxbe.Box, jaxbe.Ellipsoid))
    for field in kind.__dataclass_fields__
]

pytestmark = pytest.mark.skipif(
    jax.default_backend() != "cpu", reason="other backends fuse in other ways"
)


@pytest.fixture
def bodies(dtype):
    return scenes.random(10_000).astype(dtype).bodies()


@pytest.mark.bulk
@pytest.mark.parametrize("steps", COUNTS)
def test_margin_is_one_loop_or_two(bodies, steps):
    function = jax.vmap(functools.partial(jaxbe.margin, steps=steps))
    assert programs.fusions(function, *bodies) == 1 + (steps > AT_ONCE)
    assert programs.largest_expression(function, *bodies) <= LARGEST


@pytest.mark.bulk
@pytest.mark.parametrize("steps", COUNTS)
def test_both_bounds_come_from_one_loop_or_two(bodies, steps):
    """And two small ones that take them apart."""
    function = jax.vmap(functools.partial(jaxbe.margin_bounds, steps=steps))
    assert programs.fusions(function, *bodies) <= 3 + 2 * (steps > AT_ONCE)
    assert programs.largest_expression(function, *bodies) <= LARGEST


@pytest.mark.parametrize("query", [jaxbe.margin, jaxbe.scaled_distance])
def test_all_gradients_take_few_loops(bodies, query):
    """One for the value, four for the contact, the rest for what is returned.

    15 with jax 0.9.2, 17 with 0.10.2; left to itself XLA makes 50.
    """
    function = jax.vmap(jax.value_and_grad(query, argnums=(0, 1)))
    assert programs.fusions(function, *bodies) <= 17
    assert programs.largest_expression(function, *bodies) <= LARGEST


@pytest.mark.parametrize(("body", "field"), FIELDS)
def test_gradient_in_one_field_takes_eight_loops(bodies, body, field):
    def value(x, pair):
        changed = type(pair[body]).unchecked(
            *(pair[body].fields() | {field: x}).values()
        )
        return jaxbe.margin(*(changed if i == body else pair[i] for i in range(2)))

    function = jax.vmap(jax.value_and_grad(value))
    assert programs.fusions(function, getattr(bodies[body], field), bodies) <= 8


@pytest.mark.parametrize("query", [jaxbe.margin, jaxbe.scaled_distance])
@pytest.mark.parametrize(("body", "field"), FIELDS)
def test_the_rest_may_be_constants_of_the_program(query, body, field):
    """Where what is kept hung on a constant, 60 loops took 10,000 times as long."""
    pair = scenes.random(1000).astype(np.float32).bodies()

    def value(x):
        changed = type(pair[body]).unchecked(
            *(pair[body].fields() | {field: x}).values()
        )
        return query(*(changed if i == body else pair[i] for i in range(2))).sum()

    function = jax.grad(value)
    assert programs.fusions(function, getattr(pair[body], field)) <= 10


def test_sizes_may_be_constants_where_bodies_turn_by_quaternions():
    box, _ = scenes.random(5).astype(np.float32).bodies()
    position, wxyz = np.ones((200, 1, 3), np.float32), np.ones((200, 1, 4), np.float32)
    sizes = np.broadcast_to(np.float32([0.35, 0.12, 0.08]), position.shape)

    def value(position, wxyz):
        fruit = jaxbe.Ellipsoid.from_quaternion(position, wxyz, jnp.asarray(sizes))
        return jaxbe.margin(box, fruit).sum()

    function = jax.grad(value, argnums=(0, 1))
    assert programs.fusions(function, position, wxyz) <= 45
    assert programs.largest_expression(function, position, wxyz) <= LARGEST
