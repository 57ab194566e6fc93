"""States and random pairs for the filter's benchmark, and the truth there."""

from __future__ import annotations

import functools
import types
from collections.abc import Callable
from importlib import resources
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from benchmarks import margin_scenes, reference, scenes
from jaxbe.cli.states import random_states
from jaxbe.closest import closest
from jaxbe.mjx import Pairs, find_pairs, gather
from jaxbe.mjx.pairs import BOX, ELLIPSOID

PAIRS_A_STATE = 100
"""Of random pairs."""

TRUTH_STEPS = 12
TRUTH_PAIRS = 10_000
"""At a time: one compilation for all."""

DTYPE = np.float32


class Sample(NamedTuple):
    """States of a model, in float32.

    Attributes:
        pairs: its pairs.
        model: has `geom_size`.
        position: (n, ngeom, 3).
        axes: (n, ngeom, 3, 3).
        qpos: (n, nq), float32; empty for random pairs.
    """

    pairs: Pairs
    model: Any
    position: np.ndarray
    axes: np.ndarray
    qpos: np.ndarray

    @property
    def data(self) -> Any:
        """The poses, as `jaxbe.mjx` reads them."""
        return types.SimpleNamespace(geom_xpos=self.position, geom_xmat=self.axes)

    def scene(self) -> scenes.Scene:
        """All pairs of all states, one after the other."""
        box, ellipsoid = gather(self.pairs, self.model, self.data)
        shape = box.center.shape[:-1]
        fields = [*box.fields().values(), *ellipsoid.fields().values()]
        tails = (1, 2, 1, 1, 2, 1)
        return scenes.Scene(
            *(
                _flat(np.asarray(x), shape, n)
                for x, n in zip(fields, tails, strict=True)
            )
        )


def _flat(x: np.ndarray, shape: tuple[int, ...], tail: int) -> np.ndarray:
    whole = np.broadcast_to(x, shape + x.shape[x.ndim - tail :])
    return whole.reshape(-1, *x.shape[x.ndim - tail :])


@functools.cache
def arm_pairs() -> Pairs:
    """Those that the shipped scene lets collide."""
    return find_pairs(arm())


@functools.cache
def _one_each() -> Pairs:
    """Ellipsoid i with box i."""
    ids = np.arange(PAIRS_A_STATE)
    return Pairs(np.stack([ids, PAIRS_A_STATE + ids], axis=1))


def arm() -> Any:
    """The shipped scene."""
    file = resources.files("jaxbe") / "scenes" / "arm_and_shelf.xml"
    return mujoco.MjModel.from_xml_string(file.read_text())


def without_contacts(model: Any) -> Any:
    """The same model in which nothing collides: MJX loads it."""
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    return model


def without_ellipsoid_box(model: Any) -> Any:
    """The same model, but ellipsoids and boxes do not collide: MJX loads it.

    Nor do cylinders and boxes, which MJX does not know either.
    """
    kinds = model.geom_type
    bits = np.where(kinds == BOX, 2, 1)
    bits[kinds == mujoco.mjtGeom.mjGEOM_PLANE] = 3
    bits[model.geom_contype == 0] = 0
    model.geom_contype[:] = model.geom_conaffinity[:] = bits
    return model


@functools.cache
def _arm_kinematics() -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """Poses by MJX of states; not compiled, as XLA may make seconds of it a state."""
    model = mjx.put_model(without_contacts(arm()))
    start = mjx.make_data(model)

    def poses(qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
        data = mjx.kinematics(model, start.replace(qpos=qpos))
        return data.geom_xpos, data.geom_xmat

    return jax.vmap(poses)


def arm_states(start: int, stop: int, seed: int) -> Sample:
    """Random states within the joint ranges, poses by MJX in float32."""
    model = arm()
    qpos = random_states(model, stop, seed).rows(start, stop).astype(DTYPE)
    with jax.enable_x64(False):
        position, axes = _arm_kinematics()(jnp.asarray(qpos))
    size = model.geom_size.astype(DTYPE)
    return Sample(
        arm_pairs(),
        types.SimpleNamespace(geom_size=size),
        np.asarray(position),
        np.asarray(axes),
        qpos,
    )


def near_touching(states: int, seed: int, low: float) -> Sample:
    """Random pairs with growth distances 1 +- 10^-8 to 10^-2, in states of some."""
    n = states * PAIRS_A_STATE
    rng = np.random.default_rng(seed)
    away = rng.choice([-1, 1], n) * 10 ** rng.uniform(-8, -2, n)
    pairs = scenes.random(n, seed, low=low)
    C, U, e, K, V, a = margin_scenes.near_touching(pairs, 1 + away).astype(DTYPE)

    def of_states(ellipsoids: np.ndarray, boxes: np.ndarray) -> np.ndarray:
        shape = states, PAIRS_A_STATE, *boxes.shape[1:]
        return np.concatenate([ellipsoids.reshape(shape), boxes.reshape(shape)], axis=1)

    return Sample(
        _one_each(),
        types.SimpleNamespace(geom_size=of_states(a, e)),
        of_states(K, C),
        of_states(V, U),
        np.zeros((states, 0), DTYPE),
    )


def distance(pairs: scenes.Scene) -> np.ndarray:
    """The signed distance of these very floats, from below.

    Along the direction that is found in float64, in extended precision.
    """
    parts = []
    for start in range(0, pairs.size, TRUTH_PAIRS):
        which = np.arange(start, start + TRUTH_PAIRS) % pairs.size
        n = _directions(*pairs.part(which).astype(np.float64).bodies())
        parts.append(np.asarray(n))
    n = np.concatenate(parts)[: pairs.size]
    return reference.value_along(pairs, -np.einsum("nri,ni->nr", pairs.U, n))


@jax.jit
def _directions(box: Any, ellipsoid: Any) -> jax.Array:
    return jnp.stack(closest(box, ellipsoid, TRUTH_STEPS).n, axis=-1)


def distances_by_mujoco(sample: Sample, which: np.ndarray) -> np.ndarray:
    """Of some (state, pair), with the poses of MuJoCo C in float64, by `distance`."""
    model = arm()
    data = mujoco.MjData(model)
    found = []
    for state, pair in which:
        data.qpos[:] = sample.qpos[state]
        mujoco.mj_kinematics(model, data)
        one = sample._replace(
            pairs=Pairs(sample.pairs.geom[pair : pair + 1]),
            model=model,
            position=data.geom_xpos[None],
            axes=data.geom_xmat.reshape(1, -1, 3, 3),
        )
        found.append(one.scene())
    if not found:
        return np.zeros(0)
    return distance(scenes.Scene(*map(np.concatenate, zip(*found, strict=True))))


def every_pair(model: Any) -> Pairs:
    """All ellipsoids against all boxes, whether they may collide or not."""
    kinds = model.geom_type
    ids = np.meshgrid(*(np.flatnonzero(kinds == x) for x in (ELLIPSOID, BOX)))
    return Pairs(np.stack(ids, axis=-1).reshape(-1, 2))


@jax.jit
def between_spheres(box: Any, ellipsoid: Any) -> jax.Array:
    """The distance of the bounding spheres: the filter to beat."""
    offset = ellipsoid.center - box.center
    radii = jnp.linalg.norm(box.half_extents, axis=-1) + jnp.max(
        ellipsoid.semi_axes, axis=-1
    )
    return jnp.linalg.norm(offset, axis=-1) - radii
