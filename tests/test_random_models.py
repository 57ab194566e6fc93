"""Random MJCF models beside MuJoCo C: pairs, contacts, margins, and steps in MJX."""

import types
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from mujoco import mjx

from jaxbe.mjx import Pairs, collision_enabled, filter_contacts, find_pairs
from jaxbe.mjx.geom_types import BOX, ELLIPSOID
from jaxbe.mjx.margins import contact_distance
from tests import in_mjx
from tests.random_mjcf import Kind, random_mjcf
from tests.test_pairs import as_list, by_mjx

pytestmark = [pytest.mark.bulk, pytest.mark.filterwarnings("ignore:find_pairs")]

STATES = 8

VERSION = tuple(int(x) for x in mujoco.__version__.split(".")[:2])


class Case(NamedTuple):
    """A random model, its pairs and some of its states, computed by MuJoCo C."""

    seed: int
    model: Any
    pairs: Pairs
    states: list[Any]


def random_case(seed, kind):
    rng = np.random.default_rng([100, seed])
    model = mujoco.MjModel.from_xml_string(random_mjcf(rng, kind))
    pairs = find_pairs(model)
    assert as_list(pairs) == by_mjx(model)
    return Case(seed, model, pairs, [state_of(model, rng, i) for i in range(STATES)])


def state_of(model, rng, i):
    """The first one as the model is written; joints and mocap bodies anywhere."""
    data, far = mujoco.MjData(model), min(i, 1)
    data.qpos[:] += 0.5 * far * rng.normal(size=model.nq)
    data.mocap_pos[:] += 0.3 * far * rng.normal(size=data.mocap_pos.shape)
    mujoco.mj_forward(model, data)
    return data


def contacts_of_c(model, data):
    """By (ellipsoid, box): the distance, and the largest margin of its contacts."""
    found = {}
    for c in data.contact:
        pair = sorted((int(g) for g in c.geom), key=lambda g: model.geom_type[g])
        if [int(model.geom_type[g]) for g in pair] == [ELLIPSOID, BOX]:
            _, margin = found.get(tuple(pair), (0, -np.inf))
            found[tuple(pair)] = c.dist, max(margin, c.includemargin)
    return found


def side_by_side(cases):
    """Several models as one, so that one program does for all."""
    models = [case.model for case in cases]
    names = ("type", "size", "margin", "gap")
    arrays = {f"geom_{x}": [getattr(m, f"geom_{x}") for m in models] for x in names}
    arrays |= {
        f"pair_{x}": [getattr(m, f"pair_{x}") for m in models] for x in names[2:]
    }
    model = types.SimpleNamespace(
        opt=models[0].opt, **{name: np.concatenate(x) for name, x in arrays.items()}
    )
    poses = types.SimpleNamespace(
        geom_xpos=poses_of(cases, "geom_xpos"), geom_xmat=poses_of(cases, "geom_xmat")
    )
    return pairs_of(cases), model, poses


def poses_of(cases, name):
    """(STATES, all geoms, ...)."""
    states = zip(*(case.states for case in cases), strict=True)
    return np.stack([np.concatenate([getattr(d, name) for d in x]) for x in states])


def pairs_of(cases):
    """Those of all models, counted on."""
    geom, explicit, offset, start = [], [], 0, np.array([0, 0])
    for _, model, pairs, _ in cases:
        geom.append(pairs.geom + offset)
        explicit.append(pairs.explicit + start)
        offset += model.ngeom
        start = start + np.array([len(pairs), model.npair])
    return Pairs(np.concatenate(geom), np.concatenate(explicit))


def are_kept(candidates, pairs):
    """Whether each pair is kept, (STATES, P), in the order of the pairs."""
    row = {pair: i for i, pair in enumerate(as_list(pairs))}
    kept = np.zeros((STATES, len(pairs)), bool)
    for i in range(STATES):
        valid = np.asarray(candidates.valid[i])
        for pair in np.asarray(candidates.geom[i])[valid].tolist():
            kept[i, row[tuple(pair)]] = True
    return kept


def are_near(model, data, pairs, reach):
    """By MuJoCo's own distance, (P,)."""
    far = [mujoco.mj_geomDistance(model, data, *p, 5.0, None) for p in as_list(pairs)]
    return far < reach + 1e-6


def can_move(model, pairs):
    """Whether one of the two can: else C makes no contact but of some `<pair>`."""
    return (model.body_treeid[model.geom_bodyid[pairs.geom]] >= 0).any(axis=1)


