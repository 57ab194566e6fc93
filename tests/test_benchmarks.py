import json
from typing import NamedTuple

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import (
    machine,
    naive,
    paper,
    published,
    reference,
    report,
    scenes,
    settings,
    throughput,
    timing,
)

CLOSEST, ALL = paper.closest_features, paper.all_features


def fixed_minkowski(B, E):
    return paper.minkowski(B, E, fix_cylinders=True)


class Counterexample(NamedTuple):
    """A box at the origin with axes I, and what is wrong there."""

    erratum: str
    test: object
    e: tuple
    K: tuple
    a: tuple
    squared_distance: float
    axes: tuple = ((1, 0, 0), (0, 1, 0), (0, 0, 1))

    @property
    def pairs(self):
        fields = ((0, 0, 0), np.eye(3), self.e, self.K, np.transpose(self.axes), self.a)
        return scenes.Scene(*(np.array([x], np.float64) for x in fields))


ONE = (1, 1, 1)
PERMUTED = ((0, 1, 0), (0, 0, 1), (1, 0, 0))
TILTED = ((1 / 3, 2 / 3, -2 / 3), (2 / 3, -2 / 3, -1 / 3), (-2 / 3, -1 / 3, -2 / 3))
TILTED_2 = ((2 / 3, -2 / 3, 1 / 3), (2 / 3, 1 / 3, -2 / 3), (1 / 3, 2 / 3, 2 / 3))
ONE_FACE = ((0, 0, -1), (-4 / 5, -3 / 5, 0), (-3 / 5, 4 / 5, 0))
TWO_FACES = ((3 / 5, 0, -4 / 5), (0, -1, 0), (-4 / 5, 0, -3 / 5))
THREE_FACES = ((2 / 3, 2 / 3, -1 / 3), (-2 / 3, 1 / 3, -2 / 3), (-1 / 3, 2 / 3, 2 / 3))
CORNER = (7 / 4, 7 / 4, 7 / 4)

COUNTEREXAMPLES = [
    Counterexample("M1", ALL, ONE, (3, 1, 1), ONE, 4),
    Counterexample("M1", CLOSEST, ONE, (1, 5 / 2, 3 / 2), ONE, 5 / 2),
    Counterexample("M2", ALL, ONE, (1, 0, 3), ONE, 4),
    Counterexample("M2", ALL, ONE, (1, 0, 100), ONE, 9801),
    Counterexample("M2", CLOSEST, ONE, (3 / 2, 0, 3), ONE, 17 / 4),
    Counterexample("M2", ALL, ONE, CORNER, ONE, 27 / 16),
    Counterexample("M2", CLOSEST, ONE, CORNER, ONE, 27 / 16),
    Counterexample("M4", paper.minkowski, ONE, (3 / 2, 3 / 2, 0), ONE, 1 / 2, PERMUTED),
    Counterexample(
        "M4", paper.minkowski, ONE, (9 / 5, 9 / 5, 4 / 5), ONE, 32 / 25, PERMUTED
    ),
    Counterexample(
        "M4",
        paper.minkowski,
        (1 / 2, 1, 1),
        (-1, -2, 0),
        (1, 2, 2),
        5 / 16,
        ((0, 0, 1), (0, -1, 0), (1, 0, 0)),
    ),
    Counterexample(
        "M4", paper.minkowski, ONE, (0, 3, 0), (1, 5, 3), 766 / 2025, TILTED
    ),
    Counterexample("M4", paper.minkowski, ONE, (2, 0, -2), (2, 1, 2), 3 / 2, TILTED_2),
    Counterexample(
        "M5", fixed_minkowski, ONE, (1 / 4, -4, 1 / 4), (1, 1, 4), 1613 / 1280, ONE_FACE
    ),
    Counterexample(
        "M5", fixed_minkowski, ONE, (1, 2, 5), (1, 4, 8), 69 / 16, TWO_FACES
    ),
    Counterexample(
        "M5", fixed_minkowski, ONE, (-2, -3, 3), (6, 1 / 3, 1), 71 / 59, THREE_FACES
    ),
]


