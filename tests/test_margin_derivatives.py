"""The margin's derivatives: against differences, finite everywhere, continuous."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import reference, scenes
from tests import margin_reference as mr
from tests import programs
from tests.margin_reference import KINDS, LOWS, gradient, gradient_fields, margin_at

# Values of the gradient


@pytest.mark.parametrize("aspect", ["aspect40", "aspect1000"])
def test_gradient_against_differences(aspect):
    """All 30 inputs, the entries of the axes as free numbers."""
    scene = scenes.random(1000, seed=50, low=LOWS[aspect])
    # A step of 1e-6 is small beside bodies of 0.002 only where nothing is smaller.
    expected = mr.differences(scene, step=1e-6 if aspect == "aspect40" else 1e-8)
    errors = mr.field_errors(gradient_fields(scene), expected)
    assert np.percentile(errors, 99) <= 1e-6


@pytest.mark.parametrize("kind", ["plates", "rods", "points", "spheres"])
def test_gradient_of_special_scenes_against_differences(kind):
    """Zero extents: one-sided in e, so there the differences are no judge."""
    scene = KINDS[kind](scenes.random(300, seed=51))
    found, expected = gradient_fields(scene), mr.differences(scene)
    flat = scene.e == 0
    found[2][flat] = expected[2][flat] = 0
    assert np.percentile(mr.field_errors(found, expected), 99) <= 1e-6


def test_gradient_at_zero_extents_is_one_sided():
    """The derivative towards positive extents: the only side that is legal."""
    scene = scenes.flattened(scenes.random(500, seed=52), 2)
    step = 1e-6
    here = reference.growth_by_bisection(scene)
    for i in range(3):
        grown = scene.e + step * (np.arange(3) == i)
        there = reference.growth_by_bisection(scene._replace(e=grown))
        expected = ((there - here) / step).astype(np.float64)
        found = gradient_fields(scene)[2][:, i]
        errors = abs(found - expected) / (1 + abs(expected))
        assert np.percentile(errors, 95) <= 1e-3


@pytest.mark.parametrize(
    ("aspect", "limit"), [("aspect40", 1e-4), ("aspect1000", 2e-3)]
)
def test_gradient_in_float32(aspect, limit):
    """Against float64 on the very floats given: R is rounded, the gradient bends."""
    scene = scenes.random(5000, seed=53, low=LOWS[aspect]).astype(np.float32)
    expected = gradient_fields(scene.astype(np.float64))
    errors = mr.field_errors(gradient_fields(scene), expected)
    print(aspect, np.percentile(errors, [50, 99, 99.9, 100]))
    assert np.percentile(errors, 99) <= limit


def test_forward_equals_reverse(dtype):
    scene = scenes.random(500, seed=54).astype(dtype)
    rng = np.random.default_rng(55)
    tangents = [rng.normal(size=x.shape).astype(dtype) for x in scene]
    directions = jax.tree.unflatten(jax.tree.structure(scene.bodies()), tangents)
    _, forward = jax.jvp(margin_at(), scene.bodies(), directions)
    found = mr.flat(gradient_fields(scene))
    reverse = np.sum(found * mr.flat(tangents), axis=1)
    scale = 1 + np.sum(abs(found), axis=1)
    assert (
        np.max(abs(np.asarray(forward, np.float64) - reverse) / scale)
        < 100 * np.finfo(dtype).eps
    )


def test_gradient_through_quaternions():
    """Against differences; and zero along the quaternion, whose length is free."""
    n, step = 200, 1e-6
    rng = np.random.default_rng(56)
    p, q = rng.normal(size=(2, n, 4))
    base = scenes.random(n, seed=57)

    def total(p, q):
        box = jaxbe.Box.from_quaternion(base.C, p, base.e)
        return jaxbe.margin(box, ellipsoid_of(q)).sum()

    def ellipsoid_of(q):
        return jaxbe.Ellipsoid.from_quaternion(base.K, q, base.a)

    def value(p, q):
        posed = base._replace(U=scenes.rotations(p), V=scenes.rotations(q))
        return reference.growth_by_bisection(posed)

    found = [np.asarray(g) for g in jax.jit(jax.grad(total, argnums=(0, 1)))(p, q)]
    for x, g in zip((p, q), found, strict=True):
        assert np.max(abs(np.sum(x * g, axis=1))) < 1e-12
    for i in range(4):
        h = step * (np.arange(4) == i)
        slopes = [value(p + h, q) - value(p - h, q), value(p, q + h) - value(p, q - h)]
        for g, slope in zip(found, slopes, strict=True):
            error = abs(g[:, i] - (slope / (2 * step)).astype(np.float64))
            assert np.percentile(error / (1 + np.max(abs(g), axis=1)), 99) <= 1e-6


def test_jit_vmap_and_grad_compose(dtype):
    scene = scenes.random(50, seed=58).astype(dtype)
    one_by_one = jax.vmap(jax.jit(jax.grad(jaxbe.margin, argnums=(0, 1))))
    found = [np.asarray(x) for x in jax.tree.leaves(one_by_one(*scene.bodies()))]
    expected = [x.astype(dtype) for x in gradient_fields(scene)]
    for x, y in zip(found, expected, strict=True):
        assert x.dtype == dtype
        np.testing.assert_allclose(x, y, rtol=0, atol=1000 * np.finfo(dtype).eps)


def test_gradient_of_one_box_sums_over_its_ellipsoids(dtype):
    scene = scenes.random(20, seed=59).astype(dtype)
    box = jaxbe.Box(*(x[0] for x in scene[:3]))
    ellipsoids = scene.bodies()[1]
    repeated = jax.tree.map(lambda x: jnp.repeat(x[None], 20, axis=0), box)
    found = jax.tree.leaves(gradient(box, ellipsoids)[0])
    for x, y in zip(
        found, jax.tree.leaves(gradient(repeated, ellipsoids)[0]), strict=True
    ):
        tolerance = 1000 * np.finfo(dtype).eps * (1 + np.max(abs(y)))
        np.testing.assert_allclose(x, y.sum(axis=0), rtol=0, atol=tolerance)


# Finite everywhere


def all_finite(fields):
    return all(np.all(np.isfinite(x)) for x in fields)


@pytest.mark.parametrize("low", LOWS.values(), ids=LOWS)
def test_gradient_is_finite(dtype, low):
    for kind, bend in KINDS.items():
        scene = bend(scenes.random(1000, seed=60, low=low)).astype(dtype)
        assert all_finite(gradient_fields(scene)), kind


def test_gradient_of_degenerate_scenes_is_finite(dtype):
    """Two degeneracies at once: aligned rods, and what comes of them."""
    base = scenes.flattened(scenes.axis_aligned(scenes.random(1000, seed=61)), 2)
    for kind, bend in KINDS.items():
        if kind != "near-touching":  # its reference is singular in ties
            assert all_finite(gradient_fields(bend(base).astype(dtype))), kind


def test_gradient_is_zero_at_coincident_centres(dtype):
    """The subgradient of the cone's tip that is documented."""
    scene = scenes.coincident(scenes.random(50, seed=62)).astype(dtype)
    for x in gradient_fields(scene):
        assert np.all(x == 0)


