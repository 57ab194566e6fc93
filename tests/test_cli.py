"""The command line: what it prints, its exit status, its one-line errors."""

import importlib.metadata
import json
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

import jaxbe
from jaxbe import METHODS
from jaxbe.cli import main
from jaxbe.cli.arguments import DEFAULT_SCENE
from jaxbe.cli.crosscheck import crosscheck
from jaxbe.cli.picture import check_writable
from jaxbe.cli.rounding import ratio_rounding, rounding_in_metres
from jaxbe.cli.sample import Drawn, Sample
from jaxbe.cli.scene import labels
from jaxbe.cli.states import random_states, sample_qpos
from jaxbe.mjx import find_pairs
from jaxbe.viz import picture

pytestmark = pytest.mark.usefixtures("quick_contact")

FEW = ["--states", "40", "--sample", "50"]

SCENE = """
<mujoco><worldbody>
  <geom name="shelf" type="box" size=".5 .4 .02" pos="0 0 .3" euler="10 20 30"/>
  <body name="arm"><joint name="lift" type="slide" axis="0 0 1" range="0 1"/>
    <geom name="hand" type="ellipsoid" size=".1 .2 .3"/>
    <body name="tool" pos=".3 0 0"><joint axis="0 1 0"/>
      <geom type="ellipsoid" size=".03 .04 .15"/>
    </body>
  </body>
</worldbody></mujoco>"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    return str(path)


@pytest.fixture
def write_scene(tmp_path):
    def write(body):
        path = tmp_path / "other.xml"
        path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        return str(path)

    return write


@pytest.fixture
def run_json(capsys):
    def run(*arguments):
        status = main([*arguments, "--json"])
        out, err = capsys.readouterr()
        assert (status, err) == (0, "")
        return json.loads(out)

    return run


@pytest.fixture
def error_of(capsys):
    """Runs to an error; returns the line without the program's name."""

    def run(*arguments):
        assert main(list(arguments)) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("jaxbe: error: ")
        assert err.count("\n") == 1
        return err.removeprefix("jaxbe: error: ").rstrip()

    return run


def answers(report):
    """A report without its times."""
    methods = {m: x["overlapping"] for m, x in report["methods"].items()}
    return {**report, "seconds": None, "compile_seconds": None, "methods": methods}


# What it computes.


def test_the_scene_that_ships_has_a_realistic_share_of_overlaps(run_json):
    report = run_json("--states", "500")
    assert report["scene"] == str(DEFAULT_SCENE)
    assert len(report["pairs"]) > 50
    assert 0.1 < report["states_overlapping"] / report["states"] < 0.5
    kinds = {pair["box"] for pair in report["pairs"] if pair["overlapping"]}
    assert {"table", "palm"} < kinds, "links on furniture, fingers on fruit"


def test_a_report_has_everything(run_json):
    report = run_json(*FEW)
    assert report["agree"] is True
    assert report["dtype"] == "float32"
    assert report["device"].startswith(jax.devices()[0].platform)
    assert report["versions"]["jaxbe"] == jaxbe.__version__
    assert report["versions"]["mujoco"] == mujoco.__version__
    assert report["states"] == 40
    assert set(report["methods"]) == set(METHODS)
    for method in report["methods"].values():
        assert method["compile_seconds"] > 0
        assert method["pairs_per_second"] > 0
    compared = report["between_methods"]["compared"]
    assert compared == 40 * len(report["pairs"])
    assert report["mujoco"]["checked"] == 50
    assert report["mujoco"]["ccd_tolerance"] == 1e-6
    assert report["picture"] is None


def test_counts_are_those_of_mujoco_c(run_json, scene):
    report = run_json(scene, *FEW)
    model = mujoco.MjModel.from_xml_path(scene)
    data = mujoco.MjData(model)
    expected = np.zeros((40, 2), bool)
    for row, qpos in zip(
        expected, random_states(model, 40, 0).rows(0, 40), strict=True
    ):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for i, geom in enumerate((1, 2)):
            row[i] = mujoco.mj_geomDistance(model, data, geom, 0, 10, None) < 0
    found = [pair["overlapping"] for pair in report["pairs"]]
    assert found == expected.sum(axis=0).tolist()
    assert report["states_overlapping"] == expected.any(axis=1).sum()
    assert 0 < sum(found) < 80
    for method in METHODS:
        assert report["methods"][method]["overlapping"] == sum(found)


