"""The certified lower bound of the distance: never above it, and rarely far below."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from benchmarks.reference import LONG, value_along
from jaxbe import lower_bound
from jaxbe._xla import SEPARATION_LIMIT
from jaxbe.lower_bound import MAX_STEPS, ROUNDINGS, distance_lower_bound
from jaxbe.pose import canonical_pair
from tests import programs, truth
from tests.distance_reference import found, in_chunks
from tests.margin_reference import KINDS, LOWS

pytestmark = pytest.mark.bulk

COUNTS = (0, 1, MAX_STEPS)


@functools.cache
def bound_at(steps):
    """The bound, and the direction that it was found along: its slope in K."""

    def both(box, ellipsoid):
        def total(center):
            moved = jaxbe.Ellipsoid.unchecked(
                center, ellipsoid.axes, ellipsoid.semi_axes
            )
            bounds = distance_lower_bound(box, moved, steps)
            return bounds.sum(), bounds

        gradient, bounds = jax.grad(total, has_aux=True)(ellipsoid.center)
        return bounds, -gradient

    return jax.jit(both)


def bounds(scene, steps):
    return in_chunks(bound_at(steps), scene)


def slack(scene, dtype):
    C, _, e, K, _, a = scene.astype(np.float64)
    return ROUNDINGS * np.finfo(dtype).eps * np.sum(abs(K - C) + e + a, axis=1)


def mixed(kind, low, n=1000, seed=60):
    """Random pairs of a kind, from touching to far apart."""
    scene = KINDS[kind](scenes.random(n, seed=seed, low=low))
    far = 10 ** np.random.default_rng(seed).uniform(-1, 1, (n, 1)).clip(0)
    return scene._replace(K=scene.C + far * (scene.K - scene.C))


@jax.jit
def bound_along(box, ellipsoid, n):
    """The bound by the direction n, in box axes."""
    pair = canonical_pair(box, ellipsoid)
    world = lower_bound._world(box, ellipsoid, pair)
    along = lower_bound._along(world, tuple(n[:, i] for i in range(3)))
    return (along.distance - lower_bound._slack(world, pair.per_unit)) / pair.per_unit


@pytest.mark.parametrize("low", LOWS.values(), ids=LOWS)
def test_rounding_takes_less_than_two_thirds_of_the_slack(low, dtype):
    """Any direction, in extended precision: the derivation says 13 of 32 roundings.

    And the direction U n is rounded itself, which the bound does not mind.
    """
    rng = np.random.default_rng(59)
    for kind in KINDS:
        scene = mixed(kind, low).astype(dtype)
        best = -found(scene.astype(np.float64)).normal
        for n in (
            rng.normal(size=(scene.size, 3)),
            np.einsum("nri,nr->ni", scene.U, best),
            rng.choice([0, 0, 1, -1], size=(scene.size, 3)) + 1e-3 * best,
        ):
            n = (n / np.max(abs(n), axis=1, keepdims=True)).astype(dtype)
            world = np.einsum("nri,ni->nr", *(x.astype(LONG) for x in (scene.U, n)))
            lower = np.asarray(bound_along(*scene.bodies(), n), np.float64)
            proved = value_along(scene, -world)
            assert np.all(lower <= proved - slack(scene, dtype) / 3), kind


@pytest.mark.parametrize("low", LOWS.values(), ids=LOWS)
@pytest.mark.parametrize("steps", COUNTS)
def test_no_bound_is_above_the_distance(steps, low, dtype):
    """Above that of the very floats, which directions in extended precision bound."""
    for kind in KINDS:
        scene = mixed(kind, low, seed=61).astype(dtype)
        lower, direction = bounds(scene, steps)
        double = scene.astype(np.float64)
        proved = np.maximum(
            value_along(scene, direction),
            value_along(scene, found(double, steps=12).normal),
        )
        assert np.all(lower <= proved), kind
        assert not np.any(truth.overlaps(double) & (lower > 0)), kind


def test_axes_that_are_not_orthonormal_do_not_matter():
    """MJX's drift by tens of roundings, these by ten thousands."""
    rng = np.random.default_rng(62)
    scene = scenes.near_touching(scenes.random(3000, seed=62), growth=1e-3)
    skew = [x + rng.normal(scale=1e-3, size=x.shape) for x in (scene.U, scene.V)]
    scene = scene._replace(U=skew[0], V=skew[1]).astype(np.float32)
    for steps in COUNTS:
        lower, direction = bounds(scene, steps)
        assert np.all(lower <= value_along(scene, direction))


