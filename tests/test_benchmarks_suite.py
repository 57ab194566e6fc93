"""The suite's own parts in short: settings, accuracy, limit, frontier, one command."""

import importlib
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

import jaxbe
from benchmarks import __main__ as suite
from benchmarks import (
    accuracy,
    certificates,
    distances,
    everyday,
    frontier,
    frontier_report,
    growth,
    limit,
    limitations,
    machine,
    report,
    scenes,
    settings,
)
from jaxbe import plan_errors
from tests.test_benchmarks_margin import check_picture

FEW = tuple(
    s
    for s in settings.SETTINGS
    if s.name in ("overlap, minkowski", "margin, 0 steps", "margin, 1 step")
)


@pytest.fixture
def few(monkeypatch):
    """Three settings, one kind of scene, and no truths that take long to compile."""
    monkeypatch.setattr(settings, "JUDGED", FEW)
    monkeypatch.setattr(accuracy, "MOST", {})
    monkeypatch.setattr(accuracy, "_distance", lambda scene: np.zeros(scene.size))
    kinds = {k: accuracy.KINDS[k] for k in ("spheres", "random to 4", "random to 40")}
    monkeypatch.setattr(accuracy, "KINDS", kinds)


def measured(main, folder, *options):
    files = {"json": folder / "a.json", "markdown": folder / "a.md"}
    main([*options, *(f"--{k}={v}" for k, v in files.items())])
    return files["json"], files["markdown"].read_text()


def fake_throughput(folder):
    """As `benchmarks.throughput` writes it: each setting half as fast as the last."""
    programs = [
        {
            "setting": s.name,
            "dtype": dtype,
            "layout": "vmap",
            "pairs_per_second": 1e8 / 2**i / (1 + (dtype == "float64")),
            "read_and_written_per_pair": 124.0,
            "operations_per_pair": 500.0,
        }
        for i, s in enumerate(FEW)
        for dtype in settings.DTYPES
    ]
    machine = {"processor": "P", "cores": 2, "device": "cpu", "jax": "0"}
    file = folder / "throughput.json"
    text = json.dumps({"machine": machine, "throughput": {"programs": programs}})
    file.write_text(text)
    return file


def test_names_are_unique_and_every_function_is_measured():
    assert len(settings.named()) == len(settings.SETTINGS)
    assert {s.function for s in settings.SETTINGS} == set(settings.FUNCTIONS)
    assert sum(s.is_default for s in settings.SETTINGS) == 10
    for setting in settings.JUDGED:
        assert set(setting.answers) <= set(settings.ANSWERS)


def test_accuracy_counts_what_is_wrong(few, tmp_path):
    file, text = measured(accuracy.main, tmp_path, "--pairs=400")
    errors = json.loads(file.read_text())["errors"]
    assert len(errors) == 3 * 2 * (1 + 2 + 2)
    for e in errors:
        assert e["setting"] in text
        if e["answer"] == "verdict":
            assert e["missed"] == 0
            if e["setting"] == "overlap, minkowski":
                assert e["false_overlap"] == 0
    worst = {
        (e["setting"], e["scene"], e["dtype"]): e["error"]["max"]
        for e in errors
        if e["answer"] == "margin"
    }
    for (name, scene, dtype), error in worst.items():
        if name == "margin, 1 step":
            assert 0 < error < worst["margin, 0 steps", scene, dtype]


def test_gradients_of_errors_count_lengths_in_units_of_the_longest():
    """So that a scene of another size has the same errors."""
    small = scenes.random(50).astype(np.float64)
    setting = settings.Setting("margin", ("steps", 1), gradients=True)
    values = [
        plan_errors.flat_gradient(
            settings.under_vmap(setting)(*s.bodies())[1],
            plan_errors.longest_length(s.e, s.a),
        )
        for s in (small, scenes.scaled(small, 1024.0))
    ]
    assert values[0].shape == (50, 30)
    np.testing.assert_allclose(*values, rtol=1e-12)


