"""The oracle and the proofs that judge everything else are themselves judged."""

from fractions import Fraction

import numpy as np
import pytest

from benchmarks import reference, scenes
from tests import oracle, truth


def form(N, x, k):
    d = [p - q for p, q in zip(x, k, strict=True)]
    return sum(p * q for p, q in zip(d, oracle.apply(N, d), strict=True))


def test_oracle_value_is_below_every_point_of_the_box():
    rng = np.random.default_rng(0)
    scene = scenes.random(20)
    for i in range(scene.size):
        pair = truth.exact(scene, i)
        q = oracle.squared_distance(pair)
        k, N = oracle.canonical(pair)
        for t in rng.uniform(-1, 1, size=(50, 3)):
            x = [Fraction(s) * e for s, e in zip(t, pair.e, strict=True)]
            assert form(N, x, k) >= q


def test_oracle_value_is_attained():
    """The reference's minimiser, a point of the box, has the value to rounding."""
    scene = scenes.random(20)
    points = reference.nearest_in(scene).x
    for i in range(scene.size):
        pair = truth.exact(scene, i)
        k, N = oracle.canonical(pair)
        value = form(N, [Fraction(v) for v in points[i].tolist()], k)
        q = oracle.squared_distance(pair)
        assert q <= value <= q + Fraction(1, 10**12) * max(q, 1)


def test_inverse_is_exact():
    m = [[Fraction(x) for x in row] for row in ((4, 1, 2), (1, 5, 3), (2, 3, 7))]
    assert oracle.product(m, oracle.inverse(m)) == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize("low", [0.05, 0.002])
@pytest.mark.parametrize("kind", ["random", "near"])
def test_proofs_agree_with_the_oracle(low, kind):
    scene = scenes.random(150, low=low)
    if kind == "near":
        scene = scenes.near_touching(scene)
    overlap, undecided = truth.proofs(scene)
    assert undecided.mean() < 0.1
    for i in np.flatnonzero(~undecided):
        assert overlap[i] == oracle.overlaps(truth.exact(scene, i))


def test_proofs_do_not_need_good_hints():
    """Any point or direction may be tried: none proves what is not so."""
    scene = scenes.random(2000)
    verdict = truth.overlaps(scene)
    rng = np.random.default_rng(1)
    n = rng.normal(size=(scene.size, 3))
    assert not np.any(truth.proves_separation(scene, n) & verdict)
    x = scene.e * rng.uniform(-1, 1, size=(scene.size, 3))
    assert not np.any(truth.proves_overlap(scene, x) & ~verdict)


def test_near_touching_scenes_are_near_touching():
    scene = scenes.near_touching(scenes.random(500), growth=1e-9)
    assert abs(reference.growth_distance(scene) - 1).max() < 2e-9
    verdict = truth.overlaps(scene)
    assert 0.3 < verdict.mean() < 0.7


def test_growth_distance_scales_both_bodies_to_touching():
    scene = scenes.random(500)
    alpha = reference.growth_distance(scene)[:, None]
    grown = scene._replace(e=alpha * scene.e, a=alpha * scene.a)
    assert abs(reference.nearest_in(grown).q - 1).max() < 1e-9


def test_worst_wrong_sees_a_wrong_verdict():
    scene = scenes.random(100)
    verdict = truth.overlaps(scene)
    assert truth.worst_wrong(scene, verdict, verdict) == 0
    i = int(np.argmax(abs(np.sqrt(reference.nearest_in(scene).q) - 1)))
    lie = verdict.copy()
    lie[i] = ~lie[i]
    assert truth.worst_wrong(scene, verdict, lie) > 0.1