@pytest.mark.parametrize("steps", [1, 2, MAX_STEPS])
@pytest.mark.parametrize("low", [LOWS["aspect40"], LOWS["aspect1000"]])
def test_every_pair_apart_has_a_positive_bound(steps, low, dtype):
    """From a distance on that rounding explains; one step suffices."""
    scene = scenes.random(5000, seed=63, low=low).astype(dtype)
    lower, _ = bounds(scene, steps)
    distance = found(scene.astype(np.float64)).distance
    rounding = 100 * np.finfo(dtype).eps * 2 / low
    apart = distance > rounding + 2 * slack(scene, dtype)
    assert np.sum(apart) > 2000
    assert np.all(lower[apart] > 0)


def test_steps_tighten():
    scene = mixed("permuted", 0.05, 5000)
    distance = found(scene).distance
    apart = distance > 0
    loss = []
    for steps in (0, 1, 2, MAX_STEPS):
        lower, _ = bounds(scene, steps)
        loss.append(np.mean((distance - lower)[apart] / distance[apart] > 0.01))
    assert loss[0] > 0.5
    assert loss[1] < 0.25
    assert loss[2] < 0.1
    assert loss[3] < 0.01


def test_spheres_need_no_steps(dtype):
    scene = scenes.spheres(scenes.random(3000, seed=64)).astype(dtype)
    lower, _ = bounds(scene, 0)
    double = scene.astype(np.float64)
    k = np.einsum("nri,nr->ni", double.U, double.K - double.C)
    outside = np.linalg.norm(k - np.clip(k, -double.e, double.e), axis=1)
    inside = np.max(abs(k) - double.e, axis=1)
    exact = np.where(outside > 0, outside, inside) - double.a[:, 0]
    assert np.all(abs(lower - exact) <= 2 * slack(scene, dtype))
    assert np.sum(inside < 0) > 150


