"""Steps through a contact, beside MuJoCo C; their derivatives; Brax."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from jaxbe.cli.arguments import DEFAULT_SCENE
from jaxbe.mjx import collision_enabled
from tests import in_mjx
from tests.in_mjx import EGG, THROWN, model_of

pytestmark = pytest.mark.bulk

PRECISE = {"ccd_tolerance": 1e-10, "ccd_iterations": 200}

ARM = (0.2, 0.3, 0.4, 1.3, 0.3, 1.1, 0.0, 0.03, 0.03)
ARM_VELOCITY = (0.3, -0.4, -0.3, 0.0, 0.6, 0.4, 0.5, 0.0, 0.0)
"""Falls, and first touches a box with an ellipsoid."""


@pytest.fixture(autouse=True)
def mjx_floats():
    with in_mjx.as_users_run_it(), collision_enabled():
        yield


def started(model, qpos=None, qvel=0.0):
    data = mujoco.MjData(model)
    data.qvel[:] = qvel
    if qpos is not None:
        data.qpos[:] = qpos
    return data


def steps_of_c(model, data, count=200):
    """The positions, and how many contacts of each pair of types there were."""
    qpos, kinds = [], []
    for _ in range(count):
        mujoco.mj_step(model, data)
        qpos.append(data.qpos.copy())
        kinds += np.sort(model.geom_type[data.contact.geom], axis=1).tolist()
    return np.array(qpos), kinds


def steps_of_mjx(model, data, count=200):
    on_device = mjx.put_model(model)
    state = in_mjx.set_state(mjx.make_data(on_device), data)
    step, state = in_mjx.compiled_step(on_device, state)
    qpos = []
    for _ in range(count):
        state = step(on_device, state)
        qpos.append(np.asarray(state.qpos))
    return np.array(qpos)


def assert_steps_as_c_does(make_model, tight, **state):
    model = make_model()
    ours = steps_of_mjx(model, started(model, **state))
    for options, tolerance in (({}, 2e-3), (PRECISE, tight)):
        model = make_model(**options)
        qpos, kinds = steps_of_c(model, started(model, **state))
        # Nothing but ellipsoids and boxes meets, and long enough.
        assert len(kinds) > 100
        assert all(kind == [4, 6] for kind in kinds)
        error = np.max(abs(ours - qpos))
        print(f"{options}: {error:.1e}")
        assert error <= tolerance


def test_step_through_a_contact():
    assert_steps_as_c_does(model_of, 1e-5, qvel=THROWN)


@pytest.mark.slow
def test_step_through_a_contact_in_float32():
    with in_mjx.as_users_run_it(np.float32):
        assert_steps_as_c_does(model_of, 1e-4, qvel=THROWN)


@pytest.mark.slow
def test_step_of_the_scene_shipped_through_a_contact():
    """Without its cylinders: MJX does not collide them with boxes."""

    def arm(**options):
        spec = mujoco.MjSpec.from_file(str(DEFAULT_SCENE))
        for geom in spec.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
                geom.contype = geom.conaffinity = 0
        return model_of(spec.to_xml(), **options)

    assert_steps_as_c_does(arm, 1e-5, qpos=ARM, qvel=ARM_VELOCITY)


# Derivatives

ROLLOUT = 10


def shortly_before_the_contact(model):
    """Four steps before it."""
    data = started(model, qvel=(*THROWN[:2], -1.0, *THROWN[3:]))
    states = []
    while data.ncon == 0:
        states.append((data.qpos.copy(), data.qvel.copy()))
        mujoco.mj_step(model, data)
    return states[-5]


def rollout(model):
    """A function of the change of the initial velocity and place, and where."""
    qpos, qvel = shortly_before_the_contact(model)
    on_device = mjx.put_model(model)
    data = mjx.make_data(on_device)

    def roll(change):
        state = data.replace(
            qvel=jnp.asarray(qvel) + change[:6],
            qpos=jnp.asarray(qpos).at[:3].add(change[6:]),
        )

        def step(state, _):
            state = mjx.step(on_device, state)
            return state, in_mjx.contact_of(state).dist

        state, distances = jax.lax.scan(step, state, length=ROLLOUT)
        end = jnp.concatenate([state.qpos, state.qvel])
        return end, (end, distances)

    return roll


def assert_derivatives_are_right(model, derivative, tolerance):
    """Against differences of the same program's values, of 9 inputs, 13 outputs."""
    function = jax.jit(derivative(rollout(model), has_aux=True))
    jacobian, (_, distances) = function(jnp.zeros(9))
    assert distances[0] > 0 > distances[ROLLOUT // 2]
    assert np.all(np.isfinite(jacobian))
    h, difference = 1e-6, np.zeros((13, 9))
    for i, unit in enumerate(np.eye(9)):
        upper, lower = (function(jnp.asarray(s * h * unit))[1][0] for s in (1, -1))
        difference[:, i] = (upper - lower) / (2 * h)
    error = np.max(abs(difference - jacobian)) / np.max(abs(difference))
    print(f"relative to the largest: {error:.1e}")
    assert error <= tolerance
    # The contact is in it: without it no spin would come of a place.
    assert np.max(abs(jacobian[10:, 6:])) > 1


@pytest.mark.slow
def test_forward_derivative_of_a_rollout():
    """The solver goes on to the end, or differences would be those of its ends."""
    assert_derivatives_are_right(model_of(tolerance=1e-14), jax.jacfwd, 1e-7)


@pytest.mark.slow
def test_reverse_derivative_of_a_rollout():
    """MJX can be differentiated so with one iteration of its solver."""
    model = model_of(iterations=1, ls_iterations=8)
    assert_derivatives_are_right(model, jax.jacrev, 1e-6)


# Brax


def test_brax_resets_and_steps():
    base = pytest.importorskip("brax.envs.base")
    from brax.io import mjcf

    class Egg(base.PipelineEnv):
        def __init__(self):
            super().__init__(mjcf.loads(EGG), backend="mjx", n_frames=1)

        def reset(self, rng):
            q = self.sys.init_q + 0.01 * jax.random.normal(rng, (7,))
            state = self.pipeline_init(q, jnp.asarray(THROWN))
            zero = jnp.zeros(())
            return base.State(state, state.q, zero, zero)

        def step(self, state, action):
            moved = self.pipeline_step(state.pipeline_state, action)
            return state.replace(pipeline_state=moved, obs=moved.q)

    environment = Egg()
    state = jax.jit(environment.reset)(jax.random.key(0))
    model = model_of()
    in_c = started(model, np.asarray(state.obs), THROWN)
    step, touched = jax.jit(environment.step), False
    for _ in range(60):
        state = step(state, jnp.zeros(0))
        mujoco.mj_step(model, in_c)
        touched |= bool(state.pipeline_state.contact.dist[0] < 0)
    assert touched
    np.testing.assert_allclose(state.obs, in_c.qpos, atol=2e-3)
