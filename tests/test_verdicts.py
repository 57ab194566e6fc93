"""Verdicts of the three tests against the truth, on the very floats given."""

import functools

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from tests import oracle, truth

BANDS = {
    ("float64", 0.05): 1e-12,
    ("float64", 0.002): 1e-10,
    ("float32", 0.05): 1e-5,
    ("float32", 0.002): 1e-4,
}
"""Where a verdict may be wrong, |sqrt(q) - 1|, by dtype and smallest length
(lengths go up to 2: aspect ratios to 40 and 1000)."""


@functools.cache
def overlap(method):
    return jax.jit(functools.partial(jaxbe.overlap, method=method))


@pytest.fixture(params=[0.05, 0.002], ids=["aspect40", "aspect1000"])
def low(request):
    return request.param


@pytest.fixture
def band(dtype, low):
    return BANDS[dtype.name, low]


def check(scene, band):
    """No method is wrong outside the band; returns the share that overlaps."""
    verdict = truth.overlaps(scene)
    bodies = scene.bodies()
    for method in jaxbe.METHODS:
        worst = truth.worst_wrong(scene, verdict, overlap(method)(*bodies))
        assert worst <= band, f"{method}: wrong at |sqrt(q) - 1| = {worst}"
    return verdict.mean()


@pytest.mark.bulk
def test_random(dtype, low, band):
    share = check(scenes.random(1_000_000, low=low).astype(dtype), band)
    assert 0.1 < share < 0.9


@pytest.mark.bulk
@pytest.mark.parametrize("growth", [1e-9, 1e-6, 1e-4])
def test_near_touching(dtype, low, band, growth):
    base = scenes.random(100_000, seed=5, low=low)
    share = check(scenes.near_touching(base, growth=growth).astype(dtype), band)
    assert 0.4 < share < 0.6


@pytest.mark.bulk
@pytest.mark.parametrize("zero_extents", [1, 2, 3], ids=["plate", "rod", "point"])
def test_flat_boxes(dtype, low, band, zero_extents):
    base = scenes.flattened(scenes.random(20_000, seed=6, low=low), zero_extents)
    check(base.astype(dtype), band)
    share = check(scenes.near_touching(base).astype(dtype), band)
    assert 0.4 < share < 0.6


@pytest.mark.bulk
@pytest.mark.parametrize(
    "kind",
    [scenes.spheres, scenes.axis_aligned, scenes.coincident, scenes.permuted],
    ids=lambda f: f.__name__,
)
def test_special_poses(dtype, low, band, kind):
    base = kind(scenes.random(20_000, seed=7, low=low))
    share = check(base.astype(dtype), band)
    if kind is scenes.coincident:
        assert share == 1
        return
    check(scenes.near_touching(base).astype(dtype), band)


@pytest.mark.bulk
@pytest.mark.parametrize("size", [1e-15, 1e15])
def test_sizes_in_metres(dtype, low, band, size):
    base = scenes.near_touching(scenes.random(20_000, seed=8, low=low), growth=1e-3)
    check(scenes.scaled(base, size).astype(dtype), band)


@pytest.mark.bulk
def test_far_from_the_origin(dtype, low, band):
    """The floats given are decided, whatever their rounding did to the scene."""
    base = scenes.random(20_000, seed=9, low=low).astype(dtype)
    offset = np.array([1e6, -2e6, 3e6]).astype(dtype)
    share = check(scenes.shifted(base, offset), band)
    assert 0.1 < share < 0.9


def test_integer_ties_are_overlaps(dtype, method):
    """Touching at a vertex, an edge, a face, at numbers that are exact in floats."""
    centers = np.array([[2, 0, 0], [2, 1, 1], [0, -2, 1], [1, 1, 2], [-1, 1, -2]])
    touching = np.array([[4, 5, 1], [1, -4, -5], [-5, 1, 4]])  # 3-4-5 to an edge
    for K, a in [*((K, 1) for K in centers), *((K, 5) for K in touching)]:
        box = jaxbe.Box(np.zeros(3, dtype), np.eye(3, dtype=dtype), np.ones(3, dtype))
        a = np.full(3, a, dtype)
        ball = jaxbe.Ellipsoid(K.astype(dtype), np.eye(3, dtype=dtype), a)
        assert jaxbe.overlap(box, ball, method=method)