def test_gradient_where_an_outer_where_discards_the_pair(dtype):
    """No NaN leaks through the branch not taken: 0 times it is added."""
    scene = scenes.coincident(scenes.random(50, seed=63, low=0.002)).astype(dtype)

    def loss(box, ellipsoid):
        found = jaxbe.margin(box, ellipsoid)
        return jnp.where(found > -0.5, found, 0).sum()

    for x in jax.tree.leaves(jax.grad(loss, argnums=(0, 1))(*scene.bodies())):
        assert np.all(x == 0)


def test_gradient_beside_coincident_centres_points_outwards():
    """Finite and not zero as soon as the centres differ, however little."""
    scene = scenes.coincident(scenes.random(200, seed=64))
    K = scene.C + 1e-12 * np.random.default_rng(65).normal(size=scene.K.shape)
    scene = scene._replace(C=np.zeros_like(K), K=K - scene.C)
    found = gradient_fields(scene)
    assert all(np.all(np.isfinite(x)) for x in found)
    outwards = np.sum(found[3] * scene.K, axis=1)
    growth = reference.growth_by_bisection(scene).astype(np.float64)
    np.testing.assert_allclose(outwards, growth, rtol=1e-9)


# Second derivatives


def from_numbers(x):
    C, U, e, K, V, a = jnp.split(x, np.cumsum([3, 9, 3, 3, 9]))
    box = jaxbe.Box.unchecked(C, U.reshape(3, 3), e)
    return jaxbe.margin(box, jaxbe.Ellipsoid.unchecked(K, V.reshape(3, 3), a))


