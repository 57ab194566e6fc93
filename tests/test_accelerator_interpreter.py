"""The interpreter of `tests.accelerator_arithmetic` itself."""

import functools
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Primitive

import jaxbe
from jaxbe import _xla
from tests import accelerator_arithmetic as accelerator
from tests import without_hints
from tests.accelerator_arithmetic import MOVES, Arithmetic, Value, evaluate

IEEE = Arithmetic()


def evaluated(function, *arguments, how=IEEE):
    results, _ = evaluate(jax.make_jaxpr(function)(*arguments), arguments, how)
    return results[0]


@pytest.mark.parametrize("units", [-3, -1, 0, 2])
def test_moved_by_units_in_the_last_place(units, dtype):
    """Across powers of two, and the sign stays."""
    x = np.array([1, 1.5, -1, -0.75, 2, 1e-3, np.finfo(dtype).tiny], dtype)
    expected = x
    for _ in range(abs(units)):
        limit = np.inf * np.sign(x) if units > 0 else 0
        expected = np.nextafter(expected, np.asarray(limit, dtype))
    np.testing.assert_array_equal(accelerator.moved(x, units), expected)


def test_what_is_no_approximation_is_not_moved(dtype):
    info = np.finfo(dtype)
    x = np.array([0, -0.0, np.inf, -np.inf, np.nan, info.max, -info.max], dtype)
    np.testing.assert_array_equal(accelerator.moved(x, 3), x)
    still = np.array([info.smallest_subnormal], dtype)
    assert accelerator.moved(still, -3) == 0


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda x, y: x / y, 1),
        (lambda x, y: jnp.sqrt(x), 1),
        (lambda x, y: jax.lax.rsqrt(x), 1),
        (lambda x, y: x**-2, 1),
        (lambda x, y: jax.jit(lambda z: z / y)(x) / y, 2),
        (lambda x, y: x**2 * y + x - abs(y), 0),
    ],
)
def test_every_quotient_and_root_is_moved(function, expected, dtype):
    x, y = (np.array([v], dtype) for v in (3, 7))
    jaxpr = jax.make_jaxpr(function)(x, y)
    (still,), sites = evaluate(jaxpr, (x, y), Arithmetic())
    (away,), _ = evaluate(jaxpr, (x, y), Arithmetic(MOVES["away from zero"]))
    assert sites == expected
    eps = np.finfo(dtype).eps
    assert 1 * expected * eps <= away / still - 1 <= 8 * expected * eps


def test_random_moves_go_both_ways(dtype):
    x = np.linspace(1, 2, 1000, dtype=dtype)
    assert set(MOVES["random"](0, x).tolist()) == set(range(-3, 4))
    assert set(MOVES["corners"](0, x).tolist()) == {-3, 3}


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b, c: a * b + c,
        lambda a, b, c: c + a * b,
        lambda a, b, c: a * b - c,
        lambda a, b, c: c - a * b,
        lambda a, b, c: -(a * b) + c,
        lambda a, b, c: a * a - c,
        lambda a, b, c: a**2 + c,
    ],
)
def test_contracted_products_are_not_rounded(function, dtype):
    """As in rational arithmetic, rounded once."""
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 200)).astype(dtype)
    c = (a * b * (1 + 1e-3 * rng.normal(size=200))).astype(dtype)
    fused = evaluated(function, a, b, c, how=Arithmetic(contracts=1))
    exact = [
        float(function(*(Fraction(float(x)) for x in abc)))
        for abc in zip(a, b, c, strict=True)
    ]
    np.testing.assert_array_equal(fused, np.asarray(exact).astype(dtype))
    assert np.any(fused != evaluated(function, a, b, c))
    called = lambda a, b, c: jax.jit(lambda x: x)(jax.jit(function)(a, b, c))  # noqa: E731
    again = evaluated(called, a, b, c, how=Arithmetic(contracts=1))
    np.testing.assert_array_equal(again, fused)