def test_pairs_are_named_by_geom_or_by_body(run_json, scene):
    names = [(p["ellipsoid"], p["box"]) for p in run_json(scene, *FEW)["pairs"]]
    assert names == [("hand", "shelf"), ("tool/geom2", "shelf")]


def test_geoms_of_the_world_without_a_name(write_scene):
    model = mujoco.MjModel.from_xml_path(write_scene('<geom size="1"/>'))
    assert labels(model) == ["world/geom0"]


def test_geoms_restrict_the_pairs(run_json, scene):
    pairs = run_json(scene, *FEW, "--geoms", "hand")["pairs"]
    assert [pair["ellipsoid"] for pair in pairs] == ["hand"]


def test_float64(run_json, scene):
    report = run_json(scene, *FEW, "--dtype", "float64")
    assert report["dtype"] == "float64"
    assert report["mujoco"]["largest_rounding"] < 1e-11


@pytest.mark.parametrize("x64", [False, True])
def test_the_setting_for_float64_is_restored(run_json, scene, x64):
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", x64)
    try:
        run_json(scene, *FEW, "--dtype", "float64")
        assert jax.config.jax_enable_x64 is x64
    finally:
        jax.config.update("jax_enable_x64", before)


def test_a_seed_gives_the_same_report_and_another_seed_another(run_json, scene):
    first = answers(run_json(scene, *FEW, "--seed", "3"))
    assert answers(run_json(scene, *FEW, "--seed", "3")) == first
    assert answers(run_json(scene, *FEW, "--seed", "4")) != first


@pytest.mark.parametrize("batch", ["1", "7", "40", "1000"])
def test_the_batch_does_not_matter(run_json, scene, batch):
    """Also that the padding of the last batch is left out."""
    report = answers(run_json(scene, *FEW, "--batch", batch))
    assert report == answers(run_json(scene, *FEW))


def test_each_test_is_compiled_once(run_json, scene):
    # What jax compiles for arrays of these shapes outside of jit is compiled before.
    for batch in ("40", "7"):
        run_json(scene, *FEW, "--batch", batch)
    with jax.log_compiles(False), _count_compilations() as few:
        run_json(scene, *FEW, "--batch", "40")
    with _count_compilations() as many:
        run_json(scene, *FEW, "--batch", "7")
    assert len(few) == len(many)


class _count_compilations:
    """Counts XLA's compilations in a `with` block."""

    def __enter__(self):
        self.events = []
        self.is_on = True
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self.events

    def _listen(self, event, _, **kwargs):
        if self.is_on and event.endswith("backend_compile_duration"):
            self.events.append(event)

    def __exit__(self, *_):
        self.is_on = False


def test_people_get_a_table(capsys, scene):
    assert main([scene, *FEW]) == 0
    out, err = capsys.readouterr()
    assert err == "", "no progress bar where standard error is not a terminal"
    for expected in (
        "2 box-ellipsoid pairs",
        "hand",
        "tool/geom2",
        "of 40 states",
        *METHODS,
        "pairs/s",
        "between the three tests: 0 disagreements on 80 pairs in states",
        "certificates with the tests: 0 disagreements on 80 pairs in states",
        "distance's sign with the tests: 0 disagreements on 80 pairs in states",
        "with MuJoCo C: 0 disagreements on a sample of 50",
        "deepest overlap by margin: state",
    ):
        assert expected in out


def test_margins_tell_how_deep(run_json, scene, tmp_path):
    """Per pair, over the states; and the deepest overlap is the one reported."""
    heights = ((1.0, 0.0), (0.3, 0.0), (0.25, 0.0))
    one_by_one = [
        run_json(scene, "--qpos", save(tmp_path, np.array(row)))["pairs"]
        for row in heights
    ]
    report = run_json(scene, "--qpos", save(tmp_path, np.array(heights)))
    for i, pair in enumerate(report["pairs"]):
        margins = [pairs[i]["smallest_margin"] for pairs in one_by_one]
        assert pair["smallest_margin"] == pytest.approx(min(margins), abs=1e-6)
        assert pair["mean_margin"] == pytest.approx(np.mean(margins), abs=1e-6)
        assert pair["overlapping"] == sum(m <= 0 for m in margins)
    smallest = [pair["smallest_margin"] for pair in report["pairs"]]
    assert report["deepest"]["margin"] == min(smallest) < 0
    assert report["deepest"]["pair"] == int(np.argmin(smallest))


