"""What the tests inside MJX share."""

import contextlib

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from mujoco.mjx._src import collision_driver

from jaxbe.mjx.driver import PAIR

EGG = """
<mujoco>
  <worldbody>
    <geom name="table" type="box" size=".3 .2 .1" pos="0 0 .1" euler="5 8 20"/>
    <body name="egg" pos=".03 .02 .265" euler="20 30 40"><freejoint/>
      <geom name="egg" type="ellipsoid" size=".05 .03 .04" density="800"/>
    </body>
  </worldbody>
</mujoco>"""
"""Falls onto a tilted table, tumbles and slides down."""

THROWN = (0.3, -0.2, 0.0, 1.0, 2.0, -3.0)
"""A velocity for the egg."""


def model_of(xml=EGG, **options):
    model = mujoco.MjModel.from_xml_string(xml)
    for name, value in options.items():
        setattr(model.opt, name, value)
    return model


@contextlib.contextmanager
def as_users_run_it(dtype=np.float64):
    """MJX's floats, and its own promotions allowed."""
    x64 = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", np.dtype(dtype) == np.float64)
    try:
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            yield
    finally:
        jax.config.update("jax_enable_x64", x64)


def table():
    """MJX's table of collision functions."""
    return collision_driver._COLLISION_FUNC


def registered():
    """The function that MJX has for the pair."""
    return table()[PAIR]


def contact_of(data):
    """Where this version of MJX has its contacts."""
    return data._impl.contact if hasattr(data, "_impl") else data.contact


def assert_mjx_refuses(model):
    """As it does without jaxbe."""
    with pytest.raises(NotImplementedError, match=r"ELLIPSOID.*BOX.*not implemented"):
        mjx.put_model(model)
    with pytest.raises((ValueError, KeyError), match=r"4.*6"):
        mjx.make_data(model)


def compiled_step(model, data):
    """MJX's step, compiled once, and the data with the types that it returns.

    Under x64 some integers of new data are narrower than those after a step, and JAX
    would compile again.
    """
    after = jax.eval_shape(mjx.step, model, data)
    data = jax.tree.map(lambda x, y: jnp.asarray(x, y.dtype), data, after)
    return jax.jit(mjx.step).lower(model, data).compile(), data


def set_state(data, mujoco_data):
    """MJX's data in the state of MuJoCo's."""
    names = ("qpos", "qvel", "ctrl")
    return data.replace(**{x: jnp.array(getattr(mujoco_data, x)) for x in names})
