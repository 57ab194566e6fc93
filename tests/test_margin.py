"""The margin: values and bounds against bisection, one-sidedness, sign, form."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import reference, scenes
from jaxbe.growth import MAX_STEPS
from jaxbe.margin import DEFAULT_STEPS
from tests import margin_reference as mr
from tests import programs, truth
from tests.margin_reference import KINDS, LOWS, bounds_at, margin_at

ALL_STEPS = range(MAX_STEPS + 1)


# Accuracy


def check_errors(scene, margins, errors, largest, percentile=None):
    """The stated limits, and the worst pairs once more in exact arithmetic."""
    assert np.max(errors) <= largest
    if percentile is not None:
        assert np.percentile(errors, 99.9) <= percentile
    for i in np.argsort(-errors)[:10]:
        assert mr.is_exactly_within(scene, i, margins[i], largest)


@pytest.mark.bulk
@pytest.mark.parametrize(
    ("aspect", "largest"), [("aspect40", 1e-8), ("aspect1000", 1e-5)]
)
def test_accuracy_in_float64(aspect, largest):
    scene = scenes.random(100_000, seed=30, low=LOWS[aspect])
    margins = np.asarray(margin_at()(*scene.bodies()))
    expected = reference.growth_by_bisection(scene)
    errors = mr.relative_errors(margins.astype(np.longdouble) + 1, expected)
    check_errors(scene, margins, errors, largest, percentile=1e-11)
    most = np.asarray(margin_at(MAX_STEPS)(*scene.bodies())).astype(np.longdouble)
    assert np.max(mr.relative_errors(most + 1, expected)) <= 1e-8


@pytest.mark.bulk
@pytest.mark.parametrize(
    ("aspect", "largest"),
    [("aspect40", 2e-6), ("aspect1000", 1e-5), ("aspect1e5", 1e-4)],
)
def test_accuracy_of_a_canonical_pair_in_float32(aspect, largest):
    scene = scenes.random(100_000, seed=31, low=LOWS[aspect])
    pair = mr.canonical_floats(scene, np.float32)
    found = mr.canonical_growth(*pair, DEFAULT_STEPS)
    assert found.dtype == np.float32
    errors = mr.relative_errors(found, reference.bisect_growth(*pair))
    worst = np.argsort(-errors)[:20]
    # R is a rotation to rounding only, and needles notice: S = R diag(a^2) R^T and
    # the nearest rotation's S give growth distances up to 1e-4 apart at 1e5.
    turned = reference.bisect_growth(*mr.with_rotation(*(x[worst] for x in pair)))
    if aspect == "aspect1e5":
        errors[worst] = np.minimum(
            errors[worst], mr.relative_errors(found[worst], turned)
        )
    assert np.max(errors) <= largest


@pytest.mark.bulk
@pytest.mark.parametrize(
    ("aspect", "percentile", "largest"),
    [("aspect40", 5e-7, 2e-6), ("aspect1000", 3e-6, 3e-5)],
)
def test_accuracy_in_float32(aspect, percentile, largest):
    scene = scenes.random(100_000, seed=32, low=LOWS[aspect]).astype(np.float32)
    margins = np.asarray(margin_at()(*scene.bodies()))
    assert margins.dtype == np.float32
    check_errors(scene, margins, mr.growth_errors(scene, margins), largest, percentile)


LARGEST = {
    ("float64", "aspect40"): 1e-8,
    ("float64", "aspect1000"): 1e-5,
    ("float32", "aspect40"): 2e-6,
    ("float32", "aspect1000"): 3e-5,
}


@pytest.mark.bulk
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "needles"])
@pytest.mark.parametrize("aspect", ["aspect40", "aspect1000"])
def test_accuracy_of_special_scenes(dtype, aspect, kind):
    base = scenes.random(3000, seed=33, low=LOWS[aspect])
    scene = KINDS[kind](base).astype(dtype)
    margins = np.asarray(margin_at()(*scene.bodies()))
    errors = mr.growth_errors(scene, margins)
    check_errors(scene, margins, errors, LARGEST[dtype.name, aspect])


def test_the_judges_see_errors():
    """Or else the tests above would pass for nothing."""
    scene = scenes.random(100, seed=34)
    wrong = np.asarray(margin_at()(*scene.bodies())) + 1e-6
    assert np.all(mr.growth_errors(scene, wrong) > 1e-8)
    for sign, i in [(1, 0), (-1, 1)]:
        shifted = wrong[i] - 1e-6 + sign * 1e-6
        assert mr.is_exactly_within(scene, i, shifted, 2e-6)
        assert not mr.is_exactly_within(scene, i, shifted, 1e-8)


def test_references_agree():
    scene = scenes.random(1000, seed=35)
    newton = reference.growth_distance(scene)
    assert (
        np.max(mr.relative_errors(newton, reference.growth_by_bisection(scene))) < 1e-12
    )


# Bounds


def test_bounds():
    """Both aspect ratios in one test: compiling every step count is what costs."""
    for aspect, tolerance in [("aspect40", 1e-12), ("aspect1000", 1e-10)]:
        scene = scenes.random(10_000, seed=36, low=LOWS[aspect])
        expected = reference.growth_by_bisection(scene).astype(np.float64)
        bounds = [bounds_at(s)(*scene.bodies()) for s in ALL_STEPS]
        bounds = [tuple(np.asarray(x) + 1 for x in b) for b in bounds]
        check_bounds_hold(expected, bounds, tolerance)
        check_bounds_close(expected, bounds)


def check_bounds_hold(expected, bounds, tolerance):
    slack = tolerance * np.maximum(1, expected)
    for lower, upper in bounds:
        assert np.all(lower <= expected + slack)
        assert np.all(upper >= expected - slack)


def check_bounds_close(expected, bounds):
    """Monotonically, to rounding: each count is a program of its own."""
    rounding = 1e-12 * np.maximum(1, expected)
    for (lower, upper), (next_lower, next_upper) in itertools.pairwise(bounds):
        assert np.all(next_lower >= lower - rounding)
        assert np.all(next_upper <= upper + rounding)
    gaps = [(upper - lower) / np.maximum(1, expected) for lower, upper in bounds]
    for earlier, later in itertools.pairwise(gaps[:5]):
        assert np.mean(later) < np.mean(earlier)
    assert np.max(gaps[-1]) <= 1e-8


def test_step_zero_is_the_slab_box():
    """The largest of |k_i| / (e_i + l_i), of section 5 of the paper."""
    scene = scenes.random(1000, seed=37)
    k, _ = reference.canonical(scene)
    expected = np.max(
        abs(k) / (scene.e + scenes.half_widths(scene.U, scene.V, scene.a)), 1
    )
    np.testing.assert_allclose(margin_at(0)(*scene.bodies()), expected - 1, atol=1e-14)
    lower, _ = bounds_at(0)(*scene.bodies())
    np.testing.assert_allclose(lower, expected - 1, atol=1e-14)


@pytest.mark.parametrize("steps", [0, 1, 5])
def test_the_margin_is_the_lower_bound(dtype, steps):
    bodies = scenes.random(1000, seed=38).astype(dtype).bodies()
    lower, upper = bounds_at(steps)(*bodies)
    tolerance = 8 * np.finfo(dtype).eps
    np.testing.assert_allclose(margin_at(steps)(*bodies), lower, tolerance, tolerance)
    assert np.all(upper >= lower)


# Values known beforehand


def ball(dtype, radius, centers):
    return jaxbe.Ellipsoid(
        np.array(centers, dtype), np.eye(3, dtype=dtype), np.full(3, radius, dtype)
    )


@pytest.mark.parametrize(
    ("radius", "center"),
    [
        (2, (3, 0, 0)), (2, (0, -3, 1)), (5, (4, 5, 0)), (5, (0, -4, 5)),
        (7, (3, 4, 7)), (7, (-7, 3, -4)),
    ],
    ids=["face", "face's-rim", "edge", "edge-2", "vertex", "vertex-2"],
)  # fmt: skip
def test_zero_at_touching(dtype, radius, center):
    """Distances of Pythagorean numbers from the cube |x_i| <= 1."""
    box = jaxbe.Box(np.zeros(3, dtype), np.eye(3, dtype=dtype), np.ones(3, dtype))
    found = margin_at()(box, ball(dtype, radius, center))
    assert abs(found) <= 4 * np.finfo(dtype).eps


def test_known_values(dtype):
    box = jaxbe.Box(np.zeros(3, dtype), np.eye(3, dtype=dtype), np.ones(3, dtype))
    found = margin_at()(box, ball(dtype, 2, [[6, 0, 0], [0, 1.5, 0], [0, 0, -30]]))
    np.testing.assert_allclose(found, [1, -0.5, 9], rtol=4 * np.finfo(dtype).eps)
    point = jaxbe.Box(np.zeros(3, dtype), np.eye(3, dtype=dtype), np.zeros(3, dtype))
    found = margin_at()(point, ball(dtype, 7, [2, 3, 6]))
    assert abs(found) <= 4 * np.finfo(dtype).eps


@pytest.mark.parametrize("steps", [0, 1, 5])
@pytest.mark.parametrize("zero_extents", range(4))
def test_minus_one_at_coincident_centres(dtype, steps, zero_extents):
    base = scenes.random(100, seed=39, low=0.002)
    scene = scenes.coincident(scenes.flattened(base, zero_extents)).astype(dtype)
    assert np.all(margin_at(steps)(*scene.bodies()) == -1)
    for bound in bounds_at(steps)(*scene.bodies()):
        assert np.all(bound == -1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    "kind", [lambda s: s, scenes.axis_aligned], ids=["any", "axes"]
)
def test_what_is_not_finite_gives_nan(dtype, bad, kind):
    """Each of the 30 numbers in turn; the last pair of the batch is sound."""
    one = kind(scenes.random(1, seed=40))
    scene = one.part(np.zeros(31, int)).astype(dtype)
    places = [(p, i) for p, x in enumerate(scene) for i in np.ndindex(x.shape[1:])]
    for pair, (position, index) in enumerate(places):
        scene[position][(pair, *index)] = bad
    for steps in (0, 5):
        bounds = bounds_at(steps)(*scene.bodies())
        for x in (margin_at(steps)(*scene.bodies()), *bounds):
            kept = [places[i] for i in np.flatnonzero(~np.isnan(x[:30]))]
            assert not kept, f"no NaN at (field, index) {kept}, {steps} steps"
            assert np.isfinite(x[30])


@pytest.mark.parametrize("query", [jaxbe.margin, jaxbe.margin_bounds])
def test_steps_are_checked(query):
    bodies = scenes.random(2).bodies()
    for steps in (2.5, "3", None):
        with pytest.raises(TypeError, match="steps must be a Python integer"):
            query(*bodies, steps=steps)
    with pytest.raises(TypeError, match="steps must be a Python integer"):
        jax.jit(lambda s: query(*bodies, steps=s))(3)
    for steps in (-1, MAX_STEPS + 1):
        with pytest.raises(ValueError, match=f"from 0 to {MAX_STEPS}, got {steps}"):
            query(*bodies, steps=steps)
    query(*bodies, steps=np.int64(2))


# One-sidedness and sign


def excess(scene, overlapping, steps):
    """The largest margin of a pair that truly overlaps."""
    margins = np.asarray(margin_at(steps)(*scene.bodies()), np.float64)
    return np.max(margins[overlapping])


@pytest.mark.bulk
@pytest.mark.parametrize(
    ("name", "aspect"), [("aspect40", 40), ("aspect1000", 1000), ("aspect1e5", 1e5)]
)
def test_excess_over_overlapping_pairs_is_rounding(name, aspect):
    """Stopping early errs towards "overlap"; only rounding errs the other way."""
    eps = float(np.finfo(np.float32).eps)
    base = scenes.near_touching(scenes.random(50_000, seed=41, low=LOWS[name]))
    scene = base.astype(np.float32)
    overlapping = truth.overlaps(scene)
    assert 0.3 < overlapping.mean() < 0.7
    for steps in ALL_STEPS:
        found = excess(scene, overlapping, steps)
        share = found / (eps * aspect)
        print(f"{name}, {steps} steps: {found:.2e} = {share:.3f} eps aspect")
        assert found <= eps * aspect + 8 * eps
        spread = scene.spread[overlapping].max()
        assert found <= jaxbe.rounding_slack(scene.a.dtype, spread)


def test_rounding_slack_grows_with_the_aspect_ratio_and_eps(dtype):
    eps = float(np.finfo(dtype).eps)
    assert jaxbe.rounding_slack(dtype, 1.0) == 112 * eps
    assert jaxbe.rounding_slack(dtype.name, 40) == 40 * 112 * eps


@pytest.mark.parametrize(
    ("given", "options", "error", "message"),
    [
        ((np.float16, 40), {}, TypeError, "float32 or float64, got float16"),
        ((np.float32, "x"), {}, TypeError, "aspect_ratio must be a number, got 'x'"),
        ((np.float32, 0.5), {}, ValueError, "aspect_ratio must be at least 1"),
        ((np.float32, np.nan), {}, ValueError, "aspect_ratio must be at least 1"),
        ((np.float32, 40), {"axes_error": -1}, ValueError, "must not be negative"),
        ((np.float32, 40), {"axes_error": np.nan}, ValueError, "not be negative"),
        ((np.float32, 40), {"axes_error": True}, TypeError, "must be a number"),
    ],
)
def test_rounding_slack_of_what_has_none(given, options, error, message):
    with pytest.raises(error, match=message):
        jaxbe.rounding_slack(*given, **options)


BANDS = {
    ("float64", "aspect40"): 1e-12,
    ("float64", "aspect1000"): 1e-10,
    ("float32", "aspect40"): 1e-5,
    ("float32", "aspect1000"): 1e-4,
}
"""Where a verdict may be wrong, |sqrt(q) - 1|: as in test_verdicts.py."""


@pytest.mark.parametrize("aspect", ["aspect40", "aspect1000"])
@pytest.mark.parametrize("near", [False, True], ids=["random", "near-touching"])
def test_sign_agrees_with_the_tests(dtype, aspect, near):
    """Near touching to 1e-2, so that most are outside the band."""
    scene = scenes.random(20_000, seed=42, low=LOWS[aspect])
    scene = scenes.near_touching(scene, growth=1e-2) if near else scene
    bodies = scene.astype(dtype).bodies()
    margins = margin_at()(*bodies)
    band = BANDS[dtype.name, aspect]
    ratio = jaxbe.scaled_distance(*bodies)
    decided = (abs(ratio - 1) > band) & (abs(margins) > LARGEST[dtype.name, aspect])
    assert np.mean(decided) > 0.9
    for method in jaxbe.METHODS:
        overlapping = jaxbe.overlap(*bodies, method=method)
        np.testing.assert_array_equal((margins <= 0)[decided], overlapping[decided])


# Form


def total(box, ellipsoid):
    return jaxbe.margin(box, ellipsoid).sum()


@pytest.mark.parametrize(
    "query",
    [jaxbe.margin, jaxbe.margin_bounds, jax.vmap(jaxbe.margin),
     jax.grad(total, argnums=(0, 1)), jax.vmap(jax.grad(total, argnums=(0, 1)))],
    ids=["value", "bounds", "vmap", "gradient", "vmap-gradient"],
)  # fmt: skip
def test_branch_free(dtype, query):
    programs.check_branch_free(query, *scenes.random(64).astype(dtype).bodies())


@pytest.mark.parametrize("steps", [0, 3, 5])
def test_one_loop_over_the_batch(dtype, steps):
    """One fusion that reads each input once: no intermediate reaches memory."""
    if jax.default_backend() != "cpu":
        pytest.skip("other backends fuse in other ways")
    query = jax.vmap(lambda *bodies: jaxbe.margin(*bodies, steps=steps))
    n = 10_000
    bodies = scenes.random(n).astype(dtype).bodies()
    assert programs.fusions(query, *bodies) == 1
    assert programs.bytes_accessed(query, *bodies) == n * 31 * dtype.itemsize


def test_batch_vmap_and_loop_agree_to_rounding(dtype):
    scene = scenes.random(200, seed=43).astype(dtype)
    bodies = scene.bodies()
    batch = np.asarray(jaxbe.margin(*bodies))
    vmapped = np.asarray(jax.jit(jax.vmap(jaxbe.margin))(*bodies))
    loop = np.array([margin_at()(*scene.part(i).bodies()) for i in range(scene.size)])
    tolerance = 100 * np.finfo(dtype).eps
    np.testing.assert_allclose(batch, vmapped, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(batch, loop, rtol=tolerance, atol=tolerance)


def test_leading_axes_broadcast(dtype):
    """Every box of (4, 1) against every ellipsoid of (5,)."""
    scene = scenes.random(20, seed=44).astype(dtype)
    boxes = jaxbe.Box(*(x[:4, None] for x in scene[:3]))
    ellipsoids = jaxbe.Ellipsoid(*(x[4:9] for x in scene[3:]))
    found = jaxbe.margin(boxes, ellipsoids)
    assert found.shape == (4, 5)
    assert jaxbe.margin(*scene.part(slice(0, 0)).bodies()).shape == (0,)
    for i, j in np.ndindex(4, 5):
        box = jaxbe.Box(*(x[i] for x in scene[:3]))
        one = margin_at()(box, jaxbe.Ellipsoid(*(x[4 + j] for x in scene[3:])))
        assert abs(one - found[i, j]) <= 100 * np.finfo(dtype).eps * (1 + abs(one))


def test_one_compilation_per_shape(dtype):
    compiled = jax.jit(lambda *bodies: jaxbe.margin(*bodies))
    for seed in range(3):
        compiled(*scenes.random(17, seed=seed).astype(dtype).bodies())
    assert compiled._cache_size() == 1
    compiled(*scenes.random(18).astype(dtype).bodies())
    assert compiled._cache_size() == 2


def test_dtypes_do_not_mix():
    box, _ = scenes.random(2).astype(np.float32).bodies()
    _, ellipsoid = scenes.random(2).bodies()
    with pytest.raises(TypeError, match="one dtype"):
        jaxbe.margin(box, ellipsoid)
    assert jaxbe.margin(box, jax.tree.map(jnp.float32, ellipsoid)).dtype == jnp.float32