def test_rows_are_limited_and_the_rest_is_counted(capsys, scene):
    assert main([scene, *FEW, "--rows", "1"]) == 0
    assert "and 1 more pairs" in capsys.readouterr().out


def test_a_sample_of_none_is_legal(run_json, scene):
    report = run_json(scene, "--states", "5", "--sample", "0")
    assert report["mujoco"]["checked"] == 0


# States.


def states_of(body, n=2000, seed=0):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><statistic extent="3"/><worldbody>{body}</worldbody></mujoco>'
    )
    return model, random_states(model, n, seed).rows(0, n)


def moving(joint, pos="0 0 0"):
    return f'<body pos="{pos}">{joint}<geom size="1"/></body>'


@pytest.mark.parametrize(
    ("joint", "low", "high"),
    [
        ('<joint type="hinge" range="-30 60"/>', -np.pi / 6, np.pi / 3),
        ('<joint type="hinge"/>', -np.pi, np.pi),
        ('<joint type="slide" range="-.1 .4"/>', -0.1, 0.4),
        ('<joint type="slide" ref="1"/>', -2, 4),
    ],
)
def test_hinges_and_slides_fill_their_range(joint, low, high):
    _, qpos = states_of(moving(joint))
    assert qpos.shape == (2000, 1)
    width = high - low
    assert low <= qpos.min() < low + 0.01 * width
    assert high - 0.01 * width < qpos.max() <= high
    assert abs(np.median(qpos) - (low + high) / 2) < 0.05 * width


def test_free_bodies_are_anywhere_near_the_start_and_turned_anyhow():
    _, qpos = states_of(moving("<freejoint/>", pos="10 20 30"))
    offset = qpos[:, :3] - (10, 20, 30)
    assert abs(offset).max() <= 3
    assert (abs(offset).max(axis=0) > 2.9).all()
    np.testing.assert_allclose(np.linalg.norm(qpos[:, 3:], axis=1), 1)
    # Uniform rotations: the quaternions' second moment is a quarter of the unit.
    moment = qpos[:, 3:].T @ qpos[:, 3:] / len(qpos)
    np.testing.assert_allclose(moment, np.eye(4) / 4, atol=0.03)


def test_ball_joints_keep_their_limit():
    _, qpos = states_of(moving('<joint type="ball" range="0 50"/>'))
    angle = 2 * np.arccos(qpos[:, 0])
    assert np.radians(49) < angle.max() <= np.radians(50) + 1e-12
    axis = qpos[:, 1:] / np.linalg.norm(qpos[:, 1:], axis=1, keepdims=True)
    np.testing.assert_allclose(axis.T @ axis / len(axis), np.eye(3) / 3, atol=0.03)
    _, unlimited = states_of(moving('<joint type="ball"/>'))
    assert abs(unlimited[:, 0]).min() < 0.01


def test_every_joint_writes_its_own_place():
    kinds = ("<freejoint/>", '<joint type="ball"/>', '<joint type="slide"/>')
    model, qpos = states_of("".join(map(moving, kinds)), n=3)
    assert qpos.shape == (3, model.nq) == (3, 7 + 4 + 1)
    assert (qpos != sample_qpos(model, np.full((3, 10), 0.3))).all()


def test_a_state_does_not_depend_on_how_many_are_asked_for():
    model, qpos = states_of(moving("<freejoint/>"), n=100)
    rows = random_states(model, 100, 0).rows
    np.testing.assert_array_equal(rows(37, 60), qpos[37:60])


def save(tmp_path, array):
    path = tmp_path / "states.npy"
    np.save(path, array)
    return str(path)


def test_states_from_a_file(run_json, scene, tmp_path):
    lift_above, lift_into = (1.0, 0.0), (0.3, 0.0)
    path = save(tmp_path, np.array([lift_above, lift_into, lift_into], np.float32))
    report = run_json(scene, "--qpos", path, "--batch", "2")
    assert report["states"] == 3
    assert report["qpos"] == path
    assert report["pairs"][0]["overlapping"] == 2
    assert report["deepest"]["state"] == 1