HESSIANS = 200
"""Pairs a test: all the same, for one compilation."""

NOT_AXES = [*range(3), *range(12, 18), *range(27, 30)]
"""Of the 30 numbers, centres, half extents and semi-axes."""

numbers_gradient = jax.jit(jax.vmap(jax.grad(from_numbers)))
hessian = jax.jit(jax.vmap(jax.hessian(from_numbers)))


def differences_of_the_gradient(x, step=1e-6):
    """(n, 30, 30), by central differences."""
    slopes = []
    for move in step * np.eye(30):
        up, down = numbers_gradient(x + move), numbers_gradient(x - move)
        slopes.append(np.asarray((up - down) / (2 * step)))
    return np.stack(slopes, axis=1)


def hessian_errors(found, expected):
    scale = 1 + np.max(abs(expected), axis=(1, 2))
    return np.max(abs(found - expected), axis=(1, 2)) / scale


@pytest.mark.bulk
def test_hessian_against_differences_of_the_gradient():
    """By all lengths and coordinates.

    Not by the axes: differences leave the rotations, and there the gradient is off
    by what the axes lack of orthonormality.
    """
    x = mr.flat(scenes.random(HESSIANS, seed=66))
    found, expected = np.asarray(hessian(x)), differences_of_the_gradient(x)
    errors = hessian_errors(found[:, NOT_AXES], expected[:, NOT_AXES])
    print("Hessian", np.percentile(errors, [50, 95, 99, 100]))
    assert np.percentile(errors, 95) <= 1e-4
    asymmetry = hessian_errors(found, found.transpose(0, 2, 1))
    assert np.max(asymmetry) <= 1e-9


@pytest.mark.bulk
def test_hessian_against_second_differences_of_the_reference():
    """In all 30 inputs, the entries of the axes as free numbers."""
    scene = scenes.random(HESSIANS, seed=67)
    found = np.asarray(hessian(mr.flat(scene)))[:40]
    errors = hessian_errors(found, mr.second_differences(scene.part(slice(40))))
    print("Hessian, all inputs", np.percentile(errors, [50, 90, 95, 100]))
    assert np.percentile(errors, 95) <= 1e-4


@pytest.mark.bulk
def test_hessian_is_the_derivative_of_the_gradient():
    """Forward over reverse, one product at a time."""
    x = jnp.asarray(mr.flat(scenes.random(HESSIANS, seed=67)))
    v = jnp.asarray(np.random.default_rng(68).normal(size=x.shape))
    _, forward = jax.jvp(numbers_gradient, (x,), (v,))
    expected = np.einsum("nij,nj->ni", np.asarray(hessian(x)), v)
    scale = 1 + np.max(abs(expected), axis=1, keepdims=True)
    assert np.max(abs(np.asarray(forward) - expected) / scale) <= 1e-9


