"""The command line's distances, certificates and what the picture shows of them."""

import contextlib
import io
import json

import mujoco
import numpy as np
import pytest

import jaxbe
from jaxbe.cli import main
from jaxbe.cli.agreement import EXAMPLES, Agreement
from jaxbe.cli.pair_results import PairResults
from jaxbe.cli.picture import draw
from jaxbe.viz.view import NORMAL_COLOR, Mark, View
from tests.test_cli import NO_OPENGL, has_hue, pixels, share_of

pytestmark = pytest.mark.bulk

SCENE = """
<mujoco><worldbody><light pos="0 0 3"/>
  <geom name="shelf" type="box" size=".5 .4 .02" pos="0 0 .3"/>
  <body name="arm"><joint name="lift" type="slide" axis="0 0 1" range="0 1"/>
    <geom name="hand" type="ellipsoid" size=".1 .2 .3"/>
    <geom name="ball" type="ellipsoid" size=".1 .1 .1" pos="0 0 2"/>
  </body>
</worldbody></mujoco>"""

ABOVE = np.array([0.38, -0.02, 0.0, -0.07, 0.004])
"""Distances of the hand, straight above the shelf; one touches, to rounding."""

YELLOW = NORMAL_COLOR[:3]

LIFTS = (ABOVE + 0.62)[:, None]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.xml"
    path.write_text(SCENE)
    return str(path)


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    path = tmp_path_factory.mktemp("states") / "states.npy"
    np.save(path, LIFTS)
    return str(path)


@pytest.fixture(scope="module", params=["float32", "float64"])
def report(request, scene, states):
    """Of the true contact, which takes long to compile."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = main([scene, "--qpos", states, "--dtype", request.param, "--json"])
    assert status == 0
    return json.loads(out.getvalue())


@pytest.fixture
def close(report):
    """Compares with a tolerance of the report's dtype."""
    tolerance = {"float32": 1e-6, "float64": 1e-9}[report["dtype"]]
    return lambda x: pytest.approx(x, abs=tolerance)


@pytest.fixture
def run(capsys, scene, states, quick_contact):
    """Runs to an exit status; returns the report, with another contact."""

    def run(status, *arguments):
        assert main([scene, "--qpos", states, "--json", *arguments]) == status
        return json.loads(capsys.readouterr().out)

    return run


def test_smallest_distances_are_exact(report, close):
    hand, ball = report["pairs"]
    assert hand["smallest_distance"] == close(ABOVE.min())
    assert ball["smallest_distance"] == close(ABOVE.min() + 2 + 0.2)


def test_smallest_distances_are_those_of_mujoco_c(report, scene):
    model = mujoco.MjModel.from_xml_path(scene)
    data = mujoco.MjData(model)
    data.qpos[:] = LIFTS.min()
    mujoco.mj_kinematics(model, data)
    ball = report["pairs"][1]
    expected = mujoco.mj_geomDistance(model, data, 2, 0, 10, None)
    assert ball["smallest_distance"] == pytest.approx(expected, abs=1e-5)


def test_verdicts_are_counted(report):
    verdicts = [
        [pair[key] for key in ("proved_overlapping", "proved_separated", "undecided")]
        for pair in report["pairs"]
    ]
    assert verdicts == [[2, 2, 1], [0, 5, 0]]
    totals = report["certificates"]
    assert totals["overlapping"] == 2
    assert totals["separated"] == 7
    assert totals["undecided"] == 1
    assert totals["compared"] == 9
    assert totals["beyond_rounding"] == 0
    signs = report["distance_signs"]
    assert signs["compared"] == 10
    assert signs["beyond_rounding"] == 0
    assert set(report["compile_seconds"]) == {"contact", "certify"}


def test_the_contact_is_that_of_the_deepest_overlap(report, close):
    deepest = report["deepest"]
    assert (deepest["state"], deepest["pair"]) == (3, 0)
    found = deepest["contact"]
    assert found["distance"] == close(-0.07)
    np.testing.assert_allclose(found["normal"], [0, 0, -1], atol=1e-6)
    assert found["on_box"][2] == close(0.32)
    assert found["on_ellipsoid"] == close([0, 0, 0.25])
    assert found["position"][2] == close(0.285)


