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
from jaxbe.mjx import Pairs, filter_contacts, find_pairs, gather, scene_facts

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


def unnamed(name):
    """A model of five geoms, as `SCENE`, of other types."""
    geoms = f'<geom type="{name}" size=".1 .1 .1"/>' * 5
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{geoms}</worldbody></mujoco>"
    )


QUERIES = {"gather": gather, "filter_contacts": filter_contacts}


@pytest.fixture(params=QUERIES)
def query(request):
    return QUERIES[request.param]


@pytest.mark.parametrize("ids", [[3, 9], [9, 0]])
def test_pairs_of_a_larger_model_are_refused(query, model, ids):
    data, pairs = random_data(model, 0), Pairs(np.array([ids]))
    message = "pairs name geom 9, the model has 5"
    with pytest.raises(ValueError, match=message):
        query(pairs, model, data)
    sizes = types.SimpleNamespace(geom_size=model.geom_size)
    with pytest.raises(ValueError, match=message):
        query(pairs, sizes, data)
    with pytest.raises(ValueError, match=message):
        scene_facts(pairs, model)


def test_pairs_of_a_model_of_other_types_are_refused(query, pairs, model):
    other = unnamed("box")
    data = mujoco.MjData(other)
    mujoco.mj_kinematics(other, data)
    message = (
        "pairs name geoms 3 and 0 as an ellipsoid and a box, the model has a box and "
        "a box there: find them in this model"
    )
    with pytest.raises(ValueError, match=message):
        query(pairs, other, data)
    with pytest.raises(ValueError, match=message):
        query(pairs, mjx.put_model(other), data)
    swapped = Pairs(pairs.geom[:, ::-1])
    with pytest.raises(ValueError, match="the model has a box and an ellipsoid there"):
        query(swapped, model, random_data(model, 0))
    with pytest.raises(ValueError, match="the model has a box and a box there"):
        scene_facts(pairs, other)


def test_pairs_of_elements_that_the_model_has_not_are_refused(pairs, model):
    known = Pairs(pairs.geom, np.array([[0, 2]]))
    with pytest.raises(ValueError, match="<pair> element 2, the model has 0"):
        filter_contacts(known, model, random_data(model, 0))


NEITHER = {
    "path": ("robot.xml", "from_xml_path"),
    "spec": (mujoco.MjSpec(), "got MjSpec: compile it"),
    "None": (None, "got None"),
}


@pytest.mark.parametrize("kind", NEITHER)
def test_what_is_no_model_or_no_data_is_named(query, pairs, model, kind):
    given, message = NEITHER[kind]
    with pytest.raises(TypeError, match=f"model must be .*MjModel.*{message}"):
        query(pairs, given, random_data(model, 0))
    with pytest.raises(TypeError, match=r"data must be .*MjData"):
        query(pairs, model, given)
    with pytest.raises(TypeError, match=f"model must be .*MjModel.*{message}"):
        scene_facts(pairs, given)


def test_arguments_in_the_wrong_order_are_named(query, pairs, model):
    data = random_data(model, 0)
    with pytest.raises(TypeError, match="got MjData, which is data, not a model"):
        query(pairs, data, model)
    with pytest.raises(TypeError, match="got MjModel, which is a model, not data"):
        query(pairs, model, model)
    for other in (model, data, None, pairs.geom):
        with pytest.raises(TypeError, match="pairs must be from find_pairs"):
            query(other, model, data)


# Poses that were never computed.


def test_poses_that_were_never_computed_are_refused(query, pairs, model):
    never = r"never computed: call mujoco\.mj_forward.* or mjx\.kinematics"
    with pytest.raises(ValueError, match=never):
        query(pairs, model, mujoco.MjData(model))
    data = random_data(model, 0)
    mujoco.mj_resetData(model, data)
    with pytest.raises(ValueError, match=never):
        query(pairs, model, data)
    batch = [poses_of(random_data(model, 0)), poses_of(data)]
    batch = types.SimpleNamespace(
        geom_xpos=jnp.stack([d.geom_xpos for d in batch]),
        geom_xmat=jnp.stack([d.geom_xmat for d in batch]),
    )
    with pytest.raises(ValueError, match=never):
        query(pairs, model, batch)


@pytest.mark.usefixtures("allow_pairs")
def test_poses_of_mjx_that_were_never_computed_are_refused(query, pairs, model):
    on_device = mjx.put_model(model)
    data = mjx.make_data(on_device)
    with pytest.raises(ValueError, match="never computed"):
        query(pairs, on_device, data)

    def verdict(data):
        return overlap(*gather(pairs, on_device, data))

    # Traced ones cannot be seen: NaN, which counts as touching.
    assert jax.jit(verdict)(data).all()


def test_poses_of_brax_that_were_never_computed_are_refused(query, pairs, model):
    x = types.SimpleNamespace(pos=np.zeros((2, 3)), rot=np.zeros((2, 4)))
    with pytest.raises(ValueError, match="never computed"):
        query(pairs, model, types.SimpleNamespace(x=x))


def test_no_state_at_all_was_computed_well_enough(query, pairs, model):
    """A batch of no states, and a model without geoms."""
    none = types.SimpleNamespace(
        geom_xpos=np.zeros((0, 5, 3)), geom_xmat=np.zeros((0, 5, 9))
    )
    assert jax.tree.leaves(query(pairs, model, none))[0].shape[0] == 0
    empty = mujoco.MjModel.from_xml_string("<mujoco/>")
    query(Pairs(np.zeros((0, 2), int)), empty, mujoco.MjData(empty))


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
