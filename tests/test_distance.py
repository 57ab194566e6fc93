"""`signed_distance`, `distance_bounds` and `contact`: values and what they promise."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import distances, scenes
from jaxbe.distance import MAX_STEPS
from tests import distance_reference as dr
from tests.margin_reference import KINDS

pytestmark = pytest.mark.bulk


def apart(n, seed, **options):
    scene = scenes.random(4 * n, seed=seed, **options)
    return scene.part(np.flatnonzero(~dr.overlapping(scene))[:n])


# Pairs that are apart


@pytest.mark.parametrize(
    ("low", "high", "steps", "at_999", "at_most"),
    [
        (0.05, 2.0, None, 1e-12, 1e-11),
        (0.001, 1.0, None, 1e-9, 1e-2),
        pytest.param(0.001, 1.0, 4, 1e-12, 1e-11, marks=pytest.mark.slow),
    ],
)
def test_distance_apart(low, high, steps, at_999, at_most):
    """Between the value along the direction and the distance of the witness points."""
    scene = apart(100_000, 60, low=low, high=high)
    lower, upper = dr.bounds(scene, steps)
    contact = dr.found(scene, steps)
    along = dr.value_along(scene, contact.normal)
    between = np.linalg.norm(contact.on_box - contact.on_ellipsoid, axis=1)
    scale = 1e-3 + along
    gap = np.maximum(upper, between) - np.minimum(lower, along)
    assert np.percentile(gap / scale, 99.9) <= at_999
    assert np.max(gap / scale) <= at_most
    assert np.max(abs(contact.distance - along) / scale) <= 1e-11
    assert np.max(dr.outside_box(scene, contact.on_box)) <= 1e-14
    assert np.max(dr.outside_ellipsoid(scene, contact.on_ellipsoid)) <= 1e-9


def test_distance_apart_in_float32():
    scene = apart(100_000, 61).astype(np.float32)
    contact = dr.found(scene)
    truth = dr.found(scene.astype(np.float64)).distance
    error = abs(contact.distance - truth) / dr.size(scene)
    assert np.percentile(error, 99.9) <= 1e-6
    assert np.max(error) <= 1e-5


@pytest.mark.parametrize(
    "steps", [1, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (9, MAX_STEPS))]
)
def test_bounds_hold_at_every_count(steps):
    scene = scenes.random(5000, seed=62)
    lower, upper = dr.bounds(scene, steps)
    best = dr.found(scene).distance
    separated = ~dr.overlapping(scene)
    assert np.all(lower[separated] <= best[separated] + 1e-12)
    assert np.all(upper[separated] >= best[separated] - 1e-12)
    assert np.all((upper <= 0) == ~separated)


# Pairs that overlap


@functools.cache
def least_depths():
    """Overlapping pairs, and the least depth of many descents from anywhere."""
    scene = dr.random_overlapping(1500, 63)
    return scene, distances.least_depths(scene)


@pytest.mark.parametrize(
    ("steps", "at_999", "at_most"), [(3, 1.32, 1.5), (5, 1.12, 1.38)]
)
def test_depth_is_the_least_but_seldom(steps, at_999, at_most):
    scene, least = least_depths()
    row = distances.depth_row(scene, least, steps)
    growth = 1 + np.asarray(jax.jit(jaxbe.margin)(*scene.bodies()))
    ratio = -dr.found(scene, steps).distance / least
    assert np.median(ratio) <= 1.0005
    assert row["least"] >= 0.99
    assert row["99.9 %"] <= at_999
    assert row["largest"] <= at_most
    assert row["way_out_errs_by"] <= 1e-12
    assert np.percentile(ratio[growth > 0.9], 95) <= 1 + 1e-9


def test_upper_bound_of_overlapping_pairs():
    """It promises a depth: no more than the least that is known, and not nothing."""
    scene, least = least_depths()
    _, upper = dr.bounds(scene)
    assert np.all(-upper <= least + 1e-12)
    assert np.median(-upper / least) > 0.1


def test_far_pairs_in_float32():
    """Right, or NaN: never finite and wrong."""
    for distance in (1e4, 1e8, 1e9, 1e10, 1e12, 1e15, 1e20):
        box = jaxbe.Box(np.zeros(3, "f4"), np.eye(3, dtype="f4"), np.ones(3, "f4"))
        center = np.array([distance, 0.5 * distance, 0.1 * distance], "f4")
        ball = jaxbe.Ellipsoid(center, np.eye(3, dtype="f4"), np.ones(3, "f4"))
        found = float(jaxbe.signed_distance(box, ball))
        expected = np.linalg.norm(center.astype(float))
        assert np.isnan(found) or abs(found / expected - 1) <= 1e-3
        assert np.isfinite(found) == (distance <= 1e10)


# Signs and degenerate scenes


@pytest.mark.parametrize("kind", KINDS)
def test_sign_and_finiteness(kind, dtype):
    scene = KINDS[kind](scenes.random(1000, seed=65)).astype(dtype)
    contact = dr.found(scene)
    for field in contact:
        assert np.all(np.isfinite(field))
    np.testing.assert_allclose(np.linalg.norm(contact.normal, axis=1), 1, atol=1e-5)
    slack = 200 * np.finfo(dtype).eps * (dr.size(scene) + np.linalg.norm(
        scene.K.astype(float) - scene.C, axis=1))  # fmt: skip
    clear = abs(contact.distance) > slack
    assert np.all((contact.distance <= 0)[clear] == dr.overlapping(scene)[clear])


def test_nan_in_nan_out(dtype):
    scene = scenes.random(50, seed=66).astype(dtype)
    for field, array in enumerate(scene):
        fields = [x.copy() for x in scene]
        fields[field].reshape(array.shape[0], -1)[:, 0] = np.nan
        contact = dr.found(type(scene)(*fields))
        assert np.all(np.isnan(contact.distance))


def test_steps_are_checked():
    bodies = scenes.random(2).bodies()
    for query in (jaxbe.signed_distance, jaxbe.distance_bounds, jaxbe.contact):
        with pytest.raises(ValueError, match=f"from 1 to {MAX_STEPS}, got 0"):
            query(*bodies, steps=0)
        with pytest.raises(TypeError, match="Python integer"):
            query(*bodies, steps=1.5)


# The contract of a contact


def posed(growth, n=6000, seed=67):
    """Pairs at that growth distance, by how many components the normal has."""
    scene = scenes.random(n, seed=seed)
    margin = np.asarray(jax.jit(jaxbe.margin)(*scene.bodies()))
    K = scene.C + (scene.K - scene.C) * (growth / (1 + margin))[:, None]
    scene = scene._replace(K=K)
    contact = dr.found(scene)
    components = np.einsum("nri,nr->ni", scene.U, contact.normal)
    return scene, contact, np.sum(abs(components) > 1e-12, axis=1)


@pytest.mark.parametrize("components", [1, 2, 3], ids=["face", "edge", "vertex"])
@pytest.mark.parametrize("growth", [1.05, 1.0, 0.98, 0.6])
def test_contract(growth, components):
    scene, contact, counts = posed(growth)
    of_kind = np.flatnonzero(counts == components)[:1000]
    assert len(of_kind) >= (100 if growth == 0.6 else 500)
    scene = scene.part(of_kind)
    distance, _, normal, on_box, on_ellipsoid = (x[of_kind] for x in contact)
    assert np.max(dr.outside_box(scene, on_box)) <= 1e-12
    assert np.max(abs(dr.outside_ellipsoid(scene, on_ellipsoid))) <= 1e-9
    # A depth that is not quite settled has points that are not quite opposite.
    along = on_box - on_ellipsoid - distance[:, None] * normal
    errors = np.linalg.norm(along, axis=1)
    assert np.percentile(errors, 95) <= 1e-7
    assert np.max(errors) <= (1e-6 if growth >= 1 else 0.5)
    for hair, expected in ((1e-6, False), (-1e-6, True)):
        away = (distance - hair)[:, None] * normal
        moved = scene._replace(K=scene.K + away)
        agree = dr.overlapping(moved) == expected
        # Whatever the descent, further along the normal is apart.
        assert np.mean(agree) >= (1 if not expected or growth >= 1 else 0.95)


# Derivatives


@functools.cache
def _gradient():
    return jax.jit(jax.grad(lambda *b: jaxbe.signed_distance(*b).sum(), argnums=(0, 1)))


def gradient_fields(scene):
    return dr.in_chunks(_gradient(), scene)


def test_gradient_against_differences():
    """Of the value along the direction, held in box axes (the envelope theorem)."""
    scene = scenes.random(2000, seed=68)
    normal = dr.found(scene).normal
    n = -np.einsum("nri,nr->ni", scene.U, normal)
    gradients, step = gradient_fields(scene), 1e-5
    np.testing.assert_allclose(gradients[3], -normal, atol=1e-12)
    for field, gradient in enumerate(gradients):
        for entry in np.ndindex(gradient.shape[1:]):
            sides = []
            for sign in (1, -1):
                fields = [x.astype(np.longdouble) for x in scene]
                fields[field][(slice(None), *entry)] += sign * step
                sides.append(dr.value_in_box_axes(type(scene)(*fields), n))
            difference = (sides[0] - sides[1]) / (2 * step)
            error = abs(difference - gradient[(slice(None), *entry)])
            assert np.percentile(error, 99) <= 1e-8


def test_gradient_of_the_distance_itself():
    """Centres and lengths, by differences of `signed_distance`."""
    scene = scenes.random(2000, seed=69)
    gradients, step = gradient_fields(scene), 1e-6
    for field in (0, 2, 3, 5):
        for i in range(3):
            sides = []
            for sign in (1, -1):
                fields = list(scene)
                fields[field] = fields[field] + sign * step * (np.arange(3) == i)
                sides.append(dr.found(type(scene)(*fields)).distance)
            difference = (sides[0] - sides[1]) / (2 * step)
            error = abs(difference - gradients[field][:, i])
            assert np.percentile(error, 95) <= 1e-6


def test_derivatives_of_normal_and_points():
    """Along a shift and a turn of both bodies, against differences."""
    scene = scenes.random(2000, seed=70)
    rng = np.random.default_rng(71)
    wxyz = [rng.normal(size=(scene.size, 4)) for _ in range(2)]
    moves = [rng.normal(size=(scene.size, 3)) for _ in range(2)]

    def at(t):
        box = jaxbe.Box.unchecked(
            scene.C + t * moves[0],
            jaxbe.Box.from_quaternion(scene.C, wxyz[0] + t, scene.e).axes,
            scene.e * (1 + t),
        )
        ellipsoid = jaxbe.Ellipsoid.unchecked(
            scene.K + t * moves[1],
            jaxbe.Ellipsoid.from_quaternion(scene.K, wxyz[1] - t, scene.a).axes,
            scene.a * (1 - t),
        )
        return jaxbe.contact(box, ellipsoid, steps=12)

    here, derivative = jax.jit(lambda t: jax.jvp(at, (t,), (1.0,)))(0.0)
    sides = [jax.jit(at)(t) for t in (1e-6, -1e-6)]
    for name in ("distance", "normal", "on_box", "on_ellipsoid", "position"):
        upper, lower, found = (
            np.asarray(getattr(x, name)) for x in (*sides, derivative)
        )
        error = abs((upper - lower) / 2e-6 - found) / (1 + abs(found))
        assert np.percentile(error, 95) <= 1e-5, name
        assert np.all(np.isfinite(found)), name
    assert np.all(np.isfinite(np.asarray(here.distance)))


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_finite(kind, dtype):
    scene = KINDS[kind](scenes.random(300, seed=72)).astype(dtype)
    for gradient in gradient_fields(scene):
        assert np.all(np.isfinite(gradient))
    bodies = scene.bodies()
    ones = jax.tree.map(jnp.ones_like, bodies)
    _, derivative = _contact_jvp()(bodies, ones)
    for field in derivative:
        assert np.all(np.isfinite(np.asarray(field)))


@functools.cache
def _contact_jvp():
    return jax.jit(lambda bodies, d: jax.jvp(jaxbe.contact, bodies, d))