def test_power_of_two_scaling_changes_no_bit(dtype, low):
    """Verdicts and scaled distances: sizes from 2^-100 to 2^100."""
    scene = scenes.near_touching(scenes.random(2000, seed=10, low=low)).astype(dtype)
    distance = jax.jit(jaxbe.scaled_distance)
    expected = np.asarray(distance(*scene.bodies()))
    verdicts = [np.asarray(overlap(m)(*scene.bodies())) for m in jaxbe.METHODS]
    for exponent in (-100, -37, -1, 1, 40, 100):
        bodies = scenes.scaled(scene, dtype.type(2.0**exponent)).bodies()
        assert np.array_equal(distance(*bodies), expected)
        for m, verdict in zip(jaxbe.METHODS, verdicts, strict=True):
            assert np.array_equal(overlap(m)(*bodies), verdict)


def test_rigid_motion_changes_no_clear_verdict(dtype, method):
    """Box and ellipsoid moved together: same answer outside the rounding band."""
    scene = scenes.random(20_000, seed=11)
    rotation = scenes.rotations(np.random.default_rng(12).normal(size=(1, 4)))[0]
    shift = np.array([3.0, -1.0, 2.0])
    moved = scene._replace(
        C=scene.C @ rotation.T + shift,
        U=rotation @ scene.U,
        K=scene.K @ rotation.T + shift,
        V=rotation @ scene.V,
    )
    verdicts = overlap(method)(*moved.astype(dtype).bodies())
    band = 10 * BANDS[dtype.name, 0.05]
    assert truth.worst_wrong(scene, truth.overlaps(scene), verdicts) <= band


@pytest.mark.bulk
@pytest.mark.parametrize("aspect", [1e5, 1e7])
def test_needles_and_plates_beyond_the_stated_aspects(dtype, method, aspect):
    """Wrong only within eps times the aspect ratio, whatever it is."""
    rng = np.random.default_rng(13)
    base = scenes.random(20_000, seed=14, low=0.5)
    thin = rng.choice([1.0, 1 / aspect], size=(base.size, 3))
    thin[np.arange(base.size), rng.integers(0, 3, base.size)] = 1.0
    scene = base._replace(a=base.a * thin).astype(dtype)
    verdicts = overlap(method)(*scene.bodies())
    band = 30 * np.finfo(dtype).eps * aspect
    assert truth.worst_wrong(scene, truth.overlaps(scene), verdicts) <= band


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["C", "U", "e", "K", "V", "a"])
def test_undecidable_pairs_count_as_overlapping(dtype, method, bad, field):
    """A NaN or an infinity anywhere, in pairs that are far apart."""
    scene = scenes.random(9, seed=15)
    scene = scene._replace(K=scene.C + 100.0).astype(dtype)
    values = getattr(scene, field)
    for i, index in enumerate(np.ndindex(values.shape[1:])):
        values[(i, *index)] = bad
    C, U, e, K, V, a = scene.part(slice(0, int(np.prod(values.shape[1:]))))
    bodies = jaxbe.Box.unchecked(C, U, e), jaxbe.Ellipsoid.unchecked(K, V, a)
    assert np.all(overlap(method)(*bodies))
    assert np.all(np.isnan(jaxbe.scaled_distance(*bodies)))


def rod_and_ellipsoid(height, dtype):
    """A rod of 1e10 m beside an ellipsoid of 1 m: x has not the digits, x - k has."""
    box = jaxbe.Box(*(np.array(x, dtype) for x in ([0] * 3, np.eye(3), [0, 1e10, 0])))
    wxyz, semi_axes = np.array([0.9, 0.1, 0.3, 0.2]), np.array([1, 0.5, 0.2])
    ellipsoid = jaxbe.Ellipsoid.from_quaternion(
        np.array([0, 2e9, height], dtype), wxyz.astype(dtype), semi_axes.astype(dtype)
    )
    return box, ellipsoid


@pytest.mark.parametrize("height", [0.1, 0.252, 1.1])
def test_a_box_much_larger_than_the_ellipsoid(height, method):
    """The numbers given are floats, so all three must be right to rounding."""
    box, ellipsoid = rod_and_ellipsoid(height, np.float32)
    exact = oracle.exact(*(np.asarray(x, float).tolist() for x in (
        box.center, box.axes, box.half_extents,
        ellipsoid.center, ellipsoid.axes, ellipsoid.semi_axes,
    )))  # fmt: skip
    q = float(oracle.squared_distance(exact))
    found = float(jaxbe.scaled_distance(box, ellipsoid))
    assert found == pytest.approx(q**0.5, rel=1e-5)
    assert float(jaxbe.margin(box, ellipsoid)) == pytest.approx(q**0.5 - 1, abs=1e-5)
    assert bool(overlap(method)(box, ellipsoid)) == (q <= 1)