def test_one_state_from_a_file(run_json, scene, tmp_path):
    report = run_json(scene, "--qpos", save(tmp_path, np.array([0, 0])))
    assert report["states"] == 1


# Bad input.


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 3)), r"qpos must have shape (N, 2) or (2,), got (4, 3)"),
        (np.zeros((4, 2, 2)), "got (4, 2, 2)"),
        (np.zeros((0, 2)), "got (0, 2)"),
        (np.zeros(()), "got ()"),
        (np.array([["a", "b"]]), "qpos must be real numbers, got <U1"),
        (np.zeros((4, 2), complex), "qpos must be real numbers, got complex128"),
        (np.array([[0, 0], [0, np.nan]]), "row 1 is not finite"),
        (np.array([[np.inf, 0]]), "row 0 is not finite"),
        (np.array([[1e300, 0]]), "not finite"),
    ],
)
def test_bad_states(error_of, scene, tmp_path, array, message):
    assert message in error_of(scene, "--qpos", save(tmp_path, array))


def test_files_that_are_not_npy(error_of, scene, tmp_path):
    missing = str(tmp_path / "missing.npy")
    assert error_of(scene, "--qpos", missing) == f"no such file: {missing}"
    text = tmp_path / "text.npy"
    text.write_text("0 0\n")
    assert "text.npy is not an .npy file of numbers" in error_of(
        scene, "--qpos", str(text)
    )
    text.write_text("")
    assert "text.npy is not an .npy file" in error_of(scene, "--qpos", str(text))
    archive = tmp_path / "archive.npz"
    np.savez(archive, qpos=np.zeros((1, 2)))
    assert "archive of arrays" in error_of(scene, "--qpos", str(archive))
    objects = tmp_path / "objects.npy"
    np.save(objects, np.array([None]), allow_pickle=True)
    assert "objects.npy is not an .npy file of numbers" in error_of(
        scene, "--qpos", str(objects)
    )


def test_a_missing_scene(error_of, tmp_path):
    path = str(tmp_path / "missing.xml")
    assert error_of(path) == f"no such file: {path}"
    assert error_of(str(tmp_path)) == f"{tmp_path} is a directory, not a file"
    assert error_of(os.devnull) == f"{os.devnull} is not a regular file"


def test_a_scene_that_is_no_model_gives_the_message_of_mujoco(error_of, write_scene):
    message = error_of(write_scene('<geom type="cuboid"/>'))
    assert "other.xml is not a MuJoCo model: XML Error" in message
    assert "cuboid" in message
    assert "line 1" in message


def test_a_scene_without_pairs(error_of, write_scene, scene):
    ball = write_scene(moving("<freejoint/>"))
    assert error_of(ball) == "the scene has no box-ellipsoid pair that may collide"
    two = '<geom name="s" type="sphere" size="1"/>'
    both = write_scene(two + moving("<freejoint/>"))
    assert "no box-ellipsoid pair with s that" in error_of(both, "--geoms", "s")


def test_unknown_geoms(error_of, scene):
    message = error_of(scene, "--geoms", "hand", "foot")
    assert message == "geoms: the model has no geom named 'foot'"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--states", "0"], "argument --states: must be at least 1, got 0"),
        (["--states", "many"], "must be a whole number, got 'many'"),
        (["--sample", "-1"], "--sample"),
        (["--dtype", "float16"], "invalid choice: 'float16'"),
        (["--nonsense"], "unrecognized arguments: --nonsense"),
        (["--states", "5", "--qpos", "x.npy"], "not allowed with argument"),
    ],
)
def test_bad_arguments(error_of, arguments, message):
    line = error_of(*arguments)
    assert message in line
    assert line.endswith("(see jaxbe --help)")


def test_a_picture_that_cannot_be_written_is_refused_before_the_work(
    error_of, scene, tmp_path, monkeypatch
):
    monkeypatch.setattr(mujoco, "MjData", None)
    path = str(tmp_path / "no" / "such.png")
    assert error_of(scene, "--picture", path) == (
        f"cannot write {path}: No such file or directory"
    )
    assert "Is a directory" in error_of(scene, "--picture", str(tmp_path))


