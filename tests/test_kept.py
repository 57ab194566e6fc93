"""What `jaxbe.kept` promises: the same values, no infinity that spreads."""

import numpy as np

import jaxbe
from jaxbe.kept import kept, kept_from, kept_pair, shared


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