@pytest.mark.parametrize("steps", COUNTS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_never_dropped(steps, bad, dtype):
    scene = scenes.random(30, seed=65).astype(dtype)
    fields = [x.reshape(30, -1).copy() for x in scene]
    for pair, (field, entry) in enumerate(
        (f, i) for f, x in enumerate(fields) for i in range(x.shape[1])
    ):
        fields[field][pair, entry] = bad
    scene = scenes.Scene(
        *(x.reshape(y.shape) for x, y in zip(fields, scene, strict=True))
    )
    lower = np.asarray(distance_lower_bound(*scene.bodies(), steps))
    if np.isnan(bad):
        assert np.all(np.isnan(lower))
    assert not np.any(lower > -np.inf)


@pytest.mark.parametrize("steps", COUNTS)
def test_numbers_that_leave_the_floats_are_never_dropped(steps):
    """Overlapping float32 pairs of all sizes, aspect ratios up to 1e30."""
    rng = np.random.default_rng(66)
    n = 2000
    scene = scenes.random(n, seed=66)
    e, a = (10 ** rng.uniform(-30, 0, (2, n, 3))).astype(np.float32)
    scale = np.float32(10) ** rng.uniform(-8, 8, (n, 1)).astype(np.float32)
    towards = rng.normal(size=(n, 3)) * np.where(rng.random((n, 1)) < 0.5, 1, 1e-25)
    x = np.einsum("nij,nj->ni", scene.U, 0.4 * e * rng.uniform(-1, 1, (n, 3)))
    y = np.einsum("nij,nj->ni", scene.V, 0.4 * a * rng.uniform(-1, 1, (n, 3)))
    scene = scenes.Scene(
        0 * towards, scene.U, e * scale, (x - y) * scale, scene.V, a * scale
    )
    lower, _ = bounds(scene.astype(np.float32), steps)
    assert not np.any(lower > 0)


@pytest.mark.parametrize("exponent", [-40, -3, 5, 40])
def test_scaling_by_a_power_of_two_scales_the_bound(exponent, dtype):
    scene = scenes.random(1000, seed=67).astype(dtype)
    scaled = scenes.scaled(scene, dtype.type(2.0**exponent))
    for steps in (0, 1):
        expected = 2.0**exponent * bounds(scene, steps)[0]
        np.testing.assert_array_equal(bounds(scaled, steps)[0], expected)


@functools.cache
def gradient_at(steps):
    def total(box, ellipsoid):
        return distance_lower_bound(box, ellipsoid, steps).sum()

    return jax.jit(jax.grad(total, argnums=(0, 1)))


@pytest.mark.parametrize("steps", COUNTS)
def test_derivatives_are_finite(steps, dtype):
    for kind in KINDS:
        bodies = KINDS[kind](scenes.random(300, seed=68)).astype(dtype).bodies()
        gradients = jax.tree.leaves(gradient_at(steps)(*bodies))
        assert all(np.all(np.isfinite(x)) for x in gradients), kind


def test_derivatives_are_those_of_the_distance():
    """Where the direction is the best one; forward mode agrees."""
    scene = scenes.random(600, seed=69, low=0.5)
    contact = found(scene)
    n = -contact.normal
    on_box = np.einsum("nri,nr->ni", scene.U, n)
    on_ellipsoid = scene.a * np.einsum("nrp,nr->np", scene.V, n)
    radius = np.linalg.norm(on_ellipsoid, axis=1, keepdims=True)
    bodies = scene.bodies()
    of_box, of_ellipsoid = gradient_at(MAX_STEPS)(*bodies)
    for gradient, expected in (
        (of_box.center, -n),
        (of_box.half_extents, -abs(on_box)),
        (of_ellipsoid.center, n),
        (of_ellipsoid.semi_axes, -(on_ellipsoid**2) / scene.a / radius),
    ):
        error = abs(np.asarray(gradient) - expected)[contact.distance > 0.05]
        assert np.max(error) < 1e-4
    ones = jax.tree.map(jnp.ones_like, bodies)
    bound = functools.partial(distance_lower_bound, steps=MAX_STEPS)
    _, forward = jax.jit(lambda *b: jax.jvp(bound, b, ones))(*bodies)
    backward = sum(float(jnp.sum(x)) for x in jax.tree.leaves((of_box, of_ellipsoid)))
    np.testing.assert_allclose(np.sum(forward), backward, rtol=1e-10)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="fuses in other ways")
@pytest.mark.parametrize("steps", [0, 1, SEPARATION_LIMIT.at_once + 1, MAX_STEPS])
def test_one_fusion_while_there_is_room(steps, dtype):
    """And none too large to compile well, whatever the steps."""
    bodies = scenes.random(10_000).astype(dtype).bodies()
    function = jax.vmap(functools.partial(distance_lower_bound, steps=steps))
    programs.check_branch_free(function, *bodies)
    if steps < MAX_STEPS:
        assert programs.fusions(function, *bodies) == 1
    assert programs.largest_expression(function, *bodies) <= 3000


@pytest.mark.parametrize("factor", [1e-20, 0.4, 2.5, 1e15])
def test_axes_far_from_unit_length_are_not_decided(factor, dtype):
    scene = scenes.random(100, seed=66).astype(dtype)
    for field in ("U", "V"):
        axes = getattr(scene, field) * np.asarray(factor, dtype)
        bodies = scene._replace(**{field: axes}).bodies()
        assert np.all(np.isnan(distance_lower_bound(*bodies, 1)))