@pytest.mark.bulk
def test_hessian_is_finite(dtype):
    """All kinds in one test: compiling is what costs."""
    for kind, bend in KINDS.items():
        scene = bend(scenes.random(HESSIANS, seed=69)).astype(dtype)
        assert np.all(np.isfinite(hessian(mr.flat(scene)))), kind


def test_gradient_and_hessian_are_branch_free(dtype):
    bodies = scenes.random(64).astype(dtype).bodies()
    programs.check_branch_free(gradient, *bodies)
    x = jnp.asarray(mr.flat(scenes.random(8).astype(dtype)))
    programs.check_branch_free(jax.vmap(jax.hessian(from_numbers)), x)


# Continuity


def paths(n, samples, seed=70):
    """Straight paths of the ellipsoid beside the box, samples in a row: (n * samples).

    Each moves by twice the box's size across its surface, so contact goes from
    face to edge to vertex.
    """
    rng = np.random.default_rng(seed)
    base = scenes.random(n, seed=seed, low=0.3, high=1.0)
    start = base.e * [1.5, -1.5, -1.5] + rng.uniform(0, 0.3, (n, 3))
    stop = base.e * [1.5, 1.5, 1.5] + rng.uniform(0, 0.3, (n, 3))
    t = np.linspace(0, 1, samples)[None, :, None]
    k = (start[:, None] * (1 - t) + stop[:, None] * t).reshape(-1, 3)
    many = base.part(np.repeat(np.arange(n), samples))
    return many._replace(K=many.C + np.einsum("nij,nj->ni", many.U, k))


def largest_jumps(n, samples):
    """Of the gradient in all 30 numbers, between neighbours on each path."""
    found = mr.flat(gradient_fields(paths(n, samples))).reshape(n, samples, 30)
    return np.max(abs(np.diff(found, axis=1)), axis=(1, 2))


def test_gradient_is_continuous():
    """Halve the step and the largest jump halves: no part of it stays."""
    n, counts = 20, [501, 1001, 2001, 4001]
    jumps = np.array([largest_jumps(n, c) for c in counts])
    ratios = jumps[:-1] / jumps[1:]
    assert np.all(ratios > 1.8)
    assert np.all(ratios < 2.2)


def test_paths_cross_features():
    """Or else the test above would pass for nothing."""
    n, samples = 20, 501
    scene = paths(n, samples)
    alpha = reference.growth_distance(scene)
    k, R = reference.canonical(scene)
    S = reference.shape_matrix(R, scene.a)
    touching = reference.nearest(k, alpha[:, None] * scene.e, S)
    features = np.sum(touching.multipliers != 0, axis=1).reshape(n, samples)
    seen = [set(f) for f in features]
    assert sum(len(s) >= 2 for s in seen) >= 15
    assert sum(len(s) == 3 for s in seen) >= 5


# Invariances


def rigid_motion(scene, seed=71):
    rng = np.random.default_rng(seed)
    Q = scenes.rotations(rng.normal(size=(1, 4)))[0]
    return Q, moved(scene, Q, rng.normal(size=3))


def moved(scene, Q, shift):
    return scene._replace(
        C=scene.C @ Q.T + shift, U=Q @ scene.U, K=scene.K @ Q.T + shift, V=Q @ scene.V
    )


def check_moved(scene, other, Q, tolerance=1e-11):
    """Equal margins; gradients that turn with the pair."""
    a, b = (np.asarray(margin_at()(*s.bodies())) for s in (scene, other))
    np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)
    C, U, e, K, V, axes = gradient_fields(scene)
    turned = [C @ Q.T, Q @ U, e, K @ Q.T, Q @ V, axes]
    assert np.max(mr.field_errors(gradient_fields(other), turned)) <= 100 * tolerance


def test_rigid_motion():
    scene = scenes.random(1000, seed=72)
    Q, other = rigid_motion(scene)
    check_moved(scene, other, Q)


def test_reflection():
    """The whole scene in a mirror: left-handed axes, the same margins."""
    scene = scenes.random(1000, seed=73)
    Q = np.diag([1.0, 1.0, -1.0])
    check_moved(scene, moved(scene, Q, np.zeros(3)), Q)


