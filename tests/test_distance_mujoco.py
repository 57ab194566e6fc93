"""The signed distance beside MuJoCo C's `mj_geomDistance`."""

import functools

import mujoco
import numpy as np
import pytest

from benchmarks import scenes
from tests import distance_reference as dr

pytestmark = [
    pytest.mark.bulk,
    pytest.mark.skipif(
        int(mujoco.__version__.split(".")[0]) < 4,
        reason="MuJoCo 3.3.5 is off by metres now and then, and crashes at 1e-10",
    ),
]

TWO_GEOMS = """
<mujoco>
  <worldbody>
    <body mocap="true"><geom type="ellipsoid" size="1 1 1"/></body>
    <body mocap="true"><geom type="box" size="1 1 1"/></body>
  </worldbody>
</mujoco>
"""


def distances(scene, tolerance=None, iterations=None):
    """MuJoCo's distance of every pair, and its own tolerance."""
    model = mujoco.MjModel.from_xml_string(TWO_GEOMS)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if tolerance is not None:
        model.opt.ccd_tolerance, model.opt.ccd_iterations = tolerance, iterations
    found = []
    for C, U, e, K, V, a in zip(*scene, strict=True):
        model.geom_size[:] = a, e
        model.geom_rbound[:] = np.max(a), np.linalg.norm(e)
        data.geom_xpos[:] = K, C
        data.geom_xmat[:] = V.ravel(), U.ravel()
        found.append(mujoco.mj_geomDistance(model, data, 0, 1, 1e10, None))
    return np.array(found), float(model.opt.ccd_tolerance)


@functools.cache
def scene_and_ours():
    scene = scenes.random(6000, seed=90)
    return scene, dr.found(scene), dr.bounds(scene)


@pytest.mark.parametrize("settings", [(), (1e-10, 200)], ids=["defaults", "tight"])
def test_apart(settings):
    """Within MuJoCo's tolerance, or else outside of the bounds, which are narrow."""
    scene, ours, (lower, upper) = scene_and_ours()
    theirs, tolerance = distances(scene, *settings)
    apart = ours.distance > 0
    differ = apart & (abs(theirs - ours.distance) > tolerance)
    assert np.all((upper - lower)[apart] <= 1e-8)
    assert np.all(((theirs < lower) | (theirs > upper))[differ])
    # MuJoCo's iteration stops early now and then, never by much.
    assert np.max(abs(theirs - ours.distance)[apart]) <= 1e-6
    if not settings:
        assert not differ.any()


@pytest.mark.parametrize(("steps", "share"), [(None, 0.015), (5, 0.008)])
def test_overlapping(steps, share):
    """Always a way out, and but seldom a longer one than MuJoCo's."""
    scene, ours, _ = scene_and_ours()
    if steps is not None:
        ours = dr.found(scene, steps)
    theirs, _ = distances(scene, 1e-10, 200)
    overlapping = ours.distance <= 0
    deeper = overlapping & (ours.distance < theirs - 1e-6)
    assert overlapping.sum() > 2000
    assert np.mean(deeper[overlapping]) <= share
    along = dr.value_along(scene, ours.normal)
    np.testing.assert_allclose(ours.distance, along, rtol=0, atol=1e-12)


def test_signs_agree():
    scene, ours, _ = scene_and_ours()
    theirs, tolerance = distances(scene)
    clear = abs(ours.distance) > tolerance
    assert np.all(((theirs < 0) == (ours.distance < 0))[clear])
