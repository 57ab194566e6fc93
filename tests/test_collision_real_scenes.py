"""dm-control's fish and dog inside MJX, for which they lack this pair alone.

The tests need the wheel, extracted as data: see `tests/test_real_scenes.py`.
"""

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from jaxbe.mjx import collision_enabled, find_pairs
from tests import hits, in_mjx
from tests.test_real_scenes import FISH, FOLDER

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(FOLDER is None, reason="JAXBE_DM_CONTROL is not set"),
]

DOG = "locomotion/walkers/assets/dog_v2/dog.xml"


def load(name):
    return mujoco.MjModel.from_xml_path(f"{FOLDER}/dm_control/{name}")


@pytest.mark.parametrize(("name", "pairs"), [(FISH, 1), (DOG, 181)])
def test_mjx_takes_the_model_inside_the_block_only(name, pairs):
    model = load(name)
    assert len(find_pairs(model)) == pairs
    in_mjx.assert_mjx_refuses(model)
    with collision_enabled():
        on_device = mjx.put_model(model)
        contact = in_mjx.contact_of(mjx.make_data(on_device))
        assert contact.geom.shape == in_mjx.contact_of(mjx.make_data(model)).geom.shape
        assert contact.geom.shape[0] >= pairs
    in_mjx.assert_mjx_refuses(model)


@pytest.mark.parametrize(("dtype", "tolerance"), [("f8", 1e-10), ("f4", 1e-4)])
def test_steps_of_fish(dtype, tolerance):
    """As it is shipped: its constraints are disabled, its contacts computed."""
    model = load(FISH)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(90)
    data.qpos[7:] = rng.uniform(-0.2, 0.2, model.nq - 7)
    data.qvel[:] = 0.1 * rng.normal(size=model.nv)
    data.ctrl[:] = rng.uniform(-1, 1, model.nu)
    with in_mjx.as_users_run_it(dtype), collision_enabled():
        on_device = mjx.put_model(model)
        state = in_mjx.set_state(mjx.make_data(on_device), data)
        step, state = in_mjx.compiled_step(on_device, state)
        for _ in range(200):
            state = step(on_device, state)
            mujoco.mj_step(model, data)
    assert state.qpos.dtype == dtype
    errors = [
        np.max(abs(np.asarray(getattr(state, x)) - getattr(data, x)))
        for x in ("qpos", "qvel")
    ]
    print("qpos, qvel:", *(f"{x:.1e}" for x in errors))
    assert max(errors) <= tolerance
    assert np.max(abs(data.qpos - model.qpos0)) > 0.1


def hits_of(name, shallow, deep):
    model = load(name)
    with in_mjx.as_users_run_it(), collision_enabled():
        function = hits.function_of(model)
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        return hits.collect(model, function, shallow, deep)


def test_contacts_of_dog_are_those_of_mujoco_c():
    found = hits_of(DOG, 100, 1000)
    hits.assert_shallow_hits_are_those_of_c(found.part(found.is_shallow()))
    hits.assert_depths_are_ways_out(found)


def test_contacts_of_fish_are_ways_out():
    """Deep ones: the tail, 1 mm thick, is pushed through the torso."""
    found = hits_of(FISH, 10, 2000)
    hits.assert_depths_are_ways_out(found)
    assert jax.tree.leaves(found)[0].shape[0] >= 2010