@pytest.mark.parametrize("module", ["mujoco", "rich"])
def test_without_the_extra_one_line_says_how_to_get_it(error_of, monkeypatch, module):
    for name in list(sys.modules):
        if name.split(".")[0] == module or name.startswith("jaxbe.cli."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(jaxbe.cli, "job")
    monkeypatch.setattr(sys, "meta_path", [_Missing(module), *sys.meta_path])
    message = f"the command line needs {module}: pip install 'jaxbe[mjx]'"
    # The freshly imported modules have an InputError of their own.
    from jaxbe.cli.errors import InputError

    monkeypatch.setattr(jaxbe.cli, "InputError", InputError)
    assert error_of() == message


class _Missing:
    """An import hook under which one package is not installed."""

    def __init__(self, package):
        self._package = package

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == self._package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=self._package)


def test_the_library_needs_none_of_the_extras():
    code = """
import sys
for name in ("mujoco", "rich", "matplotlib", "brax"):
    sys.modules[name] = None
import jaxbe, jaxbe.mjx, jaxbe.cli
try:
    jaxbe.cli.main(["--help"])
except SystemExit as stop:
    sys.exit(stop.code)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    for taught in ("exit status:", "examples:", "how states are drawn:"):
        assert taught in done.stdout


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"jaxbe {jaxbe.__version__}\n"


def test_the_module_runs_and_returns_its_status(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "jaxbe", str(tmp_path / "missing.xml")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("jaxbe: error: no such file")


def test_the_script_is_installed_where_the_package_is():
    try:
        importlib.metadata.distribution("jaxbe")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("jaxbe is not installed, only importable")
    (script,) = importlib.metadata.entry_points(group="console_scripts", name="jaxbe")
    assert script.load() is main


# Disagreement.


def test_a_wrong_test_is_found_and_reported(capsys, scene, monkeypatch):
    right = jaxbe.overlap

    def wrong(box, ellipsoid, *, method):
        answer = right(box, ellipsoid, method=method)
        return ~answer if method == "minkowski" else answer

    monkeypatch.setattr("jaxbe.cli.sweep.overlap", wrong)
    assert main([scene, *FEW]) == 1
    assert "between the three tests: 80 disagreements" in capsys.readouterr().out
    assert main([scene, *FEW, "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["agree"] is False
    between = report["between_methods"]
    assert between["beyond_rounding"] == between["differing"] == 80
    assert len(between["examples"]) == 80
    for conflict in between["examples"]:
        said = conflict["answers"]
        assert said["closest_features"] == said["all_features"] != said["minkowski"]


def test_differing_from_mujoco_is_found_and_reported(capsys, scene, monkeypatch):
    right = jaxbe.overlap
    monkeypatch.setattr(
        "jaxbe.cli.sweep.overlap", lambda b, e, method: ~right(b, e, method=method)
    )
    assert main([scene, *FEW, "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["between_methods"]["differing"] == 0
    disagreements = report["mujoco"]["disagreements"]
    assert len(disagreements) == report["mujoco"]["checked"] == 50
    for item in disagreements:
        is_apart = item["scaled_distance_float64"] > 1
        assert item["overlapping"] == is_apart == (item["mujoco_distance"] > 0)


def touching_model(gap):
    """A ball above a plate, `gap` metres from touching."""
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody><geom type="box" size="1 1 .1"/>
      <body pos="0 0 {0.3 + gap!r}"><freejoint/>
        <geom type="ellipsoid" size=".2 .2 .2"/></body>
    </worldbody></mujoco>""")


@pytest.mark.parametrize(("gap", "counted"), [(1e-4, 1), (-1e-4, 1), (1e-7, 0)])
def test_only_differences_beyond_the_tolerance_count(gap, counted):
    model = touching_model(gap)
    drawn = Drawn(
        key=np.zeros(1),
        state=np.zeros(1, int),
        pair=np.zeros(1, int),
        qpos=model.qpos0[None],
        overlapping=np.array([gap > 0]),  # wrong
        ratio=np.array([1 + gap / 0.2], np.float32),
    )
    data = mujoco.MjData(model)
    check = crosscheck(model, data, find_pairs(model), drawn)
    assert len(check.disagreements) == counted
    # Within its tolerance MuJoCo may give either answer.
    assert check.differing >= counted


