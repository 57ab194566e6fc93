"""Short forms of the margin's benchmarks; their timings are never tested."""

import json
import runpy
import sys

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import (
    margin_continuity,
    margin_knob,
    margin_one_core,
    margin_scenes,
    margin_speed,
    margin_speed_report,
    one_sided,
    reference,
    scenes,
)
from jaxbe.growth import MAX_STEPS

pytestmark = pytest.mark.bulk


def run(main, folder, *options, figure=False):
    """Runs a benchmark; returns its report, its numbers and its picture."""
    files = {"json": folder / "a.json", "markdown": folder / "a.md"}
    if figure:
        files["figure"] = folder / "a.png"
    main([*options, *(f"--{name}={file}" for name, file in files.items())])
    numbers = json.loads(files["json"].read_text())
    return files["markdown"].read_text(), numbers, files.get("figure")


def check_picture(file, colors=50):
    """A picture that is neither blank nor a frame without content."""
    pixels = pytest.importorskip("matplotlib.image").imread(file)
    assert len(np.unique((255 * pixels).astype(int).reshape(-1, 4), axis=0)) > colors


@pytest.mark.parametrize("kind", margin_scenes.KINDS)
def test_scenes_are_legal_and_meet_both_verdicts(kind):
    pairs = margin_scenes.KINDS[kind](300, 1)
    jaxbe.Box(*pairs[:3])
    jaxbe.Ellipsoid(*pairs[3:])
    truth = margin_scenes.truth(pairs)
    assert 30 < np.sum(truth <= 0) < 270
    growth = reference.growth_by_bisection(pairs).astype(np.float64)
    np.testing.assert_allclose(truth + 1, growth, rtol=1e-12)


def test_needles_have_one_long_axis_and_plates_two():
    for scene, long_axes in ((margin_scenes.needles, 1), (margin_scenes.plates, 2)):
        pairs = scene(50, 0)
        for lengths in (pairs.e, pairs.a):
            long = lengths >= margin_scenes.LONG[0]
            assert np.all(np.sum(long, axis=1) == long_axes)


def test_near_touching_moves_to_the_growth_wanted():
    wanted = np.linspace(0.9, 1.1, 200)
    pairs = margin_scenes.near_touching(scenes.random(200, seed=2), wanted)
    np.testing.assert_allclose(margin_scenes.truth(pairs) + 1, wanted, rtol=1e-12)


@pytest.mark.slow
def test_knob_writes_every_scene_dtype_and_step(tmp_path, capsys):
    sizes = ("--pairs=300", "--checked=100", "--repeats=1")
    text, numbers, figure = run(margin_knob.main, tmp_path, *sizes, figure=True)
    assert text == capsys.readouterr().out
    labels = [(e["scene"], e["dtype"], e["steps"]) for e in numbers["errors"]]
    assert labels == [
        (kind, dtype, steps)
        for kind in margin_scenes.KINDS
        for dtype in ("float32", "float64")
        for steps in range(MAX_STEPS + 1)
    ]
    assert all(e["reference_differs"] < 1e-8 for e in numbers["errors"])
    assert all(e["largest_false_margin"] < 1e-5 for e in numbers["errors"])
    last = [e["error"]["max"] for e in numbers["errors"] if e["steps"] == MAX_STEPS]
    assert max(last) < 1e-4
    assert len(numbers["rates"]) == 2 * (MAX_STEPS + 1)
    check_picture(figure)


@pytest.fixture(scope="module")
def one_core():
    return margin_speed.one_core(pairs=200, coal_pairs=20, repeats=1)


def test_one_core_child_measures_with_or_without_coal(one_core):
    assert one_core["cores"] == 1
    assert one_core["largest_error"] <= margin_one_core.TOLERANCE
    assert one_core["pairs_per_second"]["margin"] > 0
    assert one_core.get("coal_disagrees", 0) == 0


def test_coal_missing_is_said(monkeypatch, one_core):
    monkeypatch.setitem(sys.modules, "coal", None)
    assert margin_one_core.coal_loops(scenes.random(2)) == {}
    rates = {"margin": one_core["pairs_per_second"]["margin"]}
    text = margin_speed_report._one_core(one_core | {"pairs_per_second": rates})
    assert "coal is not installed" in text


@pytest.mark.slow
def test_speed_writes_programs_and_targets(tmp_path, monkeypatch, capsys, one_core):
    # Neither the allocator of this process nor minutes of compiling.
    monkeypatch.setattr(margin_speed, "keep_freed_memory", lambda: True)
    monkeypatch.setattr(margin_speed, "one_core", lambda *_: one_core)
    compile_seconds = dict.fromkeys(margin_speed_report.COMPILE_LIMITS, 1.0)
    monkeypatch.setattr(margin_speed, "compile_times", lambda _: compile_seconds)
    sizes = ("--pairs=100", "--coal-pairs=10", "--repeats=1")
    text, numbers, _ = run(margin_speed.main, tmp_path, *sizes)
    assert text == capsys.readouterr().out
    assert set(numbers["float32"]["programs"]) == set(margin_speed.programs(1))
    assert len(numbers["float32"]["passes"]) == 2
    assert text.count("at least") + text.count("at most") > 10


def test_plain_autodiff_is_the_gradient_of_the_squared_distance():
    pairs = scenes.random(500, seed=3)
    q = reference.scaled_distance(pairs) ** 2
    np.testing.assert_allclose(
        jax.vmap(margin_speed.naive_minimum)(*pairs.bodies()), q, rtol=1e-8, atol=1e-12
    )


@pytest.mark.slow
def test_one_sided_finds_no_dropped_pair(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(one_sided, "CHUNK", 400)
    text, numbers, _ = run(one_sided.main, tmp_path, "--pairs=3000")
    assert text == capsys.readouterr().out
    assert [band["band"] for band in numbers["bands"]] == ["to 40", "to 1000", "to 1e5"]
    for band in numbers["bands"]:
        assert sum(band["count"].values()) == 1000
        assert len(band["steps"]) == MAX_STEPS + 1
        assert not any(found["count"]["dropped"] for found in band["steps"])


@pytest.mark.slow
def test_continuity_meets_all_contacts_and_falls_linearly(tmp_path, capsys):
    sizes = ("--paths=2", "--finest=10")
    text, numbers, figure = run(margin_continuity.main, tmp_path, *sizes, figure=True)
    assert text == capsys.readouterr().out
    features = {c for crossed in numbers["contacts"].values() for c in crossed}
    assert features == {"face", "edge", "vertex"}
    assert numbers["slopes"]["margin"] == pytest.approx(1, abs=0.05)
    assert numbers["slopes"]["sqrt(q)"] < 0.5
    check_picture(figure)


def test_level_curves_example_draws(tmp_path, monkeypatch):
    file = tmp_path / "a.png"
    arguments = ["margin_level_curves.py", f"--output={file}", "--resolution=60"]
    monkeypatch.setattr(sys, "argv", arguments)
    runpy.run_path("examples/margin_level_curves.py", run_name="__main__")
    check_picture(file)
