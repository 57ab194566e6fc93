"""The worst cells of the map of extremes, and the truth that it is drawn with."""

from __future__ import annotations

import functools
import json

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import extended, extremes, reference, scenes
from benchmarks.extremes_report import CLEAN, FIELDS
from benchmarks.extremes_scenes import pairs, scaled
from tests import oracle, truth

CELLS = (
    (1.0, "coincident"),
    (1e3, "deep"),
    (1e3, 1e6),
    (1e4, "touching"),
    (1e7, "touching"),
    (1e7, 1e-3),
    (1e7, 1e6),
)
EACH = 18
SIZES = (-60, 0, 60)


@functools.cache
def worst_cells(dtype):
    """All cells in one scene."""
    parts = [pairs(*cell, dtype, EACH) for cell in CELLS]
    return scenes.Scene(*map(np.concatenate, zip(*parts, strict=True)))


@functools.cache
def true_answer(dtype, name):
    return extremes.true_answer(worst_cells(dtype), extremes.QUERIES[name])


@functools.cache
def judged(dtype, name, size):
    true = true_answer(dtype, name)
    return extremes.judge(worst_cells(dtype), size, name, None, true)


def rows(*aspects):
    """Which pairs are of these aspect ratios."""
    return np.repeat([aspect in aspects for aspect, _ in CELLS], EACH)


def test_wrong_verdicts_are_within_the_rounding_of_the_inputs(dtype):
    scene, true = worst_cells(dtype.name), true_answer(dtype.name, "scaled_distance")
    right = truth.overlaps(scene)
    for size in SIZES:
        assert np.max(extremes.judge_verdicts(scene, size, true, right).ratio) <= 1


@pytest.mark.parametrize("name", ["scaled_distance", "margin"])
def test_values_lose_no_more_than_the_inputs(dtype, name):
    value, _ = judged(dtype.name, name, 0)
    assert np.max(value.ratio) <= CLEAN


def test_distances_lose_no_more_than_the_inputs(dtype):
    value, _ = judged(dtype.name, "signed_distance", 0)
    assert np.max(value.ratio[rows(1.0)]) <= CLEAN
    # Of the thinnest, depths are searched to the rounding of the pair.
    assert np.percentile(value.ratio, 90) <= CLEAN


def test_gradients_lose_no_more_than_the_inputs(dtype):
    """Of the scaled distance all; of the margin all but the semi-axes of plates."""
    _, gradient = judged(dtype.name, "scaled_distance", 0)
    assert np.max(gradient.ratio) <= 2 * CLEAN
    _, gradient = judged(dtype.name, "margin", 0)
    axes = [FIELDS.index(f"{body}.axes") for body in ("box", "ellipsoid")]
    in_axes = gradient.by_field[rows(1e3, 1e4)][:, axes]
    assert np.percentile(in_axes, 95) <= CLEAN
    assert np.max(in_axes) <= 10 * CLEAN


@pytest.mark.parametrize("name", extremes.QUERIES)
def test_every_answer_is_finite_at_every_size(dtype, name):
    for size in SIZES:
        for part in judged(dtype.name, name, size):
            assert not np.any(part.lost)


@pytest.mark.parametrize("name", extremes.QUERIES)
def test_sizes_change_no_bit(dtype, name):
    scene = worst_cells(dtype.name)
    value, gradient = extremes.found(scene, name, None, 0)
    for size in SIZES:
        there, slopes = extremes.found(scaled(scene, size), name, None, size)
        np.testing.assert_array_equal(there, value)
        np.testing.assert_array_equal(slopes.K, gradient.K)


# The truth


def few(dtype):
    return worst_cells(dtype.name).part(slice(None, None, 6))


def test_true_scaled_distance_is_the_exact_one(dtype):
    scene = few(dtype)
    found = extended.scaled_distance(scene).value.astype(float)
    for i in range(scene.size):
        q = oracle.squared_distance(truth.exact(scene, i))
        assert found[i] == pytest.approx(float(q) ** 0.5, rel=1e-10, abs=1e-10)


def test_true_growth_distance_is_that_of_touching(dtype):
    """The box grown so is at the scaled distance itself, in exact arithmetic."""
    scene = few(dtype)
    alpha = extended.growth_distance(scene).value.astype(float)
    for i in np.flatnonzero(alpha > 0):
        pair = truth.exact(scene, i)
        grown = pair._replace(e=[oracle.Fraction(alpha[i]) * x for x in pair.e])
        root = float(oracle.squared_distance(grown)) ** 0.5
        assert abs(root - alpha[i]) <= 1e-8 * max(root, alpha[i])


def test_true_distance_is_no_bound_only():
    """It is attained at the reference's points, where it is checked independently."""
    scene = scenes.random(300, low=0.002)
    found = extended.distance(scene)
    apart = found.value > 0
    assert 0.3 < apart.mean() < 0.9
    normal = -np.einsum("nri,ni->nr", scene.U, found.n.astype(float))
    along = reference.value_along(scene.part(apart), normal[apart])
    np.testing.assert_allclose(along, found.value[apart].astype(float), rtol=1e-12)
    best = np.asarray(jax.jit(jaxbe.signed_distance)(*scene.bodies()))
    np.testing.assert_allclose(best[apart], along, rtol=1e-9, atol=1e-12)


# The benchmark


@pytest.mark.bulk
def test_short_form_of_the_benchmark(tmp_path):
    files = {kind: tmp_path / f"a.{kind}" for kind in ("json", "markdown", "figure")}
    files["figure"] = tmp_path / "a.png"
    extremes.main(["--quick", *(f"--{kind}={file}" for kind, file in files.items())])
    numbers = json.loads(files["json"].read_text())
    assert len(numbers["cells"]) == 2 * 7 * 7
    assert numbers["cells_that_differ_by_size"] == 0
    report = files["markdown"].read_text()
    assert "Cells that are not clean" in report
    pixels = pytest.importorskip("matplotlib.image").imread(files["figure"])
    assert len(np.unique((255 * pixels).astype(int).reshape(-1, 4), axis=0)) > 50