@pytest.mark.parametrize("case", COUNTEREXAMPLES)
def test_published_tests_give_the_wrong_answers_listed(case):
    overlapping = case.squared_distance <= 1
    assert reference.scaled_distance(case.pairs) ** 2 == pytest.approx(
        case.squared_distance, rel=1e-13
    )
    assert bool(case.test(*paper.bodies(case.pairs))[0]) is not overlapping
    for method in jaxbe.METHODS:
        verdict = jaxbe.overlap(*case.pairs.bodies(), method=method)
        assert bool(verdict[0]) is overlapping


def test_published_table_row_is_chosen_by_the_visible_faces():
    for row, (normal, vertex) in enumerate(paper.QUERY):
        select = (row // 9, row // 3 % 3, row % 3)
        assert normal == tuple(i for i in range(3) if select[i] != 1)
        on_faces = {
            v for v in range(8) if any((v >> i & 1) == select[i] // 2 for i in normal)
        }
        assert set(vertex) == on_faces
        if normal:
            edges = {
                frozenset((vertex[i], vertex[j]))
                for i, j in paper.EDGES_OF_FACES[len(normal)]
            }
            assert edges == {
                frozenset((v, w))
                for v in on_faces
                for w in on_faces
                if (v ^ w).bit_count() == 1
                and any((v >> i & 1) == (w >> i & 1) == select[i] // 2 for i in normal)
            }


def test_scenes_are_reproducible_and_legal():
    pairs = scenes.random(500, seed=3)
    again = scenes.random(500, seed=3)
    assert pairs.size == 500
    assert all(map(np.array_equal, pairs, again))
    jaxbe.Box(*pairs[:3])
    jaxbe.Ellipsoid(*pairs[3:])
    assert pairs.part(slice(10, 30)).size == 20
    assert scenes.random(2).astype(np.float32).a.dtype == np.float32


def test_truth_agrees_with_scaled_distance():
    pairs = scenes.random(2000, seed=4)
    expected = np.asarray(jaxbe.scaled_distance(*pairs.bodies()))
    np.testing.assert_allclose(reference.scaled_distance(pairs), expected, rtol=1e-9)


def test_naive_yardstick_is_right():
    pairs = scenes.random(2000, seed=5)
    verdicts = jax.vmap(naive.overlap)(*pairs.bodies())
    np.testing.assert_array_equal(verdicts, reference.scaled_distance(pairs) <= 1)


def test_published_counts_and_writes(tmp_path, capsys):
    files = {"json": tmp_path / "a.json", "markdown": tmp_path / "a.md"}
    arguments = ["--pairs", "3000", *(f"--{k}={v}" for k, v in files.items())]
    published.main(arguments)
    assert files["markdown"].read_text() == capsys.readouterr().out
    numbers = json.loads(files["json"].read_text())
    band = numbers["bands"]["all"]
    assert band["separated"] + band["overlapping"] + numbers["left_out"] == 3000
    wrong = {
        test: (band["false_positives"][test] > 0, band["false_negatives"][test] > 0)
        for test in published.TESTS
    }
    assert wrong == {
        "All-Features, published": (True, False),
        "Closest-Features, published": (True, False),
        "Minkowski, published": (True, True),
        "Minkowski, published, cylinders fixed": (True, False),
        **{f"jaxbe {method}": (False, False) for method in jaxbe.METHODS},
    }


def test_published_counts_do_not_depend_on_chunks(monkeypatch):
    pairs = scenes.random(300, seed=6)
    whole = published.count(pairs)
    monkeypatch.setattr(published, "CHUNK", 130)
    ticks = []
    assert published.count_in_chunks(pairs, lambda: ticks.append(0)) == whole
    assert len(ticks) == 3


GRADIENTS = "margin and gradients, 5 steps"


@pytest.mark.slow
@pytest.mark.bulk
def test_throughput_writes_every_program(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(throughput, "COPY_BYTES", 8_000)
    few = tuple(s for s in throughput.GROWN if s.function in ("overlap", "margin"))
    monkeypatch.setattr(settings, "SETTINGS", few)
    monkeypatch.setattr(throughput, "GROWN", few)
    files = {k: tmp_path / f"a.{k}" for k in ("json", "markdown", "figure")}
    files["figure"] = tmp_path / "a.png"
    sizes = ["--pairs=50", "--largest=100", "--repeats=2"]
    throughput.main([*sizes, *(f"--{k}={v}" for k, v in files.items())])
    assert files["markdown"].read_text() == capsys.readouterr().out
    assert files["figure"].read_bytes().startswith(b"\x89PNG")
    numbers = json.loads(files["json"].read_text())
    programs = numbers["throughput"]["programs"]
    names = [s.name for s in few]
    assert names == ["overlap, closest_features", "margin, 5 steps", GRADIENTS]
    assert [(p["setting"], p["layout"]) for p in programs] == 2 * [
        *((name, layout) for name in names for layout in ("vmap", "components")),
        ("naive", "vmap"),
    ]
    assert all(p["pairs_per_second"] > 0 for p in programs)
    overlaps = [p for p in programs if p["setting"] == names[0]]
    assert not any(p["wrong_verdicts"] for p in overlaps if p["dtype"] == "float64")
    batches = [(p["pairs"], p["setting"]) for p in numbers["growth"]]
    assert batches == [(n, name) for n in (1, 10, 100) for name in names]


def test_quick_limits_the_sizes():
    options = throughput.parse(["--quick", "--repeats=3"])
    assert (options.pairs, options.largest, options.repeats) == (100_000, 100_000, 3)


class FakeLoad:
    """The cores that other processes keep busy, round by round."""

    values = ()

    def cores(self):
        FakeLoad.values, first = FakeLoad.values[1:], FakeLoad.values[0]
        return first


@pytest.fixture
def load(monkeypatch):
    monkeypatch.setattr(machine, "OtherLoad", FakeLoad)
    return lambda *values: monkeypatch.setattr(FakeLoad, "values", values)


def test_disturbed_rounds_are_repeated(load):
    load(0.0, 1.0, 0.05)
    measurement = timing.interleaved({"a": timing.Task(lambda: None)}, repeats=2)
    assert measurement[1:] == (3, 0.05)


def test_patience_ends_and_the_quietest_rounds_count(load, monkeypatch):
    monkeypatch.setattr(timing, "PATIENCE", 2)
    load(0.0, 2.0, 0.5, 1.0)
    measurement = timing.interleaved({"a": timing.Task(lambda: None)}, repeats=2)
    assert measurement[1:] == (4, 0.5)


def test_interleaved_runs_each_task_once_a_round(load):
    load(*[0.0] * 4)
    calls = []
    tasks = {name: timing.Task(lambda n=name: calls.append(n)) for name in "abc"}
    times = timing.interleaved(tasks, repeats=4).times
    assert list(times) == ["a", "b", "c"]
    rounds = [calls[i : i + 3] for i in range(0, len(calls), 3)]
    assert len(rounds) == 5
    assert all(sorted(r) == ["a", "b", "c"] for r in rounds)


def test_table_aligns_numbers_to_the_right():
    assert report.table(("name", "n"), [("a", "1"), ("bb", "20")]).splitlines() == [
        "| name |  n |",
        "| ---- | -: |",
        "| a    |  1 |",
        "| bb   | 20 |",
    ]


def test_on_an_accelerator_its_own_copy_is_the_yardstick(monkeypatch):
    monkeypatch.setattr(throughput, "on_accelerator", lambda: True)
    monkeypatch.setattr(throughput, "COPY_BYTES", 8_000)
    monkeypatch.setattr(throughput, "QUEUE_SECONDS", 0)
    copies = throughput.copies()
    assert list(copies) == ["numpy", "device"]
    assert copies["device"].pipelined
    assert copies["device"].call().nbytes == 8_000
