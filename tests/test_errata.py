"""Every counterexample of the errata, as written and moved, by all three tests."""

import functools
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from tests import oracle
from tests.errata_cases import CASES

ROTATION = oracle.rational_rotation(5, -2, 3, 1)
TRANSLATION = [Fraction(7, 3), Fraction(-11, 5), Fraction(1, 2)]

PLACEMENTS = {
    "as written": lambda pair: pair,
    "moved": lambda pair: oracle.moved(pair, ROTATION, TRANSLATION),
}


@functools.cache
def overlap(method):
    return jax.jit(functools.partial(jaxbe.overlap, method=method))


def bodies(pair, dtype):
    C, U, e, K, V, a = (jnp.asarray(np.array(x, float), dtype) for x in pair)
    return jaxbe.Box(C, U, e), jaxbe.Ellipsoid(K, V, a)


@pytest.fixture(params=CASES, ids=lambda case: case.name)
def case(request):
    return request.param


@pytest.fixture(params=PLACEMENTS)
def pair(request, case):
    return PLACEMENTS[request.param](case.pair())


def test_oracle_gives_the_exact_value(case, pair):
    assert oracle.squared_distance(pair) == case.q


def test_verdict(case, pair, dtype, method):
    assert bool(overlap(method)(*bodies(pair, dtype))) == (case.q <= 1)


@pytest.mark.parametrize("factor", [Fraction(98, 100), Fraction(102, 100)])
def test_verdict_with_semi_axes_scaled(case, pair, dtype, method, factor):
    pair = pair._replace(a=[factor * x for x in pair.a])
    verdict = overlap(method)(*bodies(pair, dtype))
    assert bool(verdict) == (case.q <= 1) == oracle.overlaps(pair)


def test_scaled_distance(case, pair, dtype):
    found = jax.jit(jaxbe.scaled_distance)(*bodies(pair, dtype))
    tolerance = 100 * np.finfo(dtype).eps
    np.testing.assert_allclose(found, float(case.q) ** 0.5, rtol=tolerance, atol=0)