def test_the_frontier_is_what_nothing_beats(few, tmp_path):
    file, _ = measured(accuracy.main, tmp_path, "--pairs=200")
    throughput = fake_throughput(tmp_path)
    accuracy_file = file.rename(tmp_path / "accuracy.json")
    table = tmp_path / "table.json"
    _, text = measured(
        frontier.main,
        tmp_path,
        *(f"--throughput={throughput}", f"--accuracy={accuracy_file}"),
        f"--table={table}",
    )
    assert "## Random to 40" in text
    points = json.loads((tmp_path / "a.json").read_text())["points"]
    for p in points:
        rivals = [
            r for r in points if (r["scene"], r["answer"]) == (p["scene"], p["answer"])
        ]
        better = [
            r
            for r in rivals
            if r["rate"] >= p["rate"]
            and r["error"] <= p["error"]
            and (r["rate"], r["error"]) != (p["rate"], p["error"])
        ]
        assert p["on_front"] is not bool(better)
    written = json.loads(table.read_text())
    assert written["spreads"] == sorted(written["spreads"])
    assert len(written["spreads"]) == 2
    rows = [r for r in written["settings"] if r["function"] == "margin"]
    assert len(rows) == 4
    for row in rows:
        assert np.shape(row["errors"]["margin"]) == (2, 3)
        assert np.all(np.diff(row["errors"]["margin"], axis=0) >= 0)
        assert len(row["errors_of_spheres"]["margin"]) == 1


def test_frontiers_are_drawn(tmp_path):
    rng = np.random.default_rng(0)
    points = [
        {
            "scene": "random to 40",
            "answer": answer,
            "setting": s.name,
            "dtype": dtype,
            "rate": float(rng.uniform(1e6, 1e8)),
            "error": float(10 ** rng.uniform(-8, 0)),
            "on_front": bool(rng.random() < 0.5),
        }
        for s in settings.JUDGED
        for answer in s.answers
        for dtype in settings.DTYPES
    ]
    machine = {"processor": "P", "cores": 2, "jax": "0"}
    numbers = {"points": points, "pairs": 100, "machine": machine}
    (file,) = frontier_report.draw(numbers, tmp_path / "frontier")
    assert file.name == "frontier-random-to-40.png"
    check_picture(file)


@pytest.mark.parametrize("part", [certificates, distances, everyday])
def test_reports_are_of_their_numbers(part):
    name = part.__name__.rpartition(".")[2]
    files = (suite.RESULTS / f"{name}-cpu.{kind}" for kind in ("json", "md"))
    numbers, report_written = (file.read_text() for file in files)
    assert part.text(json.loads(numbers)) in report_written


def test_everyday_has_the_largest_error_of_each_kind(few, monkeypatch, tmp_path):
    monkeypatch.setattr(everyday, "JUDGED", {FEW[2]: settings.MARGIN})
    kinds = {k: everyday.KINDS[k] for k in ("random", "lattice-of-balls")}
    monkeypatch.setattr(everyday, "KINDS", kinds)
    file, text = measured(everyday.main, tmp_path, "--pairs=200")
    errors = json.loads(file.read_text())["errors"]
    assert [(e["scene"], e["dtype"]) for e in errors] == [
        (kind, dtype) for kind in kinds for dtype in settings.DTYPES
    ]
    for e in errors:
        assert e["scene"] in text
        assert 0 < e["contract, apart"] <= (1e-14 if e["dtype"] == "float64" else 3e-6)
        assert e["margin"] > 1e-3  # One step is not enough.


def test_certificates_of_few_pairs(monkeypatch, tmp_path):
    monkeypatch.setattr(certificates, "LOWS", {"to 40": 0.05})
    file, text = measured(certificates.main, tmp_path, "--pairs=40")
    numbers = json.loads(file.read_text())
    assert [row["false"] for row in numbers["rows"]] == [0, 0]
    assert numbers["command"] in text


def test_limit_gives_rates_and_shares(tmp_path, monkeypatch):
    monkeypatch.setattr(limit, "BYTES", 8000)
    monkeypatch.setattr(limit.throughput, "COPY_BYTES", 8000)
    monkeypatch.setattr(limit, "NUMBERS", 100)
    throughput = fake_throughput(tmp_path)
    file, text = measured(
        limit.main, tmp_path, "--repeats=1", f"--throughput={throughput}"
    )
    numbers = json.loads(file.read_text())
    for rates in numbers["rates"].values():
        assert {"copy", "read", *limit.OPERATIONS} < set(rates)
        assert all(np.isfinite(list(rates.values())))
    first, *_ = numbers["shares"]
    copy = numbers["rates"]["float32"]["copy"]
    assert first["bandwidth"] == pytest.approx(124 * 1e8 / copy)
    assert "multiply and add" in text


