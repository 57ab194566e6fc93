"""A short form of the filter's benchmark; its timings are never tested."""

import mujoco
import numpy as np
import pytest
from mujoco import mjx

from benchmarks import filter, filter_report, filter_scenes, filter_step, filter_times
from jaxbe.mjx import find_pairs
from tests.test_benchmarks_margin import run

pytestmark = pytest.mark.bulk


@pytest.mark.slow
def test_report_and_numbers(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(filter, "LOWS", {"random": 0.05})
    monkeypatch.setattr(filter, "STEPS", (0, 1))
    sizes = ("--states=20", "--random-states=3", "--environments=1", "--repeats=1")
    text, numbers, _ = run(filter.main, tmp_path, *sizes, "--step-environments=0")
    assert text == capsys.readouterr().out
    assert [kind["kind"] for kind in numbers["missed"]] == [filter.ARM, "random"]
    assert [kind["pairs"] for kind in numbers["missed"]] == [2200, 300]
    for kind in numbers["missed"]:
        assert set(kind["steps"]) == {"0", "1"}
        assert all(found["missed"] == 0 for found in kind["steps"].values())
    kept = numbers["needless"]["kept_a_state"]
    for bound, needed in kept["needed"].items():
        assert needed <= kept["steps=1"][bound] <= kept["bounding spheres"][bound]
    assert [point["environments"] for point in numbers["throughput"]] == [1]
    assert all(t["median"] > 0 for t in numbers["savings"]["seconds"].values())


def test_what_is_missed_is_counted():
    """A bound above the distance, a pair that is dropped though it overlaps."""
    truth = np.array([0.1, 0.2, -0.1, -0.1])
    lower = np.array([0.1 + 1e-7, -0.3, 1e-9, -0.2])
    counts = filter._by_steps(1, lower, truth, np.full(4, 1e-6))
    assert counts["missed"] == 1
    assert counts["overlapping_dropped"] == 1
    assert counts["apart_kept"] == 1
    assert counts["largest_share_of_slack"] == pytest.approx(1.1)
    merged = filter._merged([counts, counts | {"largest_share_of_slack": 2.0}])
    assert merged["missed"] == 2
    assert merged["largest_share_of_slack"] == 2


@pytest.mark.slow
def test_poses_of_mujoco_are_those_of_mjx_to_rounding():
    sample = filter_scenes.arm_states(0, 20, 5)
    truth = filter_scenes.distance(sample.scene())
    which = np.array([[0, 0], [1, 90], [19, 109]])
    found = filter_scenes.distances_by_mujoco(sample, which)
    np.testing.assert_allclose(found, truth[which @ [110, 1]], atol=3e-6)
    lower = np.where(np.arange(2200) == 200, 1.0, -1.0)
    counts = filter._by_mujoco(sample, np.zeros(2200), lower)
    assert counts == {"dropped": 0, "largest_depth": 0.0}
    deepest = np.argmin(truth)
    lower = np.where(np.arange(2200) == deepest, 1.0, -1.0)
    counts = filter._by_mujoco(sample, np.zeros(2200), lower)
    assert counts["dropped"] == 1
    assert counts["largest_depth"] == pytest.approx(-truth[deepest], abs=3e-6)


def test_random_pairs_nearly_touch():
    sample = filter_scenes.near_touching(2, 0, 0.05)
    scene = sample.scene()
    assert scene.size == 2 * filter_scenes.PAIRS_A_STATE
    assert scene.K.dtype == np.float32
    distance = filter_scenes.distance(scene)
    assert 0.2 < np.mean(distance < 0) < 0.8
    assert np.max(abs(distance)) < 0.1
    apart = distance > 0
    spheres = np.asarray(filter_scenes.between_spheres(*scene.bodies()))
    assert np.all(spheres[apart] < distance[apart])


def test_models_of_the_step_are_loaded_by_mjx():
    model = filter_scenes.without_ellipsoid_box(filter_scenes.arm())
    assert len(find_pairs(model)) == 0
    contacts = mjx.make_data(mjx.put_model(model))._impl.contact
    assert contacts.geom.shape[0] > 100
    other = filter_scenes.without_contacts(filter_scenes.arm())
    assert mjx.make_data(mjx.put_model(other))._impl.contact.geom.shape[0] == 0


def test_models_of_the_savings():
    arm = filter_scenes.arm()
    round_model = filter_times.with_spheres(filter_scenes.arm())
    ids = np.unique(filter_scenes.arm_pairs().geom[:, 0])
    assert np.all(np.ptp(round_model.geom_size[ids], axis=1) == 0)
    assert len(filter_scenes.every_pair(arm)) > len(filter_scenes.arm_pairs())
    data = mujoco.MjData(arm)
    mujoco.mj_kinematics(arm, data)
    fixed = filter_times.fixed_boxes(arm)
    before = data.geom_xpos[fixed].copy()
    data.qpos[:] = 0.02
    mujoco.mj_kinematics(arm, data)
    np.testing.assert_array_equal(data.geom_xpos[fixed], before)
    assert len(fixed) == 12


def test_the_step_is_reported():
    point = {
        "contacts": "no contacts",
        "environments": 10,
        "compile_seconds": 3.0,
        "finite": True,
        "seconds": {"step": {"median": 1e-3}, "filter": {"median": 1e-5}},
        "cores_busy_with_others": 0.0,
    }
    text = filter_report._step([point])
    assert "| no contacts |           10 |   100.00 |       1.00 |     1.00 |" in text
    assert set(filter_step.MODELS) == {"all other contacts", "no contacts"}
