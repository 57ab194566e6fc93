"""The peers' benchmarks: scenes, judges, and that no peer's absence stops them."""

import functools
import importlib
import json
import re

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import (
    against_c,
    c_loop,
    layouts,
    peer_adapters,
    peer_scenes,
    peer_verdicts,
    peers,
    reference,
    scenes,
)
from benchmarks.peer_adapters import Adapter, Answer, Peer
from tests import oracle, truth


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    try:
        return c_loop.build(tmp_path_factory.mktemp("loop"))
    except c_loop.BuildError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("n", [1, 17, 5000])
def test_c_loop_agrees_with_the_reference(loop, n, threads):
    pairs = scenes.random(n, seed=60).astype(np.float32)
    arrays = [np.asarray(x) for x in layouts.component_arrays(pairs)]
    expected = reference.scaled_distance(pairs) <= 1
    np.testing.assert_array_equal(loop(arrays, threads), expected)


def test_c_loop_leaves_denormal_numbers_as_they_are(loop):
    assert np.float32(1e-40) * np.float32(1) > 0


def against_c_numbers(tmp_path, monkeypatch):
    """A short run on `overlap` alone."""
    functions = {"overlap": against_c.FUNCTIONS["overlap"]}
    monkeypatch.setattr(against_c, "FUNCTIONS", functions)
    monkeypatch.setattr(against_c, "keep_freed_memory", lambda: False)
    files = tmp_path / "a.json", tmp_path / "a.md"
    against_c.main(
        ["--pairs=500", "--repeats=1", f"--json={files[0]}", f"--markdown={files[1]}"]
    )
    return json.loads(files[0].read_text()), files[1].read_text()


def test_shares_of_the_c_loop(loop, tmp_path, monkeypatch):
    numbers, text = against_c_numbers(tmp_path, monkeypatch)
    assert numbers["c_loop"]["wrong_verdicts"] == 0
    measured = numbers["passes"][against_c.AS_IT_COMES]
    yardstick = measured["pairs_per_second"][against_c.c_name(numbers["threads"])]
    for name, rate in measured["pairs_per_second"].items():
        assert measured["share_of_c_loop"][name] == pytest.approx(rate / yardstick)
    assert re.search(r"\| overlap, components +\| +0\.50 \|", text)


def test_without_a_compiler_the_rest_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(c_loop.shutil, "which", lambda name: None)
    numbers, text = against_c_numbers(tmp_path, monkeypatch)
    assert "The C loop is left out: no compiler: none of cc, gcc, clang" in text
    measured = numbers["passes"][against_c.AS_IT_COMES]
    rows = ("overlap, components", "overlap, vmap", "overlap, vmap, 512 bits")
    assert set(measured["pairs_per_second"]) == set(rows)
    assert measured["share_of_c_loop"] == {}


def test_a_compiler_that_fails_is_told_apart(tmp_path):
    source = tmp_path / "wrong.c"
    source.write_text("this is not C")
    try:
        compiler = c_loop.compiler()
    except c_loop.BuildError as error:
        pytest.skip(str(error))
    with pytest.raises(c_loop.BuildError, match="failed"):
        c_loop.shared_library(source, tmp_path, c_loop.FLAGS, compiler)


def test_both_layouts_give_the_same(dtype):
    pairs = scenes.random(40, seed=61).astype(dtype)
    results = {}

    def function(box, ellipsoid):
        offset = ellipsoid.center - box.center
        return jaxbe.scaled_distance(box, ellipsoid), offset

    for layout, (program, arguments) in layouts.programs(function, pairs).items():
        results[layout] = jax.tree.leaves(program(*arguments))
    for turned, plain in zip(results["components"], results["vmap"], strict=True):
        batch_first = np.moveaxis(np.asarray(turned), -1, 0)
        np.testing.assert_allclose(batch_first, plain, rtol=1e-5)


@pytest.mark.parametrize("feature", peer_scenes.DIRECTIONS)
def test_touching_pairs_touch_exactly_in_either_dtype(feature, dtype):
    pairs = peer_scenes.touching(40, 7, feature).astype(dtype)
    for i in range(pairs.size):
        assert oracle.squared_distance(truth.exact(pairs, i)) == 1
    assert pairs.aspect.max() > 20


