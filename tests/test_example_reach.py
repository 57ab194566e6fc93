"""The example environment: alone, under Brax's wrappers, and in both trainings."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

pytest.importorskip("brax")
optax = pytest.importorskip("optax")

import reach_env  # noqa: E402
import reach_gradient  # noqa: E402
from brax.envs.wrappers import training  # noqa: E402

pytestmark = [pytest.mark.bulk, pytest.mark.usefixtures("jax_as_users_have_it")]


@pytest.fixture(scope="module")
def env():
    with jax.enable_x64(False), jax.numpy_dtype_promotion("standard"):
        return reach_env.Reach()


@functools.cache
def wrapped(env):
    """Brax's wrapper, whose step and reset take 2 environments."""
    both = training.wrap(env, episode_length=6)
    return jax.jit(both.reset), jax.jit(both.step)


def places(count):
    """Hands over the whole table, (count, 3)."""
    low, high = [-0.7, -0.5, -3.0], [0.5, 0.5, 3.0]
    return np.random.default_rng(0).uniform(low, high, (count, 3)).astype(np.float32)


@functools.cache
def standing(env):
    """The states of 400 hands at rest."""
    start = jax.jit(jax.vmap(env.start, in_axes=(0, None)))
    return start(places(400), jnp.array(reach_env.TARGET))


def touches(env, qpos):
    """MuJoCo C's verdict, in float64, on the scene as written."""
    model = mujoco.MjModel.from_xml_string(reach_env.SCENE)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    pairs = env.pairs.geom.tolist()
    return min(mujoco.mj_geomDistance(model, data, *p, 10.0, None) for p in pairs) < 0


def test_an_episode_ends_where_its_state_is_nan(env):
    """Which is not below zero."""
    start = jax.jit(jax.vmap(env.start, in_axes=(0, None)))
    lost = places(400).copy()
    lost[7, 0] = np.nan
    done = start(lost, jnp.array(reach_env.TARGET)).done
    assert done[7] == 1
    np.testing.assert_array_equal(np.delete(done, 7), np.delete(standing(env).done, 7))


def test_an_episode_ends_where_mujoco_finds_a_touch(env):
    state = standing(env)
    expected = np.array([touches(env, qpos) for qpos in places(400)])
    clear = np.abs(np.asarray(state.metrics["margin"])) > 1e-3
    assert 0.2 < expected.mean() < 0.8
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(state.done[clear], expected[clear])


def test_the_reward_grows_near_the_target_and_falls_with_the_margin(env):
    metrics = standing(env).metrics
    distance = np.asarray(metrics["distance"])
    there = np.exp(-np.square(distance / reach_env.THERE))
    lost = 1 - distance + there - np.asarray(standing(env).reward)
    margin = np.asarray(metrics["margin"])
    order = np.argsort(margin)
    assert np.all(np.diff(lost[order]) <= 1e-6)
    np.testing.assert_allclose(lost[margin >= reach_env.NEAR], 0, atol=1e-6)
    assert np.all(lost[margin < 0] > 1)


def test_a_step_under_brax_wrappers(env):
    reset, step = wrapped(env)
    state = reset(jax.random.split(jax.random.PRNGKey(0), 2))
    assert state.obs.shape == (2, env.observation_size)
    assert not state.done.any()
    moved = step(state, jnp.array([[1.0, 0, 0], [0, 0, 1.0]]))
    before, after = state.pipeline_state.qpos, moved.pipeline_state.qpos
    assert (after - before)[0, 0] > 1e-3
    assert (after - before)[1, 2] > 1e-3
    for leaf in jax.tree.leaves(moved):
        assert np.all(np.isfinite(leaf))


def test_brax_resets_a_hand_that_touches_and_one_that_is_out_of_time(env):
    reset, step = wrapped(env)
    first = state = reset(jax.random.split(jax.random.PRNGKey(1), 2))
    # One is thrown at a box, the other stays where it is.
    data = state.pipeline_state
    fast = data.qvel.at[0].set(jnp.array([6.0, 0, 0]))
    state = state.replace(pipeline_state=data.replace(qvel=fast))
    done, truncated = [], []
    for _ in range(6):
        state = step(state, jnp.zeros((2, 3)))
        done.append(np.asarray(state.done))
        truncated.append(np.asarray(state.info["truncation"]))
        ended = np.asarray(state.done, bool)
        np.testing.assert_array_equal(state.obs[ended], first.obs[ended])
    thrown, still = np.array(done).T
    assert thrown[:5].sum() == 1
    assert not np.array(truncated)[:5].any()
    np.testing.assert_array_equal(still, [0, 0, 0, 0, 0, 1])
    assert np.array(truncated)[5, 1] == 1


@pytest.mark.slow
def test_the_gradient_improves_the_forces(env):
    optimiser = optax.adam(0.05)
    improve = reach_gradient.improver(env, optimiser)
    forces = jnp.zeros((6, 3))
    found = reach_gradient.optimise(improve, forces, optimiser.init(forces), 100.0, 4)
    assert np.all(np.isfinite(found.loss))
    assert np.all(np.diff(found.loss) < 0)
    assert found.path.shape == (6, 3)


@pytest.mark.slow
def test_the_gradient_is_that_of_the_loss(env):
    """In a rollout through a touch: of the margins' penalty, too."""
    forces = jnp.tile(jnp.array([[1.0, -0.5, -0.3]]), (30, 1))
    direction = jnp.cos(jnp.arange(90.0)).reshape(30, 3)

    @jax.jit
    def along(t):
        return reach_gradient.loss(forces + t * direction, env, 100.0)

    slope = jax.jit(jax.grad(lambda t: along(t)[0]))(0.0)
    step = 3e-3
    difference = (along(step)[0] - along(-step)[0]) / (2 * step)
    assert along(0.0)[1][1] < 0
    np.testing.assert_allclose(slope, difference, rtol=2e-2)


@pytest.mark.slow
def test_ppo_trains(tmp_path):
    reach_ppo = pytest.importorskip("reach_ppo")
    curve = reach_ppo.main(["--quick", "--output", str(tmp_path / "curve.png")])
    assert (tmp_path / "curve.png").stat().st_size > 10_000
    assert curve[-1]["steps"] >= 10_000
    assert all(np.isfinite(point["return"]) for point in curve)
