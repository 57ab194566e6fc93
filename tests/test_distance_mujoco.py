"""The signed distance beside MuJoCo C's `mj_geomDistance`."""

import functools

import mujoco
import numpy as np
import pytest

from benchmarks import distances, everyday, scenes
from tests import distance_reference as dr

pytestmark = [
    pytest.mark.bulk,
    pytest.mark.skipif(
        int(mujoco.__version__.split(".")[0]) < 4,
        reason="MuJoCo 3.3.5 is off by metres now and then, and crashes at 1e-10",
    ),
]


@functools.cache
def scene_and_ours():
    scene = scenes.random(6000, seed=90)
    return scene, dr.found(scene), dr.bounds(scene)


@pytest.mark.parametrize("settings", [None, distances.TIGHT], ids=["defaults", "tight"])
def test_apart(settings):
    """Within MuJoCo's tolerance, or else outside of the bounds, which are narrow."""
    scene, ours, (lower, upper) = scene_and_ours()
    theirs, tolerance = distances.of_mujoco(scene, settings)
    apart = ours.distance > 0
    differ = apart & (abs(theirs - ours.distance) > tolerance)
    assert np.all((upper - lower)[apart] <= 1e-8)
    assert np.all(((theirs < lower) | (theirs > upper))[differ])
    # MuJoCo's iteration stops early now and then, never by much.
    assert np.max(abs(theirs - ours.distance)[apart]) <= 1e-6
    if settings is None:
        assert not differ.any()


@pytest.mark.parametrize(("steps", "share"), [(None, 0.015), (5, 0.008)])
def test_overlapping(steps, share):
    """Always a way out, and but seldom a longer one than MuJoCo's."""
    scene, ours, _ = scene_and_ours()
    if steps is not None:
        ours = dr.found(scene, steps)
    theirs, _ = distances.of_mujoco(scene, distances.TIGHT)
    assert np.sum(ours.distance <= 0) > 2000
    assert distances.longer(ours.distance, theirs) <= share
    along = dr.value_along(scene, ours.normal)
    np.testing.assert_allclose(ours.distance, along, rtol=0, atol=1e-12)


def test_signs_agree():
    scene, ours, _ = scene_and_ours()
    theirs, tolerance = distances.of_mujoco(scene)
    clear = abs(ours.distance) > tolerance
    assert np.all(((theirs < 0) == (ours.distance < 0))[clear])


def witness_points_of_mujoco(scene):
    """Of pairs apart, on the ellipsoid and on the box: (n, 2, 3)."""
    model = mujoco.MjModel.from_xml_string(distances.TWO_GEOMS)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 300
    found = np.zeros((scene.size, 2, 3))
    for i, (C, U, e, K, V, a) in enumerate(zip(*scene, strict=True)):
        model.geom_size[:] = a, e
        data.geom_xpos[:] = K, C
        data.geom_xmat[:] = V.ravel(), U.ravel()
        segment = np.zeros(6)
        mujoco.mj_geomDistance(model, data, 0, 1, 1e3, segment)
        found[i] = segment.reshape(2, 3)
    return found


@pytest.mark.parametrize("kind", scenes.ROUND_OR_ALIGNED)
def test_witness_points_of_round_and_aligned_bodies(kind):
    """They were up to the pair's size away; MuJoCo's are right to some 1e-5 of it."""
    scene = scenes.ROUND_OR_ALIGNED[kind](scenes.random(300, seed=91))
    scene = scene.part(dr.found(scene).distance > 0)
    ours, theirs = dr.found(scene), witness_points_of_mujoco(scene)
    for found, expected in zip(
        (ours.on_ellipsoid, ours.on_box), theirs.transpose(1, 0, 2), strict=True
    ):
        error = np.linalg.norm(found - expected, axis=1) / everyday.reach(scene)
        assert np.median(error) <= 1e-6
        assert np.max(error) <= 2e-3
