"""A Brax environment: a hand of ellipsoids reaches among boxes and must not touch.

    python examples/reach_ppo.py  # or reach_gradient.py: this file is imported, not run

Two slides and a wrist carry a palm and two fingers. The target lies behind a gap
between two boxes, and the hand has to turn to get through. The smallest margin of all
ellipsoid-box pairs says how near it is to touching: unless it is at least zero the
episode ends, and the reward falls off before that.

The dynamics have no contacts and no joint limits: an episode ends where a contact would
begin, so there is none to simulate, and a step without the solver is cheap and can be
differentiated in reverse mode, too. (With constraints that is so only where the model
says `<option iterations="1"/>`; in forward mode it always is.) So the pairs are found
by the rules of the model as written, and MJX, which refuses models whose ellipsoids and
boxes may collide, gets one whose geoms collide with nothing. (To simulate contacts,
load, make data and step inside `jaxbe.mjx.collision_enabled` instead.)
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
from brax.envs.base import Env, State
from brax.math import safe_norm
from mujoco import mjx

import jaxbe
import jaxbe.mjx

SCENE = """
<mujoco model="reach">
  <option timestep="0.02" gravity="0 0 0"><flag constraint="disable"/></option>
  <default>
    <joint damping="4" armature="0.2"/>
    <motor gear="4"/>
    <geom type="ellipsoid" contype="1" conaffinity="2" mass="0.1"/>
    <default class="box"><geom type="box" contype="2" conaffinity="1"/></default>
  </default>
  <worldbody>
    <geom class="box" pos="0.02 0.43 0" size="0.12 0.2 0.1" euler="0 0 -15"/>
    <geom class="box" pos="0.02 -0.43 0" size="0.12 0.2 0.1" euler="0 0 15"/>
    <geom class="box" pos="0.52 0 0" size="0.05 0.3 0.1"/>
    <body name="hand">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="wrist" type="hinge" axis="0 0 1" armature="0.1" damping="2"/>
      <geom size="0.05 0.11 0.04"/>
      <geom size="0.11 0.025 0.025" pos="0.13 0.08 0" euler="0 0 5"/>
      <geom size="0.11 0.025 0.025" pos="0.13 -0.08 0" euler="0 0 -5"/>
      <site name="grip" pos="0.18 0 0"/>
    </body>
  </worldbody>
  <actuator><motor joint="x"/><motor joint="y"/><motor joint="wrist"/></actuator>
</mujoco>
"""

START, SPREAD = (-0.45, 0.1, 1.3), (0.05, 0.25, 0.2)
"""Slides (m) and wrist (rad) at the start of an episode, and how far they vary."""

TARGET, TARGET_SPREAD = (0.3, 0.0), 0.03
"""Where the grip shall be (m)."""

NEAR, THERE = 0.1, 0.2
"""The margin under which the reward falls; how near the bonus begins (m)."""


class Reach(Env):
    """Move the grip to the target; an episode ends when the hand touches a box.

    Actions: forces on the slides and a torque on the wrist, in [-1, 1]. Observations:
    place and heading of the hand, its velocity, the way left from grip to target, and
    the margin of every pair, at most 2. Units are m, rad and s.
    """

    action_size, backend = 3, "mjx"

    def __init__(self, frames: int = 2, steps: int = 3) -> None:
        """Loads the scene.

        Args:
            frames: steps of the dynamics, of 0.02 s, in a step of the environment.
            steps: those of `jaxbe.margin`; any number gives a lower bound.
        """
        self.mj_model = mujoco.MjModel.from_xml_string(SCENE)
        self.pairs = jaxbe.mjx.find_pairs(self.mj_model)
        self.frames, self.margin_steps = frames, steps
        self.mj_model.geom_contype[:] = self.mj_model.geom_conaffinity[:] = 0
        self.model = mjx.put_model(self.mj_model)

    @property
    def observation_size(self) -> int:
        return 4 + 3 + 2 + len(self.pairs)

    def reset(self, rng: jax.Array) -> State:
        offset = jax.random.uniform(rng, (5,), minval=-1, maxval=1)
        qpos = jnp.array(START) + offset[:3] * jnp.array(SPREAD)
        return self.start(qpos, jnp.array(TARGET) + offset[3:] * TARGET_SPREAD)

    def start(self, qpos: jax.Array, target: jax.Array) -> State:
        """A hand at rest: slides and wrist (3,) in m and rad; target (2,) in m."""
        data = mjx.make_data(self.model).replace(qpos=qpos)
        return self._state(data, {"target": target})

    def step(self, state: State, action: jax.Array) -> State:
        data = state.pipeline_state.replace(ctrl=jnp.clip(action, -1, 1))
        data, _ = jax.lax.scan(self._frame, data, length=self.frames)
        after = self._state(data, state.info)
        # Brax's wrappers keep metrics of their own there.
        return after.replace(metrics={**state.metrics, **after.metrics})

    def margins(self, data: mjx.Data) -> jax.Array:
        """Of all ellipsoid-box pairs, (P,): below zero where they overlap."""
        box, ellipsoid = jaxbe.mjx.gather(self.pairs, self.model, data)
        return jaxbe.margin(box, ellipsoid, steps=self.margin_steps)

    def _frame(self, data: mjx.Data, _: None) -> tuple[mjx.Data, None]:
        return mjx.step(self.model, data), None

    def _state(self, data: mjx.Data, info: dict[str, jax.Array]) -> State:
        # MuJoCo's step ends with the poses from before it moved the joints.
        data = mjx.kinematics(self.model, data)
        margins = self.margins(data)
        way = info["target"] - data.site_xpos[0, :2]
        distance, nearest = safe_norm(way), margins.min()
        reward = _reward(distance, nearest)
        # Not `nearest < 0`: NaN, of a state that diverged, must end the episode, too.
        done = (~(nearest >= 0)).astype(reward.dtype)
        return State(
            pipeline_state=data,
            obs=_observation(data, way, margins),
            reward=reward,
            done=done,
            metrics={"distance": distance, "margin": nearest, "touched": done},
            info=info,
        )


def _reward(distance: jax.Array, nearest: jax.Array) -> jax.Array:
    bonus = jnp.exp(-jnp.square(distance / THERE))
    return 1 - distance + bonus - jax.nn.relu(NEAR - nearest) / NEAR


def _observation(data: mjx.Data, way: jax.Array, margins: jax.Array) -> jax.Array:
    wrist = data.qpos[2:]
    heading = [jnp.cos(wrist), jnp.sin(wrist)]
    seen = jnp.minimum(margins, 2)
    return jnp.concatenate([data.qpos[:2], *heading, data.qvel, way, seen])
