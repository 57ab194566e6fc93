"""Inputs in bfloat16: float32 bodies of the very same numbers, with right verdicts."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from tests import oracle, truth


def narrow(n, seed=0, **options):
    scene = scenes.random(n, seed, **options)
    return scenes.Scene(*(jnp.asarray(x, jnp.bfloat16) for x in scene))


def bodies(scene):
    return jaxbe.Box(*scene[:3]), jaxbe.Ellipsoid(*scene[3:])


def read(pair):
    return scenes.Scene(*(np.asarray(x) for b in pair for x in b.fields().values()))


@pytest.mark.parametrize("low", [0.05, 0.002])
def test_verdicts_are_right_for_the_numbers_given(low):
    given = narrow(1000, low=low)
    pair = bodies(given)
    scene = read(pair)
    assert {x.dtype for x in scene} == {np.dtype("float32")}
    for name in ("C", "e", "K", "a"):
        exact = np.asarray(getattr(given, name)).astype(np.float32)
        np.testing.assert_array_equal(getattr(scene, name), exact)
    verdict = truth.overlaps(scene)
    for method in jaxbe.METHODS:
        found = jax.jit(functools.partial(jaxbe.overlap, method=method))(*pair)
        assert truth.worst_wrong(scene, verdict, found) <= 1e-4
    distance = jax.jit(jaxbe.scaled_distance)(*pair)
    assert distance.dtype == np.float32
    q = [oracle.squared_distance(truth.exact(scene, i)) for i in range(20)]
    np.testing.assert_allclose(distance[:20], np.sqrt(np.array(q, float)), rtol=1e-4)


def test_axes_are_the_nearest_orthonormal_ones():
    given = narrow(500)
    box = jaxbe.Box(*given[:3])
    U = np.asarray(given.U).astype(np.float64)
    left, _, right = np.linalg.svd(U)
    np.testing.assert_allclose(box.axes, left @ right, atol=1e-6)
    gram = np.einsum("nri,nrj->nij", box.axes, box.axes)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-6)


def test_under_jit_and_grad():
    given = narrow(50)

    def gap(C):
        pair = jaxbe.Box(C, *given[1:3]), jaxbe.Ellipsoid(*given[3:])
        return jaxbe.margin(*pair).sum()

    gradient = jax.jit(jax.grad(gap))(given.C)
    assert gradient.dtype == jnp.bfloat16
    assert np.all(np.isfinite(gradient.astype(np.float32)))


def test_quaternions_and_lists():
    wxyz = jnp.asarray([0.9, 0.1, 0.3, 0.2], jnp.bfloat16)
    body = jaxbe.Ellipsoid.from_quaternion(jnp.zeros(3, jnp.bfloat16), wxyz, [1, 2, 3])
    same = jaxbe.Ellipsoid.from_quaternion(
        np.zeros(3, "f4"), wxyz.astype("f4"), [1, 2, 3]
    )
    np.testing.assert_array_equal(body.axes, same.axes)
    assert body.semi_axes.dtype == np.float32


@pytest.mark.parametrize("kind", [jaxbe.Box, jaxbe.Ellipsoid])
def test_what_is_no_rotation_is_refused(kind):
    ones = jnp.ones(3, jnp.bfloat16)
    with pytest.raises(ValueError, match="axes must be orthonormal"):
        kind(ones, 1.05 * jnp.eye(3, dtype=jnp.bfloat16), ones)
    with pytest.raises(ValueError, match=r"axes must have shape .* got \(4, 4\)"):
        kind(ones, jnp.eye(4, dtype=jnp.bfloat16), ones)


def test_bodies_cast_afterwards_are_refused():
    pair = jax.tree.map(lambda x: x.astype(jnp.bfloat16), bodies(narrow(3)))
    with pytest.raises(TypeError, match="must be float32 or float64, got bfloat16"):
        jaxbe.overlap(*pair)


def test_no_mixture_with_float64():
    ones = jnp.ones(3, jnp.bfloat16)
    with pytest.raises(TypeError, match="one dtype"):
        jaxbe.Box(ones, np.eye(3, dtype=np.float64), ones)