@pytest.mark.parametrize("feature", peer_scenes.DIRECTIONS)
def test_touching_pairs_touch_the_feature_that_they_are_named_for(feature):
    pairs = peer_scenes.touching(40, 7, feature)
    multipliers = reference.nearest_in(pairs).multipliers
    largest = abs(multipliers).max(axis=1, keepdims=True)
    sides = np.sum(abs(multipliers) > 1e-9 * largest, axis=1)
    assert np.all(sides == 1 + list(peer_scenes.DIRECTIONS).index(feature))


@pytest.mark.parametrize("kind", peer_scenes.KINDS)
def test_kinds_of_pairs_are_legal(kind):
    pairs = peer_scenes.KINDS[kind](50, 1)
    jaxbe.Box(*pairs[:3])
    jaxbe.Ellipsoid(*pairs[3:])
    assert pairs.size == 50
    assert pairs.C.dtype == np.float64


def system(name, pairs, dtype="float64", flipped=()):
    """A system that is right but for some pairs."""
    verdicts = truth.overlaps(pairs.astype(dtype))
    verdicts[list(flipped)] ^= True
    return name, dtype, Answer(verdicts)


def test_a_peer_that_lies_is_caught():
    pairs = scenes.random(30, seed=62)
    systems = [
        system("jaxbe", pairs),
        system("jaxbe, float32", pairs, "float32"),
        system("liar", pairs, flipped=[4, 9]),
    ]
    judged = peer_verdicts.judge("random", pairs, systems)
    assert judged["systems"]["liar"]["wrong_outside_band"] == 2
    assert judged["systems"]["jaxbe"]["wrong_outside_band"] == 0
    assert [entry["index"] for entry in judged["disagreements"]] == [4, 9]
    for entry in judged["disagreements"]:
        assert entry["wrong"] == entry["outside_band"] == "001"
        numbers = np.array(entry["pair"].split(), float)
        np.testing.assert_array_equal(
            numbers, peer_verdicts.flat(pairs, entry["index"])
        )
        assert entry["overlap"] == ("110" if entry["truth"]["float64"] else "001")
    assert peer_verdicts.counts(judged) == {
        "all": 2,
        "a_peer_wrong": 2,
        "jaxbe_wrong": 0,
        "jaxbe_wrong_outside_band": 0,
        "both_right": 0,
    }
    json.dumps(judged)


def test_a_wrong_verdict_of_ours_is_not_excused_by_a_wrong_peer():
    pairs = scenes.random(10, seed=63)
    systems = [
        system(name, pairs, flipped=which)
        for name, which in (("jaxbe.margin", [3]), ("peer", []), ("other", [3]))
    ]
    judged = peer_verdicts.judge("random", pairs, systems)
    counts = peer_verdicts.counts(judged)
    assert counts["jaxbe_wrong_outside_band"] == counts["a_peer_wrong"] == 1


def test_the_band_is_that_of_the_dtype():
    """Some 1e-7 from touching float32 may be wrong, float64 not."""
    pairs = scenes.near_touching(scenes.random(20, seed=64), growth=1e-7)
    for dtype, within in (("float32", 20), ("float64", 0)):
        name, _, answer = system(dtype, pairs, dtype, flipped=range(20))
        given = pairs.astype(dtype)
        judged = peer_verdicts.verdict_errors(
            given, truth.overlaps(given), answer.overlap
        )
        assert judged["wrong_within_band"] == within, name
        assert judged["wrong_outside_band"] == 20 - within
        assert 0 < judged["furthest_wrong"] < 1e-5
    assert peer_verdicts.band(1e5, "float64") == pytest.approx(1e-8)


def test_rounding_to_float32_can_leave_both_right():
    pairs = scenes.near_touching(scenes.random(50, seed=65), growth=1e-8)
    systems = [system("jaxbe, float32", pairs, "float32"), system("peer", pairs)]
    judged = peer_verdicts.judge("near", pairs, systems)
    entries = judged["disagreements"]
    assert peer_verdicts.counts(judged)["both_right"] == len(entries) > 0


