"""The collision function: what it returns, and beside MuJoCo C."""

import types

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco.mjx._src.math import make_frame

from benchmarks import scenes
from jaxbe.cli.arguments import DEFAULT_SCENE
from jaxbe.mjx import find_pairs
from jaxbe.mjx.ellipsoid_box import ellipsoid_box
from tests import distance_reference as dr
from tests import hits, in_mjx

pytestmark = pytest.mark.bulk

N = 30
"""Boxes, and as many ellipsoids after them; all pairs of one and one."""

GEOM = np.stack([N + np.arange(N), np.arange(N)], axis=1)


def function(size, position, axes, geom=GEOM):
    model = types.SimpleNamespace(geom_size=size)
    data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
    with in_mjx.as_users_run_it():
        return ellipsoid_box(model, data, None, jnp.asarray(geom))


def arrays(*given):
    return [np.asarray(x) for x in function(*given)]


def arguments(dtype=np.float64, seed=80):
    """Sizes, positions and axes of all geoms, and the scene that they are."""
    scene = scenes.random(N, seed=seed).astype(dtype)
    C, U, e, K, V, a = scene
    return [np.concatenate(x) for x in ((e, a), (C, K), (U, V))], scene


def test_the_conventions_of_mujoco(dtype):
    """Which way the normal points, which sign, which point; a frame like MJX's."""
    given, scene = arguments(dtype)
    distance, position, frame = arrays(*given)
    assert ellipsoid_box.ncon == 1
    assert {x.dtype for x in (distance, position, frame)} == {dtype}
    normal, slack = frame[:, 0], 50 * np.finfo(dtype).eps
    half = distance[:, None] / 2 * normal
    np.testing.assert_allclose(dr.value_along(scene, normal), distance, atol=slack)
    # The distance is right to the square of the normal's error, points are not.
    first_order = np.sqrt(np.finfo(dtype).eps)
    assert np.max(dr.outside_box(scene, position + half)) <= first_order
    assert np.max(abs(dr.outside_ellipsoid(scene, position - half))) <= first_order
    for is_hit in (distance < 0, distance > 0):
        assert np.sum(is_hit) >= 5
    identity = frame @ frame.transpose(0, 2, 1)
    np.testing.assert_allclose(identity, np.tile(np.eye(3), (N, 1, 1)), atol=slack)
    np.testing.assert_allclose(np.linalg.det(frame), 1, atol=slack)
    with in_mjx.as_users_run_it():
        of_mjx = jax.vmap(make_frame)(normal)
    np.testing.assert_allclose(frame, of_mjx, atol=slack)


def test_the_answer_has_the_dtype_of_the_poses():
    (size, position, axes), _ = arguments()
    poses = [x.astype(np.float32) for x in (position, axes)]
    for result in function(size, *poses):
        assert result.dtype == np.float32


def test_a_pose_that_is_nan_makes_its_own_pair_nan(dtype):
    given, _ = arguments(dtype)
    given[1][3] = np.nan
    for result in arrays(*given):
        is_nan = np.isnan(result).reshape(N, -1).any(axis=1)
        np.testing.assert_array_equal(is_nan, np.arange(N) == 3)


def test_batches_of_poses_and_of_sizes():
    """As with many environments whose lengths are randomised."""
    given, _ = arguments()
    factors = np.array([0.8, 1.0, 1.3])
    sizes = factors[:, None, None] * given[0]
    positions = factors[::-1, None, None] * given[1]
    axes = np.broadcast_to(given[2], (3, *given[2].shape))
    together = jax.jit(jax.vmap(function))(sizes, positions, axes)
    for i in range(3):
        alone = function(sizes[i], positions[i], given[2])
        for x, y in zip(together, alone, strict=True):
            np.testing.assert_allclose(x[i], y, atol=1e-9)


@pytest.mark.bulk
def test_hits_in_the_scene_shipped():
    """Contacts of MuJoCo C with 110 pairs of an arm, a table and a shelf."""
    model = mujoco.MjModel.from_xml_path(str(DEFAULT_SCENE))
    pairs = find_pairs(model).geom

    def of_poses(geom_xpos, geom_xmat):
        poses = geom_xpos, geom_xmat.reshape(-1, 3, 3)
        return arrays(model.geom_size, *poses, pairs)

    found = hits.collect(model, of_poses, 100, 100)
    shallow = found.is_shallow()
    hits.assert_shallow_hits_are_those_of_c(found.part(shallow))
    hits.assert_depths_are_ways_out(found)


@pytest.mark.parametrize("is_set", [False, True])
def test_mujoco_c_has_one_contact_a_pair_whatever_the_multiccd_flag(is_set):
    """So the flag makes no difference to what MJX should have."""
    model = in_mjx.model_of()
    if hasattr(mujoco.mjtEnableBit, "mjENBL_MULTICCD"):
        model.opt.enableflags = is_set * mujoco.mjtEnableBit.mjENBL_MULTICCD
    else:
        model.opt.disableflags = is_set * mujoco.mjtDisableBit.mjDSBL_MULTICCD
    data = mujoco.MjData(model)
    counts = []
    for _ in range(150):
        mujoco.mj_step(model, data)
        counts.append(data.ncon)
    assert set(counts) == {0, 1}