def test_subnormals_are_flushed(dtype):
    """Operands and results, and not what is only moved about."""
    tiny = np.finfo(dtype).tiny
    x = np.array([tiny / 2, tiny, -tiny / 2], dtype)
    how = Arithmetic(flushes=True)
    half = dtype.type(0.5)
    np.testing.assert_array_equal(
        evaluated(lambda x: x * 4, x, how=how), [0, 4 * tiny, 0]
    )
    np.testing.assert_array_equal(evaluated(lambda x: x * half, x, how=how), 0)
    np.testing.assert_array_equal(evaluated(lambda x: x > 0, x, how=how), [0, 1, 0])
    np.testing.assert_array_equal(evaluated(lambda x: x[:2], x, how=how), x[:2])
    assert np.all(evaluated(lambda x: x * half, x) != 0)


@pytest.mark.parametrize(
    "function",
    [jnp.exp, jnp.cumsum, lambda x: jax.lax.complex(x, x), lambda x: x @ x],
)
def test_an_unknown_primitive_is_an_error(function, dtype):
    with pytest.raises(NotImplementedError, match="of which nothing is known"):
        evaluated(function, np.ones(3, dtype))


def test_primitives_for_the_compiler_have_rules_of_their_own(monkeypatch, dtype):
    """Contraction looks through those that are nothing on an accelerator."""
    made_up = Primitive("jaxbe_made_up")
    made_up.def_abstract_eval(lambda x, witness, *, times: x)

    def function(x, y):
        return made_up.bind(x * y, y, times=3) - y

    x, y = (np.array([v], dtype) for v in (1 / 3, 3))
    with pytest.raises(NotImplementedError, match="jaxbe_made_up"):
        evaluated(function, x, y)
    rules = accelerator.COMPILER_PRIMITIVES
    monkeypatch.setitem(rules, "jaxbe_made_up", accelerator.all_but_last)
    contracted = evaluated(function, x, y, how=Arithmetic(contracts=1))
    assert contracted == evaluated(
        lambda x, y: x * y - y, x, y, how=Arithmetic(contracts=1)
    )

    def scaled(x, witness, *, times):
        return [Value(x.array * times)]

    monkeypatch.setitem(rules, "jaxbe_made_up", scaled)
    assert evaluated(function, x, y) == 3 * (x * y) - y


def test_every_primitive_for_the_compiler_has_a_rule():
    found = {x.primitive.name for x in vars(_xla).values() if isinstance(x, _xla.Hint)}
    rules = {*accelerator.COMPILER_PRIMITIVES, *accelerator.COMPILER_FUNCTIONS}
    assert found == rules


def test_a_direction_is_normalised_by_quotients_that_are_moved(dtype):
    u = [np.array([x, y], dtype) for x, y in ((3, 1), (-4, -1e-30), (1, 0))]

    def function(u):
        return _xla.materialise_direction(u, u[0])

    jaxpr = jax.make_jaxpr(function)(u)
    exact, sites = evaluate(jaxpr, u, IEEE)
    expected = [[dtype.type(0.75), 1], [-1, 0], [0.25, 0]]
    np.testing.assert_array_equal(exact, expected)
    assert sites == 3
    moved, _ = evaluate(jaxpr, u, Arithmetic(MOVES["away from zero"]))
    assert np.all(
        (abs(np.array(moved)) > abs(np.array(exact))) == (np.array(exact) != 0)
    )


@pytest.mark.parametrize(
    "query",
    [
        jaxbe.signed_distance,
        functools.partial(jaxbe.signed_distance, steps=5),
        jaxbe.distance_bounds,
        jaxbe.contact,
    ],
)
def test_what_accelerators_compute_of_distances(query):
    """A CPU's answers to the bit; with each quotient moved, distances to rounding."""
    bodies = without_hints.scene_of("float32").bodies()
    jaxpr = jax.make_jaxpr(query)(*bodies)
    arguments = jax.tree.leaves(bodies)
    expected = jax.tree.leaves(query(*bodies))
    exact, _ = evaluate(jaxpr, arguments, IEEE)
    moved, _ = evaluate(jaxpr, arguments, Arithmetic(MOVES["random"]))
    for found, truth in zip(exact, expected, strict=True):
        np.testing.assert_array_equal(found, truth)
    np.testing.assert_allclose(moved[0], expected[0], rtol=0, atol=1e-5)