def test_rounding_is_what_the_tests_promise():
    axes = np.array([[1, 1, 1], [40, 1, 1], [41, 1, 2], [1000, 1, 1], [1e4, 1, 1]])
    unit = np.ones_like(axes)
    float32 = ratio_rounding(unit, axes, "float32")
    np.testing.assert_allclose(float32, [1e-5, 1e-5, 1e-4, 1e-4, 1e-3])
    float64 = ratio_rounding(unit, axes, "float64")
    np.testing.assert_allclose(float64, [1e-12, 1e-12, 1e-10, 1e-10, 1e-9])


def test_rounding_grows_with_a_box_much_larger_than_the_ellipsoid():
    unit = np.ones((1, 3))
    np.testing.assert_allclose(ratio_rounding(1e4 * unit, unit, "float32"), 1e-3)


def test_rounding_in_metres_grows_with_the_distance_from_the_origin():
    unit = np.ones((1, 3))
    near, far = (
        rounding_in_metres(np.full((1, 2, 3), x), unit, unit, "float32")[0]
        for x in (0.0, 1e4)
    )
    assert 1e-5 < near < 1.1e-5
    assert 1e-3 < far < 1e-2


# The sample.


def offered(overlapping, ratio, size, batches=1):
    sample = Sample(size, seed=0)
    n = len(ratio) // batches
    for i in range(batches):
        part = slice(i * n, (i + 1) * n)
        qpos = np.arange(i * n, (i + 1) * n)[:, None]
        sample.add(i * n, qpos, overlapping[part], ratio[part])
    return sample.drawn()


@pytest.mark.parametrize("batches", [1, 5])
def test_a_sample_is_half_overlapping_and_prefers_near_pairs(batches):
    rng = np.random.default_rng(0)
    ratio = rng.uniform(0, 11, size=(1000, 3))
    overlapping = ratio <= 1
    drawn = offered(overlapping, ratio, 100, batches)
    assert len(drawn.state) == 100
    assert drawn.overlapping.sum() == 50
    np.testing.assert_array_equal(drawn.ratio, ratio[drawn.state, drawn.pair])
    np.testing.assert_array_equal(drawn.qpos[:, 0], drawn.state)
    assert len({*zip(drawn.state.tolist(), drawn.pair.tolist(), strict=True)}) == 100
    assert np.median(drawn.ratio[~drawn.overlapping]) < 3, "uniform would give 6"


@pytest.mark.parametrize("n_overlapping", [0, 3, 97, 100])
def test_if_one_half_is_short_the_other_fills_up(n_overlapping):
    ratio = np.where(np.arange(100) < n_overlapping, 0.5, 2.0)[:, None]
    drawn = offered(ratio <= 1, ratio, 20)
    assert len(drawn.state) == 20
    few = min(n_overlapping, 100 - n_overlapping, 10)
    assert min(drawn.overlapping.sum(), (~drawn.overlapping).sum()) == few


def test_a_sample_larger_than_everything_is_everything():
    ratio = np.linspace(0, 2, 12).reshape(6, 2)
    drawn = offered(ratio <= 1, ratio, 100)
    assert len(drawn.state) == 12


# Pictures.

NO_OPENGL = {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "none"}


def pixels(path):
    """The colours of a PNG, by matplotlib."""
    return pytest.importorskip("matplotlib.image").imread(path)[..., :3]


def share_of(image, color):
    """How much of an image has roughly the hue of a colour."""
    return np.mean(has_hue(image, color))


def has_hue(image, color):
    """Which pixels have roughly the hue of a colour."""
    hue = np.array(color) - np.mean(color)
    own = image - image.mean(axis=-1, keepdims=True)
    size = np.linalg.norm(own, axis=-1) * np.linalg.norm(hue)
    return (own @ hue > 0.9 * size) & (size > 0.15 * hue @ hue)


def draw(run_json, path, *arguments):
    report = run_json(*arguments, "--picture", str(path))
    image = pixels(path)
    assert image.shape == (720, 1440, 3)
    return report, image


def test_a_picture_plotted_without_opengl(run_json, scene, tmp_path, monkeypatch):
    for name, value in NO_OPENGL.items():
        monkeypatch.setenv(name, value)
    report, image = draw(run_json, tmp_path / "out.png", scene, *FEW)
    assert report["picture"]["drawn_by"] == "matplotlib"
    assert "MuJoCo could not render: egl: " in report["picture"]["why"]
    assert share_of(image, (1, 0.25, 0.1)) > 0.002
    assert share_of(image, (0.1, 0.45, 1)) > 0.01


