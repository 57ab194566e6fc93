"""What `jaxbe.kept` promises: the same values, no infinity that spreads."""

import numpy as np

import jaxbe
from jaxbe.kept import kept, kept_direction, kept_from, kept_pair, shared


def test_values_and_nan(dtype):
    x = np.array([0, -2.5, np.nan, 1e-30], dtype)
    y = np.array([3, np.nan, 1, -7], dtype)
    given = np.ones(4, dtype)
    for found, expected in zip(kept_pair(x, y, given), (x, y), strict=True):
        clean = ~np.isnan(x) & ~np.isnan(y)
        np.testing.assert_array_equal(np.asarray(found)[clean], expected[clean])
    for function in (kept, kept_from):
        np.testing.assert_array_equal(function(x, given), x)
        assert np.all(np.isnan(function(x, given * np.nan)))
    np.testing.assert_array_equal(shared(x + given), x + given)


def test_direction(dtype):
    """Divided by its largest component; zeros and signs to the bit."""
    u = np.random.default_rng(0).normal(size=(3, 3000)).astype(dtype)
    u[:, :3], u[:, 3:6] = np.eye(3), -np.eye(3)
    u[0, 6:50], u[1, 30:80] = 0, 0
    u[:, 80:100] *= np.array([[1], [1e-8], [3]], dtype)
    u[:, 100:110] *= np.array([[-1], [0], [1e-15]], dtype)
    found = np.array(kept_direction(tuple(u), u[0]))
    expected = u / abs(u).max(axis=0)
    np.testing.assert_allclose(found, expected, rtol=2 * np.finfo(dtype).eps, atol=1e-9)
    kept_exactly = abs(expected) > 1e-8
    assert np.all(np.signbit(found)[kept_exactly] == np.signbit(u)[kept_exactly])
    assert np.all(found[u == 0] == 0)
    u[1, 5] = np.nan
    assert np.isnan(np.array(kept_direction(tuple(u), u[0]))[:, 5]).any()


def test_an_infinity_leaves_its_partner_alone(dtype):
    x = np.array([5.0, -5.0], dtype)
    found, most = kept_pair(x, np.full(2, np.inf, dtype), np.ones(2, dtype))
    np.testing.assert_array_equal(found, x)
    assert np.all(np.asarray(most) == np.finfo(dtype).max)


def test_lower_bound_of_far_bodies():
    """The upper bound overflows there; the lower one is the margin all the same."""
    f, eye = np.float32, np.eye(3, dtype=np.float32)
    box = jaxbe.Box(np.zeros(3, f), eye, np.ones(3, f))
    ball = jaxbe.Ellipsoid(np.array([1e22, 0, 0], f), eye, np.ones(3, f))
    lower, _ = jaxbe.margin_bounds(box, ball, steps=0)
    np.testing.assert_allclose(lower, jaxbe.margin(box, ball, steps=0), rtol=1e-6)