def test_people_get_the_columns(capsys, scene, states, quick_contact):
    assert main([scene, "--qpos", states]) == 0
    out = capsys.readouterr().out
    for expected in ("certified", "+/-/?", "distance (m)", " 2/2/1 ", " 0/5/0 "):
        assert expected in out
    assert "certified: 2 overlapping (+), 7 separated (-), 1 undecided (?)" in out
    assert " mm, margin " in out


# Disagreement.


def wrong_certificates(monkeypatch, change):
    right = jaxbe.certify

    def certify(box, ellipsoid):
        found = right(box, ellipsoid)
        return found._replace(verdict=change(found.verdict))

    monkeypatch.setattr("jaxbe.cli.sweep.certify", certify)


def test_a_false_certificate_is_found_and_reported(
    run, capsys, scene, states, monkeypatch
):
    wrong_certificates(monkeypatch, lambda verdict: -verdict)
    report = run(1)
    assert report["agree"] is False
    found = report["certificates"]
    assert found["beyond_rounding"] == found["compared"] == 9
    assert len(found["examples"]) == 9
    for conflict in found["examples"]:
        said = conflict["answers"]
        assert said["certificate"] != said["closest_features"]
    for other in ("between_methods", "distance_signs"):
        assert report[other]["beyond_rounding"] == 0
    assert main([scene, "--qpos", states]) == 1
    out = capsys.readouterr().out
    assert "certificates with the tests: 9 disagreements on 9 pairs in states" in out
    assert "'certificate': True" in out


def test_undecided_contradicts_nothing(run, monkeypatch):
    wrong_certificates(monkeypatch, lambda verdict: 0 * verdict)
    report = run(0)
    assert [pair["undecided"] for pair in report["pairs"]] == [5, 5]
    assert report["certificates"]["compared"] == 0


def other_contact(monkeypatch, change):
    """Changes the quick contact."""
    from jaxbe.cli import sweep

    quick = sweep.contact
    monkeypatch.setattr(sweep, "contact", lambda box, e: change(quick(box, e)))


def test_a_wrong_sign_of_the_distance_is_found_and_reported(run, monkeypatch):
    other_contact(monkeypatch, lambda c: c._replace(distance=-c.distance))
    report = run(1)
    signs = report["distance_signs"]
    assert signs["compared"] == 10
    assert signs["beyond_rounding"] == 9, "all but the one that touches"
    for conflict in signs["examples"]:
        said = conflict["answers"]
        assert said["signed_distance"] != said["minkowski"]
    assert report["certificates"]["beyond_rounding"] == 0


def test_a_distance_that_is_nan_is_left_out(run, monkeypatch, tmp_path):
    """And the picture comes without it."""
    other_contact(monkeypatch, lambda c: type(c)(*(x * np.nan for x in c)))
    path = tmp_path / "out.png"
    report = run(0, "--picture", str(path))
    assert report["distance_signs"]["compared"] == 0
    assert [pair["smallest_distance"] for pair in report["pairs"]] == [None, None]
    assert report["deepest"]["contact"]["normal"] == [None] * 3
    assert pixels(path).std() > 0.05
    assert share_of(pixels(path), YELLOW) < 1e-4


@pytest.mark.parametrize(
    ("ratio", "differing", "conflicting"),
    [(1 + 1e-7, 1, 0), (1 + 1e-3, 1, 1), (np.nan, 1, 1)],
)
def test_only_differences_beyond_rounding_conflict(ratio, differing, conflicting):
    agreement = Agreement()
    yes, no, ratios = (
        np.full((1, 1), True),
        np.full((1, 1), False),
        np.full((1, 1), 2.0),
    )
    rounding = np.array([1e-5])
    agreement.add(7, {"a": yes, "b": yes}, np.True_, ratios, rounding)
    agreement.add(8, {"a": yes, "b": no}, no, ratios, rounding)
    assert (agreement.compared, agreement.differing) == (1, 0)
    agreement.add(9, {"a": yes, "b": no}, yes, np.full((1, 1), ratio), rounding)
    assert agreement.compared == 2
    assert (agreement.differing, agreement.conflicting) == (differing, conflicting)
    assert [c.state for c in agreement.conflicts] == [9] * conflicting


