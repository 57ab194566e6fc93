"""Boxes and ellipsoids at the poses of MuJoCo, MJX and Brax."""

import types

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from mujoco.mjx._src import collision_driver

from jaxbe import overlap, scaled_distance
from jaxbe.mjx import Pairs, find_pairs, gather

SCENE = """
<mujoco><worldbody>
  <geom name="shelf" type="box" size=".5 .4 .02" pos="0 0 .3" euler="10 20 30"/>
  <geom name="parcel" type="box" size=".1 .2 .15" pos=".3 0 .5" euler="0 0 40"/>
  <geom type="sphere" size=".1" contype="0" conaffinity="0"/>
  <body pos="0 0 .6"><freejoint/>
    <geom name="hand" type="ellipsoid" size=".1 .2 .3" pos=".1 0 0" euler="5 0 0"/>
    <body pos=".3 0 0"><joint axis="0 1 0"/>
      <geom name="finger" type="ellipsoid" size=".03 .04 .15"/>
    </body>
  </body>
</worldbody></mujoco>"""


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def pairs(model):
    return find_pairs(model)


def random_data(model, seed):
    data = mujoco.MjData(model)
    data.qpos[:] = np.random.default_rng(seed).normal(size=model.nq)
    data.qpos[:3] *= 0.4
    mujoco.mj_kinematics(model, data)
    return data


def poses_of(data, dtype=np.float64):
    return types.SimpleNamespace(
        geom_xpos=data.geom_xpos.astype(dtype), geom_xmat=data.geom_xmat.astype(dtype)
    )


@pytest.fixture
def allow_pairs(monkeypatch):
    """Lets MJX load models that have ellipsoid-box pairs; nothing collides them."""
    key = (mjx.GeomType.ELLIPSOID, mjx.GeomType.BOX)
    stand_in = collision_driver.ellipsoid_ellipsoid
    monkeypatch.setitem(collision_driver._COLLISION_FUNC, key, stand_in)


def assert_are_the_geoms(bodies, geoms, model, data, tolerance=0.0):
    """Bodies (P,) have the poses and sizes of the geoms with these ids."""
    center, axes, lengths = bodies.fields().values()
    expected = data.geom_xmat.reshape(-1, 3, 3)[geoms]
    np.testing.assert_allclose(center, data.geom_xpos[geoms], atol=tolerance)
    np.testing.assert_allclose(axes, expected, atol=tolerance)
    np.testing.assert_allclose(lengths, model.geom_size[geoms], atol=tolerance)


def test_bodies_have_the_poses_of_mujoco(model, pairs):
    data = random_data(model, 0)
    box, ellipsoid = gather(pairs, model, data)
    assert len(pairs) == 4
    assert_are_the_geoms(ellipsoid, pairs.geom[:, 0], model, data)
    assert_are_the_geoms(box, pairs.geom[:, 1], model, data)


def test_bodies_do_not_follow_the_simulation(model, pairs):
    """JAX may take over arrays of NumPy where they are."""
    for seed in range(20):
        data = random_data(model, seed)
        found = gather(pairs, model, data)
        before = data.geom_xpos.copy(), data.geom_xmat.copy(), model.geom_size.copy()
        for x in (data.geom_xpos, data.geom_xmat, model.geom_size):
            x += 1
        for body, geoms in zip(found, pairs.geom.T[::-1], strict=True):
            center, axes, lengths = body.fields().values()
            np.testing.assert_array_equal(center, before[0][geoms])
            np.testing.assert_array_equal(axes, before[1][geoms].reshape(-1, 3, 3))
            np.testing.assert_array_equal(lengths, before[2][geoms])
        model.geom_size -= 1


def test_the_verdict_is_that_of_mujoco(model, pairs):
    """The convention of axes: with rows for columns most of these would differ."""
    verdicts = []
    for seed in range(100):
        data = random_data(model, seed)
        distance = [
            mujoco.mj_geomDistance(model, data, e, b, mujoco.mjMAXVAL, None)
            for e, b in pairs.geom
        ]
        verdicts.append(overlap(*gather(pairs, model, data)))
        np.testing.assert_array_equal(verdicts[-1], np.array(distance) < 0)
    assert 20 < np.sum(verdicts) < 380


def test_one_dtype_that_of_the_poses(model, pairs, dtype):
    data = random_data(model, 0)
    for body in gather(pairs, model, poses_of(data, dtype)):
        assert {x.dtype for x in body.fields().values()} == {dtype}


def test_batches_of_poses(model, pairs):
    data = [random_data(model, seed) for seed in range(6)]
    stacked = types.SimpleNamespace(
        geom_xpos=np.stack([d.geom_xpos for d in data]).reshape(2, 3, -1, 3),
        geom_xmat=np.stack([d.geom_xmat for d in data]).reshape(2, 3, -1, 9),
    )
    distances = scaled_distance(*gather(pairs, model, stacked))
    one_by_one = [scaled_distance(*gather(pairs, model, d)) for d in data]
    assert distances.shape == (2, 3, 4)
    np.testing.assert_allclose(distances, np.reshape(one_by_one, (2, 3, 4)), rtol=1e-12)