def test_the_report_says_who_drew_and_why(capsys, scene, tmp_path, monkeypatch):
    for name, value in NO_OPENGL.items():
        monkeypatch.setenv(name, value)
    path = tmp_path / "out.png"
    assert main([scene, *FEW, "--picture", str(path)]) == 0
    assert "drawn by matplotlib (MuJoCo could not render" in capsys.readouterr().out


def test_a_picture_rendered_by_mujoco(run_json, tmp_path):
    """The pair is seen: ellipsoid and box have their colours in the close view."""
    report, image = draw(run_json, tmp_path / "out.png", *FEW)
    if not report["picture"]["drawn_by"].startswith("MuJoCo"):
        pytest.skip(report["picture"]["why"])
    close = image[:, 720:]
    assert share_of(close, (1, 0.25, 0.1)) > 0.01
    assert share_of(close, (0.1, 0.45, 1)) > 0.05
    assert image[:, :720].std() > 0.05, "the whole scene is not blank"


def test_the_nearest_miss_is_drawn_if_nothing_overlaps(
    capsys, scene, tmp_path, monkeypatch
):
    for name, value in NO_OPENGL.items():
        monkeypatch.setenv(name, value)
    states = save(tmp_path, np.array([[9.0, 0], [1.0, 0], [5.0, 0]]))
    path = tmp_path / "out.png"
    assert main([scene, "--qpos", states, "--picture", str(path)]) == 0
    out = capsys.readouterr().out
    assert "nothing overlaps; nearest by margin: state 1, " in out
    assert pixels(path).std() > 0.05


def test_the_renderer_is_given_up_after_a_while(run_json, scene, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(picture, "RENDER_SECONDS", 0.01)
    report, _ = draw(run_json, tmp_path / "out.png", scene, *FEW)
    assert report["picture"]["drawn_by"] == "matplotlib"
    assert "egl: no answer in 0.01 s" in report["picture"]["why"]


def test_without_opengl_and_matplotlib_the_report_comes_and_then_one_line(
    capsys, scene, tmp_path, monkeypatch
):
    for name, value in NO_OPENGL.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.delitem(sys.modules, "jaxbe.viz.plot", raising=False)
    path = tmp_path / "out.png"
    assert main([scene, *FEW, "--json", "--picture", str(path)]) == 2
    out, err = capsys.readouterr()
    assert json.loads(out)["picture"] is None
    assert err.count("\n") == 1
    assert "pip install 'jaxbe[viz]'" in err
    assert not path.exists()


@pytest.mark.parametrize(
    ("setting", "expected"), [("osmesa", ["osmesa"]), (None, ["egl", "osmesa"])]
)
def test_the_users_own_setting_of_opengl_is_respected(monkeypatch, setting, expected):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    if setting is not None:
        monkeypatch.setenv("MUJOCO_GL", setting)
    assert picture._backends() == expected


@pytest.mark.slow
def test_a_broken_setting_of_opengl_does_not_stop_the_tests(scene):
    done = subprocess.run(
        [sys.executable, "-m", "jaxbe", scene, *FEW],
        env=os.environ | {"MUJOCO_GL": "nonsense"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_checking_a_path_leaves_files_as_they_are(tmp_path):
    new, old = tmp_path / "new.png", tmp_path / "old.png"
    old.write_text("kept")
    check_writable(new)
    check_writable(old)
    assert not new.exists()
    assert old.read_text() == "kept"


def test_png_is_what_was_encoded(tmp_path):
    from jaxbe.viz.offscreen import png

    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    encoded = png(image)
    (tmp_path / "x.png").write_bytes(encoded)
    np.testing.assert_array_equal(
        np.round(pixels(tmp_path / "x.png") * 255).astype(np.uint8), image
    )
    assert struct.unpack(">2I", encoded[16:24]) == (7, 5)
    assert zlib.crc32(b"IEND").to_bytes(4, "big") == encoded[-4:]


def test_every_scene_that_ships_is_a_model_with_pairs():
    scenes = list(Path(DEFAULT_SCENE).parent.glob("*.xml"))
    assert DEFAULT_SCENE in scenes
    for path in scenes:
        assert len(find_pairs(mujoco.MjModel.from_xml_path(str(path))))