def reference_peer(pairs, name, run):
    return Peer(name, "float64", "Python", run, peer_adapters.overlap, pairs.size, run)


def honest(pairs, _):
    run = functools.partial(truth.overlaps, pairs)
    yield reference_peer(pairs, "honest", run)


def always_apart(pairs, _):
    yield reference_peer(pairs, "always apart", lambda: np.zeros(pairs.size))


def missing(pairs, _):
    importlib.import_module("no_such_package")
    yield


def fails_when_run(pairs, _):
    def run():
        raise ArithmeticError("it did not converge")

    yield reference_peer(pairs, "fails", run)


def our_overlap(pairs):
    """All that is measured of jaxbe: the rest takes long to compile."""
    for dtype in ("float32", "float64"):
        yield peer_adapters.jax_program(
            "jaxbe.overlap, closest_features",
            dtype,
            layouts.by_vmap(jaxbe.overlap),
            pairs.astype(dtype).bodies(),
            peer_adapters.overlap,
            pairs.size,
        )


@pytest.fixture
def few_kinds(monkeypatch):
    kinds = {name: peer_scenes.KINDS[name] for name in ("needles", "touching, edge")}
    monkeypatch.setattr(peer_scenes, "KINDS", kinds)
    monkeypatch.setattr(peer_adapters, "jaxbe_verdicts", our_overlap)


def test_what_is_missing_or_fails_is_reported_and_the_rest_measured(
    few_kinds, monkeypatch
):
    makers = (honest, always_apart, missing, fails_when_run)
    adapters = {f.__name__: Adapter(f, "numpy", 20) for f in makers}
    monkeypatch.setattr(peers, "ADAPTERS", adapters)
    numbers = peers.measure(peers.parse(["--pairs=50", "--judged=20", "--repeats=1"]))
    text = peers.peers_report.text(numbers)
    assert "- missing: ModuleNotFoundError: No module named 'no_such_package'" in text
    assert "- fails: ArithmeticError: it did not converge" in text
    timed = numbers["speed"]["systems"]
    assert {"honest", "always apart"} < set(timed)
    assert not {"missing", "fails"} & set(timed)
    assert timed["honest"]["pairs"] == 20
    assert timed["jaxbe.overlap, components, float32"]["pairs"] == 50
    touching = numbers["correctness"][1]["systems"]
    assert touching["always apart"]["wrong_within_band"] == 20
    assert touching["honest"]["furthest_wrong"] == 0
    json.dumps(numbers)


@pytest.mark.slow
@pytest.mark.parametrize("name", peer_adapters.ADAPTERS)
def test_peers_agree_on_random_pairs(name, tmp_path):
    modules = {"naive JAX": "jax", "MuJoCo": "mujoco", "python-fcl": "fcl"}
    pytest.importorskip(modules.get(name, name.replace("-", "_")))
    pairs = scenes.random(200, seed=66)
    far = abs(reference.scaled_distance(pairs) - 1) > 1e-4
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        found = list(peer_adapters.ADAPTERS[name].peers(pairs, tmp_path))
        assert found
        for peer in found:
            verdicts = peer.answer().overlap
            np.testing.assert_array_equal(
                verdicts[far], truth.overlaps(pairs)[far], peer.name
            )


@pytest.mark.slow
def test_distances_are_judged():
    pairs = scenes.random(100, seed=67)
    true = peer_verdicts.apart_distance(pairs, truth.overlaps(pairs))
    apart = np.isfinite(true)
    ours = np.asarray(jax.jit(jaxbe.signed_distance)(*pairs.bodies()))
    np.testing.assert_allclose(true[apart], ours[apart], rtol=1e-9, atol=1e-12)
    wrong = np.where(apart, true, -1.0)
    wrong[np.flatnonzero(apart)[0]] += 1e-3
    judged = peer_verdicts.distance_errors(true, wrong)
    assert judged["largest_distance_error"] == pytest.approx(1e-3)
    assert judged["distances_compared"] == apart.sum()
