"""The programs: branch-free, one fusion, one compilation, batch = vmap = loop."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from tests import programs

QUERIES = {
    **{m: functools.partial(jaxbe.overlap, method=m) for m in jaxbe.METHODS},
    "scaled_distance": jaxbe.scaled_distance,
}


@pytest.fixture(params=QUERIES)
def query(request):
    return QUERIES[request.param]


def test_the_reader_of_programs_sees_branches():
    """Or else the next tests would pass for nothing."""

    def branches(x):
        return jax.vmap(lambda y: jax.lax.cond(True, jnp.sin, jnp.cos, y))(x)

    def loops(x):
        return jax.lax.while_loop(lambda y: y < 3, lambda y: y + 1, x)

    assert "cond" in programs.primitives(jax.jit(branches), jnp.zeros(2))
    assert "while" in programs.primitives(jax.jit(loops), jnp.zeros(()))
    with pytest.raises(AssertionError):
        programs.check_branch_free(loops, jnp.zeros(()))


def test_branch_free(query, dtype):
    bodies = scenes.random(64).astype(dtype).bodies()
    programs.check_branch_free(query, *bodies)
    programs.check_branch_free(jax.vmap(query), *bodies)


def test_gradient_is_branch_free(dtype):
    bodies = scenes.random(64).astype(dtype).bodies()

    def total(box, ellipsoid):
        return jaxbe.scaled_distance(box, ellipsoid).sum()

    programs.check_branch_free(jax.grad(total, argnums=(0, 1)), *bodies)


def test_each_test_is_one_loop_over_the_batch(dtype, method):
    """One fusion that reads each input once: no intermediate reaches memory."""
    if jax.default_backend() != "cpu":
        pytest.skip("other backends fuse in other ways")
    query = jax.vmap(functools.partial(jaxbe.overlap, method=method))
    n = 10_000
    bodies = scenes.random(n).astype(dtype).bodies()
    assert programs.fusions(query, *bodies) == 1
    assert programs.bytes_accessed(query, *bodies) == n * (30 * dtype.itemsize + 1)


def test_batch_vmap_and_loop_agree_to_rounding(query, dtype):
    scene = scenes.random(200).astype(dtype)
    bodies = scene.bodies()
    batch = np.asarray(query(*bodies))
    vmapped = np.asarray(jax.jit(jax.vmap(query))(*bodies))
    one = jax.jit(query)
    loop = np.array([one(*scene.part(i).bodies()) for i in range(scene.size)])
    tolerance = 100 * np.finfo(dtype).eps
    np.testing.assert_allclose(batch, vmapped, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(batch, loop, rtol=tolerance, atol=tolerance)


def test_leading_axes_broadcast(query, dtype):
    """Every box of (4, 1) against every ellipsoid of (5,)."""
    scene = scenes.random(20).astype(dtype)
    boxes = jaxbe.Box(*(x[:4, None] for x in scene[:3]))
    ellipsoids = jaxbe.Ellipsoid(*(x[4:9] for x in scene[3:]))
    found = query(boxes, ellipsoids)
    assert found.shape == (4, 5)
    pairwise = jax.vmap(jax.vmap(query, (None, 0)), (0, None))
    expected = pairwise(jax.tree.map(lambda x: x[:, 0], boxes), ellipsoids)
    np.testing.assert_allclose(found, expected, rtol=100 * np.finfo(dtype).eps)


def test_fields_of_a_body_broadcast(query, dtype):
    """One orientation and size for many centres, as a scene of equal parcels has."""
    scene = scenes.random(20).astype(dtype)
    C, U, e, K, V, a = scene
    found = query(jaxbe.Box(C, U[0], e[0]), jaxbe.Ellipsoid(K[0], V, a[0]))
    expected = query(
        jaxbe.Box(C, np.broadcast_to(U[0], U.shape), np.broadcast_to(e[0], e.shape)),
        jaxbe.Ellipsoid(
            np.broadcast_to(K[0], K.shape), V, np.broadcast_to(a[0], a.shape)
        ),
    )
    np.testing.assert_allclose(found, expected, rtol=100 * np.finfo(dtype).eps)


def test_empty_batch(query, dtype):
    bodies = scenes.random(3).astype(dtype).part(slice(0, 0)).bodies()
    assert query(*bodies).shape == (0,)


def test_one_compilation_per_shape(query, dtype):
    compiled = jax.jit(lambda *bodies: query(*bodies))
    for seed in range(3):
        compiled(*scenes.random(17, seed=seed).astype(dtype).bodies())
    C, U, _, K, V, a = scenes.random(17).astype(dtype)
    if dtype == jnp.zeros(()).dtype:  # what Python numbers make is weakly typed
        weak = jnp.full((17, 3), 1.0)
        assert weak.weak_type
        compiled(jaxbe.Box(C, U, weak), jaxbe.Ellipsoid(K, V, a))
    assert compiled._cache_size() == 1
