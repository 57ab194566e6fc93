"""Contacts of MuJoCo C beside those of the function that jaxbe puts into MJX."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from benchmarks.scenes import Scene
from jaxbe.cli.states import random_states
from jaxbe.mjx import find_pairs
from tests import distance_reference as dr
from tests.in_mjx import registered

TIGHT = {"ccd_tolerance": 1e-12, "ccd_iterations": 300}


class Hits(NamedTuple):
    """Pairs that overlap, n of them, each in some state inside the joint ranges.

    Attributes:
        scene: the boxes and ellipsoids.
        ours: distance (n,), position (n, 3) and frame (n, 3, 3) of jaxbe's function.
        tight: those of MuJoCo C with a tolerance of 1e-12 and 300 iterations.
        default: those of MuJoCo C as it is.
    """

    scene: Scene
    ours: list[np.ndarray]
    tight: list[np.ndarray]
    default: list[np.ndarray]

    def part(self, which):
        scene, *contacts = self
        return Hits(scene.part(which), *([x[which] for x in y] for y in contacts))

    def is_shallow(self):
        """Depth, as MuJoCo C has it, below a tenth of the smallest size."""
        smallest = np.min(np.concatenate([self.scene.e, self.scene.a], axis=1), axis=1)
        return -self.tight[0] < 0.1 * smallest


def collect(model, function, shallow, deep, seed=0, most=20_000):
    """States until there are so many shallow and deep hits.

    Args:
        model: a `mujoco.MjModel`, whose contacts are enabled.
        function: gives jaxbe's contacts of all pairs, of geom_xpos and geom_xmat.
        shallow: how many shallow hits, at least.
        deep: how many other ones, at least.
        seed: of the states.
        most: this many states at most.
    """
    data, found, counts = mujoco.MjData(model), [], np.zeros(2, int)
    pairs = find_pairs(model).geom
    rows = random_states(model, most, seed).rows
    for i in range(most):
        data.qpos[:] = rows(i, i + 1)[0]
        hits = _hits_of_state(model, data, pairs, function)
        if hits is not None:
            found.append(hits)
            counts += np.bincount(hits.is_shallow(), minlength=2)
            if counts[1] >= shallow and counts[0] >= deep:
                break
    print(f"{i + 1} states, {counts[1]} shallow hits, {counts[0]} deep ones")
    assert counts[1] >= shallow
    assert counts[0] >= deep
    return jax.tree.map(lambda *x: np.concatenate(x), *found)


def function_of(model, dtype=np.float64):
    """jaxbe's contacts of all pairs of a model, called as MJX's driver calls it."""
    on_device, data = mjx.put_model(model), mjx.make_data(model)
    pairs, function = jnp.asarray(find_pairs(model).geom), registered()

    @jax.jit
    def contacts(geom_xpos, geom_xmat):
        poses = data.replace(geom_xpos=geom_xpos, geom_xmat=geom_xmat)
        return function(on_device, poses, None, pairs)

    def of_poses(geom_xpos, geom_xmat):
        poses = geom_xpos, geom_xmat.reshape(-1, 3, 3)
        return [np.asarray(x) for x in contacts(*(x.astype(dtype) for x in poses))]

    return of_poses


def assert_shallow_hits_are_those_of_c(hits):
    """With the tolerance of 1e-12, and with MuJoCo's own, which is 1e-6."""
    _assert_agree(hits, hits.tight, 1e-9, 1e-6, 1e-4)
    _assert_agree(hits, hits.default, 2e-6, 1e-3, 2e-2)


def _assert_agree(hits, of_c, of_distance, of_position, of_normal):
    distance = abs(hits.ours[0] - of_c[0])
    position = np.linalg.norm(hits.ours[1] - of_c[1], axis=1)
    normals = [x[2][:, 0] for x in (hits.ours, of_c)]
    normal = np.linalg.norm(normals[0] - normals[1], axis=1)
    print("distance, position, normal:", *(
        f"{np.max(x):.1e}" for x in (distance, position, normal)
    ))  # fmt: skip
    assert np.max(distance) <= of_distance
    assert np.max(position) <= of_position
    # MuJoCo's iterations end early now and then: then our way out is the shorter one.
    far = hits.part(np.flatnonzero(normal > of_normal)).scene
    ours, theirs = (dr.value_along(far, x[normal > of_normal]) for x in normals)
    print(f"normals further than that: {len(ours)} of {len(normal)}, ours is better")
    assert len(ours) <= 0.02 * len(normal)
    assert np.all(ours > theirs)


def assert_depths_are_ways_out(hits):
    """Proved along the normal, and seldom longer than those of MuJoCo C."""
    distance, _, frame = hits.ours
    along = dr.value_along(hits.scene, frame[:, 0])
    assert np.max(abs(along - distance)) <= 1e-12
    excess = hits.tight[0] - distance
    print(f"longer than C's: {np.mean(excess > 1e-6):.4f}, most {np.max(excess):.1e}")
    assert np.mean(excess > 1e-6) <= 0.01


def _hits_of_state(model, data, pairs, function):
    tight = _contacts_of_c(model, data, pairs, **TIGHT)
    which = np.flatnonzero(tight[0] < 0)
    if not len(which):
        return None
    ours = function(data.geom_xpos, data.geom_xmat)
    default = _contacts_of_c(model, data, pairs)
    geom = pairs[which]
    return Hits(
        _scene(model, data, geom),
        *(
            [np.array(x[which]) for x in contacts]
            for contacts in (ours, tight, default)
        ),
    )


def _contacts_of_c(model, data, pairs, **options):
    """Of every pair; the distance is infinite where MuJoCo C has no contact."""
    before = {name: getattr(model.opt, name) for name in options}
    for name, value in options.items():
        setattr(model.opt, name, value)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    for name, value in before.items():
        setattr(model.opt, name, value)
    index = {tuple(pair): i for i, pair in enumerate(pairs.tolist())}
    n = len(pairs)
    dist, pos, frame = np.full(n, np.inf), np.zeros((n, 3)), np.zeros((n, 3, 3))
    contact = data.contact
    for j, geom in enumerate(contact.geom.tolist()):
        i = index.get(tuple(geom))
        if i is not None:
            assert np.isinf(dist[i]), "more than one contact of a pair"
            dist[i], pos[i] = contact.dist[j], contact.pos[j]
            frame[i] = contact.frame[j].reshape(3, 3)
    return dist, pos, frame


def _scene(model, data, geom):
    ellipsoid, box = geom.T
    axes = data.geom_xmat.reshape(-1, 3, 3)
    return Scene(
        data.geom_xpos[box], axes[box], model.geom_size[box],
        data.geom_xpos[ellipsoid], axes[ellipsoid], model.geom_size[ellipsoid],
    )  # fmt: skip