@pytest.mark.parametrize("batched_poses", [False, True])
def test_batches_of_sizes_as_in_domain_randomisation(model, pairs, batched_poses):
    scales = np.array([0.5, 1.0, 3.0])
    sizes = types.SimpleNamespace(geom_size=scales[:, None, None] * model.geom_size)
    data = random_data(model, 0)
    poses = poses_of(data)
    if batched_poses:
        poses.geom_xpos, poses.geom_xmat = (
            np.broadcast_to(x, (3, *x.shape))
            for x in (poses.geom_xpos, poses.geom_xmat)
        )
    distances = scaled_distance(*gather(pairs, sizes, poses))
    for scale, row in zip(scales, distances, strict=True):
        scaled = types.SimpleNamespace(geom_size=scale * model.geom_size)
        expected = scaled_distance(*gather(pairs, scaled, data))
        np.testing.assert_allclose(row, expected, rtol=1e-12)


def test_works_under_jit_vmap_and_grad(model, pairs):
    data = [random_data(model, seed) for seed in range(3)]
    positions = jnp.stack([jnp.asarray(d.geom_xpos) for d in data])
    axes = jnp.stack([jnp.asarray(d.geom_xmat) for d in data])

    def total(position, matrix):
        poses = types.SimpleNamespace(geom_xpos=position, geom_xmat=matrix)
        return scaled_distance(*gather(pairs, model, poses)).sum()

    batched = jax.jit(jax.vmap(jax.value_and_grad(total)))
    values, gradients = batched(positions, axes)
    expected = [scaled_distance(*gather(pairs, model, d)).sum() for d in data]
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    assert np.isfinite(gradients).all()
    used = np.unique(pairs.geom)
    assert not np.any(np.delete(gradients, used, axis=1))
    assert np.any(gradients[:, used])


def test_poses_that_are_nan_pass_and_count_as_overlapping(model, pairs):
    poses = poses_of(random_data(model, 0))
    poses.geom_xpos[:] = np.nan
    assert overlap(*gather(pairs, model, poses)).all()


def test_no_pairs_give_empty_batches(model):
    none = Pairs(np.zeros((0, 2), int))
    box, ellipsoid = gather(none, model, random_data(model, 0))
    assert overlap(box, ellipsoid).shape == (0,)


def test_pairs_of_another_model_are_refused(model):
    data = random_data(model, 0)
    with pytest.raises(ValueError, match="pairs name geom 9, the model has 5"):
        gather(Pairs(np.array([[3, 9]])), model, data)


def test_data_of_another_model_are_refused(model, pairs):
    other = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="1"/></worldbody></mujoco>'
    )
    with pytest.raises(ValueError, match="same geoms, got 5 in geom_size and 1"):
        gather(pairs, model, mujoco.MjData(other))


def mjx_state(model, qpos):
    """Kinematics by MJX alone, which promotes dtypes and ranks."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        state = mjx.make_data(model).replace(qpos=qpos)
        return mjx.kinematics(model, state)


@pytest.mark.usefixtures("allow_pairs")
def test_bodies_have_the_poses_of_mjx(model, pairs):
    on_device = mjx.put_model(model)
    data = random_data(model, 0)
    state = mjx_state(on_device, jnp.asarray(data.qpos))
    box, ellipsoid = gather(pairs, on_device, state)
    assert_are_the_geoms(ellipsoid, pairs.geom[:, 0], model, data, 1e-6)
    assert_are_the_geoms(box, pairs.geom[:, 1], model, data, 1e-6)


@pytest.mark.usefixtures("allow_pairs")
def test_batches_of_mjx_states(model, pairs):
    on_device = mjx.put_model(model)
    data = [random_data(model, seed) for seed in range(4)]
    qpos = jnp.stack([jnp.asarray(d.qpos) for d in data])
    states = jax.vmap(lambda q: mjx_state(on_device, q))(qpos)
    together = scaled_distance(*gather(pairs, on_device, states))
    each = jax.vmap(lambda s: scaled_distance(*gather(pairs, on_device, s)))(states)
    expected = [scaled_distance(*gather(pairs, model, d)) for d in data]
    np.testing.assert_allclose(together, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(each, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("allow_pairs")
def test_bodies_have_the_poses_of_brax(model, pairs):
    pytest.importorskip("brax")
    from brax.io import mjcf
    from brax.mjx import pipeline

    no_contacts = SCENE.replace(
        "<worldbody>", '<option><flag contact="disable"/></option><worldbody>', 1
    )
    system = mjcf.loads(no_contacts)
    data = random_data(model, 0)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        state = pipeline.init(system, jnp.asarray(data.qpos), jnp.zeros(system.nv))
    box, ellipsoid = gather(find_pairs(system), system, state)
    assert_are_the_geoms(ellipsoid, pairs.geom[:, 0], model, data, 1e-6)
    assert_are_the_geoms(box, pairs.geom[:, 1], model, data, 1e-6)