def test_chains_are_not_folded_away():
    """What XLA would simplify would look infinitely fast."""
    for name, (count, _) in limit.OPERATIONS.items():
        x = np.ones(10, np.float32)
        compiled = limit.chain(name).lower(x, x).compile()
        cost = compiled.cost_analysis()
        done = cost["flops"] + cost.get("transcendentals", 0)
        assert done >= 0.9 * count * limit.CHAIN * 10, name


@pytest.mark.parametrize("name", suite.PARTS)
def test_every_part_is_a_module_that_knows_its_options(name, tmp_path):
    words = suite.command(name, tmp_path, suite.PARTS[name].has_quick, "cpu")
    module = importlib.import_module(words[2])
    if hasattr(module, "parse"):
        module.parse(words[3:])
    source = Path(module.__file__).read_text() + Path(report.__file__).read_text()
    for word in (w for w in words if w.startswith("--")):
        assert f'"{word}"' in source or "--{name}" in source
    assert {"--json", "--markdown"} < set(words)


def test_parts_that_need_a_failed_one_are_left_out(tmp_path, monkeypatch, capsys):
    ran = []

    def run(words, **_):
        ran.append(words[2])
        return subprocess.CompletedProcess(words, returncode=1)

    monkeypatch.setattr(suite.subprocess, "run", run)
    monkeypatch.setattr(suite, "device", lambda: "cpu")
    parts = ["throughput", "frontier", "plan", "accuracy"]
    assert suite.main([*parts, f"--folder={tmp_path}"]) == 4
    assert ran == ["benchmarks.throughput", "benchmarks.accuracy"]
    assert "left out: a part that it needs has failed" in capsys.readouterr().err


def test_the_plan_s_table_is_of_the_results_in_the_repository():
    folder = suite.RESULTS
    accuracy_numbers = json.loads((folder / "accuracy-cpu.json").read_text())
    throughput_numbers = json.loads((folder / "throughput-cpu.json").read_text())
    expected = frontier.table(throughput_numbers, accuracy_numbers)
    assert json.loads(suite.PLAN_TABLE.read_text()) == expected


def test_the_plan_s_table_is_written_by_full_runs_on_a_cpu_only(tmp_path):
    words = suite.command("frontier", suite.RESULTS, False, "cpu")
    assert str(suite.PLAN_TABLE) in words
    for folder, label in ((tmp_path, "cpu"), (suite.RESULTS, "nvidia-h100")):
        assert str(suite.PLAN_TABLE) not in suite.command(
            "frontier", folder, False, label
        )


def test_a_look_is_no_result(capsys):
    with pytest.raises(SystemExit):
        suite.parse(["--quick"])
    assert "--quick is no result" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        suite.parse(["throughputs"])
    assert "no such part: throughputs" in capsys.readouterr().err


def test_growth_compares_the_cost_of_a_pair():
    def point(pairs, nanoseconds):
        seconds = {"median": pairs * nanoseconds * 1e-9}
        return {
            "pairs": pairs,
            "setting": "overlap",
            "seconds": seconds,
            "cores_busy_with_others": 0.1,
        }

    points = [point(n, c) for n, c in zip(growth.SIZES, (11, 9, 10, 13), strict=True)]
    costs = growth.costs_of("overlap", points)
    assert costs[10**4] == pytest.approx(11)
    assert growth.furthest(costs) == pytest.approx(0.3)
    text = growth.text({"machine": machine.describe(), "passes": {"kept": points}})
    assert "30 %" in text
    assert "| no" in text.replace("  ", " ")


def test_limitations_in_short(tmp_path, monkeypatch):
    monkeypatch.setattr(limitations, "EXPRESSIONS", (1, 2))
    monkeypatch.setattr(limitations, "FUNCTIONS", {"overlap": jaxbe.overlap})
    monkeypatch.setattr(limitations, "DISTANCES", (jaxbe.margin,))
    file, text = measured(limitations.main, tmp_path, "--pairs=200", "--repeats=3")
    numbers = json.loads(file.read_text())
    assert numbers["furthest"]["margin"] > 1e9
    assert (
        numbers["expressions"][0]["operations"]
        < numbers["expressions"][1]["operations"]
    )
    assert "Finite up to" in text