def test_relabelled_and_mirrored_axes():
    scene = scenes.random(1000, seed=74)
    found = margin_at()(*scenes.permuted(scene).bodies())
    np.testing.assert_allclose(
        found, margin_at()(*scene.bodies()), rtol=1e-11, atol=1e-11
    )
    order, signs = [2, 0, 1], np.array([1.0, -1.0, -1.0])
    C, U, e, K, V, a = scene
    other = scenes.Scene(
        C, U[:, :, order] * signs, e[:, order], K, V[:, :, order] * signs, a[:, order]
    )
    C, U, e, K, V, a = gradient_fields(scene)
    expected = [C, U[:, :, order] * signs, e[:, order],
                K, V[:, :, order] * signs, a[:, order]]  # fmt: skip
    assert np.max(mr.field_errors(gradient_fields(other), expected)) <= 1e-9


@pytest.mark.parametrize("factor", [2.0**-40, 2.0**-3, 2.0**40])
def test_powers_of_two_change_no_bit(dtype, factor):
    scene = scenes.random(1000, seed=75).astype(dtype)
    other = scenes.scaled(scene, dtype.type(factor))
    a, b = (np.asarray(margin_at()(*s.bodies())) for s in (scene, other))
    np.testing.assert_array_equal(a, b)
    before, after = gradient_fields(scene), gradient_fields(other)
    for position, (x, y) in enumerate(zip(before, after, strict=True)):
        # Margins per metre; the axes have no unit.
        np.testing.assert_array_equal(y, x if position in (1, 4) else x / factor)


def test_other_scales_change_rounding_only():
    scene = scenes.random(1000, seed=76)
    found = margin_at()(*scenes.scaled(scene, 1 / 3).bodies())
    np.testing.assert_allclose(
        found, margin_at()(*scene.bodies()), rtol=1e-11, atol=1e-11
    )


def test_euler_identity(dtype):
    """The margin has no unit: scaling all lengths moves it nowhere."""
    scene = scenes.random(5000, seed=77, low=0.002).astype(dtype)
    _, _, de, dK, _, da = gradient_fields(scene)
    wide = scene.astype(np.float64)
    products = np.concatenate(
        [(wide.K - wide.C) * dK, wide.e * de, wide.a * da], axis=1
    )
    error = abs(np.sum(products, axis=1)) / np.sum(abs(products), axis=1)
    assert np.max(error) <= 200 * np.finfo(dtype).eps


def test_translation(dtype):
    """Only the difference of the centres counts."""
    C, _, _, K, _, _ = gradient_fields(scenes.random(1000, seed=78).astype(dtype))
    np.testing.assert_array_equal(C, -K)


@pytest.mark.parametrize(
    ("half_extents", "center", "axis"),
    [
        ((0, 0, 1e7), (0, 0, 0.5e7), 2),
        ((0, 1e7, 1e7), (0, 1e6, 5e6), 2),
        ((1e18, 1e18, 1e18), (0, 0.2e18, 0.5e18), 2),
    ],
    ids=["rod", "plate", "huge"],
)
def test_gradient_where_the_ellipsoid_is_lost_beside_the_box(
    half_extents, center, axis
):
    """In float32 the grown box reaches the centre: the best face's normal remains."""
    box = jaxbe.Box(*(np.array(x, "f") for x in ([0] * 3, np.eye(3), half_extents)))
    wxyz, semi_axes = np.array([0.9, 0.1, 0.3, 0.2], "f"), np.array([1, 0.5, 0.2], "f")

    def of(center):
        ellipsoid = jaxbe.Ellipsoid.from_quaternion(center, wxyz, semi_axes)
        return jaxbe.margin(box, ellipsoid)

    found = jax.grad(of)(jnp.array(center, jnp.float32))
    expected = np.zeros(3)
    expected[axis] = 1 / half_extents[axis]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=0)