def test_not_all_examples_are_kept():
    agreement = Agreement()
    answers = {"a": np.ones((30, 5), bool), "b": np.zeros((30, 5), bool)}
    for start in (0, 30):
        agreement.add(start, answers, np.True_, np.full((30, 5), 2.0), np.zeros(5))
    assert agreement.conflicting == 300
    assert len(agreement.conflicts) == EXAMPLES


def test_nan_is_left_out_of_the_columns():
    results = PairResults.of_no_states(np.array([[1, 0], [2, 0]]))
    nan = np.nan
    for distance in ([[nan, nan], [0.5, nan]], [[nan, nan], [-0.25, nan]]):
        values = np.array(distance)
        flags, verdict = values <= 0, np.nan_to_num(-np.sign(values)).astype(int)
        results.add(flags, verdict, values, values, values)
    np.testing.assert_array_equal(results.smallest_distance, [-0.25, np.inf])
    np.testing.assert_array_equal(results.mean_margin(), [0.125, nan])
    np.testing.assert_array_equal(results.proved_overlapping, [1, 0])
    np.testing.assert_array_equal(results.proved_separated, [1, 0])
    np.testing.assert_array_equal(results.undecided, [2, 4])


# Pictures.


def view(scene, lift, distance):
    """The hand above or in the shelf."""
    return View(
        scene=scene,
        qpos=[lift],
        pairs=[[1, 0]] if distance <= 0 else [],
        focus=[1, 0],
        marks=[
            Mark(
                distance=distance,
                normal=[0.0, 0.0, -1.0],
                on_ellipsoid=[0.0, 0.0, lift - 0.3],
                on_box=[0.0, 0.0, 0.32],
            )
        ],
    )


def test_the_normal_goes_through_both_points(scene):
    for lift in (0.72, 0.4):
        (seen,) = view(scene, lift, lift - 0.62).marks
        start, end = seen.arrow(0.1)
        np.testing.assert_allclose(
            end - start, (abs(lift - 0.62) + 0.2) * np.array(seen.normal)
        )
        middle = np.add(seen.on_box, seen.on_ellipsoid) / 2
        np.testing.assert_allclose((start + end) / 2, middle)
    assert seen.caption() == "distance -220 mm"


@pytest.mark.parametrize("opengl", [True, False])
@pytest.mark.parametrize("lift", [0.72, 0.6, 0.4])
def test_points_and_normal_are_seen(scene, tmp_path, monkeypatch, opengl, lift):
    """Also those inside the other body; beside the whole scene, which has neither."""
    if not opengl:
        for name, value in NO_OPENGL.items():
            monkeypatch.setenv(name, value)
    path = tmp_path / "out.png"
    model = mujoco.MjModel.from_xml_path(scene)
    drawn = draw(model, view(scene, lift, lift - 0.62), path)
    if drawn.drawn_by.startswith("MuJoCo") != opengl:
        pytest.skip(drawn.why)
    image = pixels(path)
    assert share_of(image[:, 720:], YELLOW) > 0.0005
    assert share_of(image[:, :720], YELLOW) < 1e-4


def test_the_rendered_arrow_goes_beyond_both_points(scene, tmp_path):
    """The camera looks at the middle of them."""
    path = tmp_path / "out.png"
    drawn = draw(mujoco.MjModel.from_xml_path(scene), view(scene, 0.4, -0.22), path)
    if not drawn.drawn_by.startswith("MuJoCo"):
        pytest.skip(drawn.why)
    rows, _ = np.nonzero(has_hue(pixels(path)[:, 720:], YELLOW))
    above, below = 360 - rows.min(), rows.max() - 360
    assert above > 60
    assert above / below == pytest.approx(1, abs=0.3)