def check_contacts(case, kept, reach):
    """How many contacts of pairs that can move; such that are near; all near; kept."""
    counts = np.zeros(4, int)
    for data, is_kept in zip(case.states, kept, strict=True):
        contacts = contacts_of_c(case.model, data)
        row = {pair: i for i, pair in enumerate(as_list(case.pairs))}
        for pair, (distance, margin) in contacts.items():
            assert is_kept[row[pair]], (case.seed, pair)
            assert distance < reach[row[pair]], (case.seed, pair)
            assert margin <= reach[row[pair]] + 1e-12, (case.seed, pair)
        near = are_near(case.model, data, case.pairs, reach)
        movable = can_move(case.model, case.pairs)
        of_movable = sum(movable[row[pair]] for pair in contacts)
        counts += of_movable, np.sum(near & movable), np.sum(near), np.sum(is_kept)
    return counts


def check_models(seeds, margin):
    """C's contacts are kept, and few others are."""
    cases = [random_case(seed, Kind(margin=margin)) for seed in seeds]
    pairs, model, poses = side_by_side(cases)
    reach = np.asarray(contact_distance(pairs, model))
    kept = are_kept(filter_contacts(pairs, model, poses), pairs)
    counts, start = np.zeros(4, int), 0
    for case in cases:
        own = slice(start, start := start + len(case.pairs))
        counts += check_contacts(case, kept[:, own], reach[own])
    contacts, moving, near, kept = counts.tolist()
    print(f"{contacts} contacts, {moving} near and moving, {near} near, {kept} kept")
    assert contacts > 10 * len(cases)
    assert near <= kept <= 1.01 * near
    assert contacts <= moving
    # C's own broad phase knows no gaps where the model overrides margins.
    if VERSION >= (3, 9) and margin is None:
        assert contacts >= 0.99 * moving


@pytest.mark.parametrize("margin", [None, 0.0, 0.2])
def test_contacts_of_c_are_kept_and_little_else(margin):
    check_models(range(40), margin)


@pytest.mark.slow
@pytest.mark.parametrize("margin", [None, 0.0, 0.2])
def test_contacts_of_c_are_kept_in_many_models(margin):
    for first in range(1000, 3000, 200):
        check_models(range(first, first + 200), margin)


# Steps in MJX.

STEPS = 200


def small_model(rng, is_aligned):
    """With contacts from the start; in every pair something can move.

    Where nothing can, C has no contact, and MJX one that is infinitely stiff.
    """
    geoms = ("ellipsoid",) * 3 + ("box",) * 3
    kind = Kind(geoms, is_aligned, inside_mjx=True)
    for _ in range(1000):
        model = mujoco.MjModel.from_xml_string(random_mjcf(rng, kind))
        pairs = find_pairs(model)
        if len(pairs) > 3 and model.nv > 5 and can_move(model, pairs).all():
            data = mujoco.MjData(model)
            mujoco.mj_forward(model, data)
            if contacts_of_c(model, data):
                return model
    raise AssertionError("no such model")


def walk(model):
    """Steps in MJX and C: errors of the contacts' distances on the way, and of qpos."""
    in_c, here = mujoco.MjData(model), mujoco.MjData(model)
    contacts, qpos = [], []
    with in_mjx.as_users_run_it(), collision_enabled():
        on_device = mjx.put_model(model)
        step, state = in_mjx.compiled_step(on_device, mjx.make_data(on_device))
        for _ in range(STEPS):
            here.qpos[:] = state.qpos
            mujoco.mj_kinematics(model, here)
            mujoco.mj_collision(model, here)
            state = step(on_device, state)
            mujoco.mj_step(model, in_c)
            contacts += errors_of(model, here, in_mjx.contact_of(state))
            qpos.append(np.max(abs(state.qpos - in_c.qpos)))
    return np.array(contacts), np.array(qpos)


def errors_of(model, data, contact):
    """MJX's distances beside those of C's contacts, each of which MJX has."""
    pairs = np.asarray(contact.geom).tolist()
    ours = dict(zip(map(tuple, pairs), np.asarray(contact.dist).tolist(), strict=True))
    of_c = contacts_of_c(model, data)
    return [ours[pair] - distance for pair, (distance, _) in of_c.items()]


def check_steps(seed, is_aligned):
    """Finite, and contacts as in C on the way; returns how far positions come apart."""
    contacts, qpos = walk(small_model(np.random.default_rng([200, seed]), is_aligned))
    print(f"{seed}: {len(contacts)} contacts, {np.max(abs(contacts)):.1e} m, "
          f"positions {np.max(qpos):.1e}")  # fmt: skip
    assert len(contacts) >= 1
    assert np.max(abs(contacts)) <= 1e-6
    assert np.all(np.isfinite(qpos))
    return np.max(qpos)


def test_steps_of_a_random_model():
    assert check_steps(0, is_aligned=False) <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("is_aligned", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_steps_of_random_models(seed, is_aligned):
    """Not the motion: MJX's solver errs at contacts that are infinitely stiff.

    And where a face lies on a face, any of its points may be the contact.
    """
    check_steps(seed, is_aligned)
