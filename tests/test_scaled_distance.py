"""sqrt(q): values against the references, derivatives against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import reference, scenes
from tests import truth

distance = jax.jit(jaxbe.scaled_distance)


@jax.jit
def gradient(box, ellipsoid):
    def total(box, ellipsoid):
        return jaxbe.scaled_distance(box, ellipsoid).sum()

    return jax.grad(total, argnums=(0, 1))(box, ellipsoid)


TOLERANCES = {
    ("float64", 0.05): 1e-14,
    ("float64", 0.002): 1e-13,
    ("float32", 0.05): 1e-5,
    ("float32", 0.002): 1e-4,
}


@pytest.mark.parametrize("low", [0.05, 0.002])
def test_values(dtype, low):
    """The pairs that differ most from the float64 reference, judged exactly."""
    scene = scenes.random(100_000, seed=20, low=low).astype(dtype)
    found = np.asarray(distance(*scene.bodies()), np.float64)
    estimate = np.sqrt(reference.nearest_in(scene).q)
    error = abs(found - estimate) / np.maximum(1, estimate)
    for i in np.argsort(-error)[:30]:
        assert exact_error(scene, i, found[i]) <= TOLERANCES[dtype.name, low]


def exact_error(scene, i, found) -> float:
    """|found - sqrt(q)| relative to max(1, sqrt(q)), from the exact q."""
    q = truth.oracle.squared_distance(truth.exact(scene, i))
    difference = float(truth.oracle.Fraction(found) ** 2 - q)
    return abs(difference) / (found + float(q) ** 0.5) / max(1, float(q) ** 0.5)


def test_zero_inside_and_one_at_touching(dtype):
    box = jaxbe.Box(np.zeros(3, dtype), np.eye(3, dtype=dtype), np.ones(3, dtype))
    K = np.array([[0, 0, 0], [1, 1, 1], [0.5, -1, 0], [3, 0, 0], [5, 0, 0]], dtype)
    balls = jaxbe.Ellipsoid(K, np.eye(3, dtype=dtype), np.full(3, 2, dtype))
    np.testing.assert_array_equal(distance(box, balls), [0, 0, 0, 1, 2])


def exact_gradient_reference(scene):
    """Central differences of the enumeration, in all 30 numbers of each pair."""
    step = 1e-6
    slopes = []
    for position, field in enumerate(scene):
        slope = np.zeros_like(field)
        for index in np.ndindex(field.shape[1:]):
            values = []
            for sign in (1, -1):
                moved = field.copy()
                moved[(slice(None), *index)] += sign * step
                shifted = scene._replace(**{scene._fields[position]: moved})
                values.append(np.sqrt(reference.nearest_in(shifted).q))
            slope[(slice(None), *index)] = (values[0] - values[1]) / (2 * step)
        slopes.append(slope)
    return slopes


def test_gradient_against_differences():
    scene = scenes.random(2000, seed=22)
    found = jax.tree.leaves(gradient(*scene.bodies()))
    for x, y in zip(found, exact_gradient_reference(scene), strict=True):
        scale = 1 + np.max(abs(y).reshape(scene.size, -1), axis=1)
        error = np.max(abs(x - y).reshape(scene.size, -1), axis=1) / scale
        assert np.percentile(error, 99) < 1e-6


def test_gradient_in_float32():
    scene = scenes.random(2000, seed=23)
    expected = jax.tree.leaves(gradient(*scene.bodies()))
    found = jax.tree.leaves(gradient(*scene.astype(np.float32).bodies()))
    found = [x.astype(np.float64) for x in found]
    for x, y in zip(found, expected, strict=True):
        scale = 1 + np.max(abs(y).reshape(scene.size, -1), axis=1)
        error = np.max(abs(x - y).reshape(scene.size, -1), axis=1) / scale
        assert np.percentile(error, 99) < 1e-4


def test_forward_equals_reverse(dtype):
    scene = scenes.random(500, seed=24).astype(dtype)
    bodies = scene.bodies()
    rng = np.random.default_rng(25)
    tangents = jax.tree.map(
        lambda x: jnp.asarray(rng.normal(size=x.shape).astype(dtype)), bodies
    )
    _, forward = jax.jvp(distance, bodies, tangents)
    products = jax.tree.map(
        lambda g, t: jnp.sum((g * t).reshape(scene.size, -1), axis=1),
        gradient(*bodies),
        tangents,
    )
    reverse = sum(jax.tree.leaves(products))
    scale = 1 + sum(
        np.max(abs(x).reshape(scene.size, -1), axis=1)
        for x in jax.tree.leaves(gradient(*bodies))
    )
    assert np.max(abs(forward - reverse) / scale) < 100 * np.finfo(dtype).eps


@pytest.mark.parametrize(
    "kind",
    [
        scenes.spheres,
        scenes.axis_aligned,
        scenes.coincident,
        lambda s: scenes.flattened(s, 3),
        lambda s: scenes.coincident(scenes.flattened(scenes.axis_aligned(s), 2)),
    ],
    ids=["spheres", "axis-aligned", "coincident", "points", "coincident-rods"],
)
def test_gradient_is_finite(dtype, kind):
    scene = kind(scenes.random(2000, seed=26, low=0.002)).astype(dtype)
    for x in jax.tree.leaves(gradient(*scene.bodies())):
        assert np.all(np.isfinite(x))


def test_gradient_is_finite_where_an_outer_where_discards_the_pair(dtype):
    scene = scenes.coincident(scenes.random(10, seed=27)).astype(dtype)
    box, ellipsoid = scene.bodies()

    def loss(box):
        found = jaxbe.scaled_distance(box, ellipsoid)
        return jnp.where(found > 0, found, 0).sum()

    for x in jax.tree.leaves(jax.grad(loss)(box)):
        assert np.all(x == 0)


def test_zero_gradient_inside(dtype):
    """Constant there: sqrt(q) is flat as long as the centre is in the box."""
    scene = scenes.coincident(scenes.random(10, seed=28)).astype(dtype)
    for x in jax.tree.leaves(gradient(*scene.bodies())):
        assert np.all(x == 0)
