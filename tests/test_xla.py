"""What `jaxbe._xla` promises: the same values and derivatives, however it is called.

On a CPU to the bit; what other platforms compute is exported for them and run here.
"""

import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import jaxbe
from benchmarks import scenes
from jaxbe import _xla
from tests.processes import python

EVERY_STEP = _xla.StepLimit(9, 1)
FACTOR = 0.5


class Entry(NamedTuple):
    """A function of `jaxbe._xla`, of arrays only.

    Attributes:
        function: of so many arrays.
        expected: what it gives on a CPU.
        elsewhere: and on other platforms.
        count: the arrays, with the witness, which is the last one if there is one.
        keeps_hint: whether the derivative has the primitive in it, too.
    """

    function: Callable[..., Any]
    expected: Callable[..., Any]
    elsewhere: Callable[..., Any]
    count: int
    keeps_hint: bool = False


def but_last(*arrays):
    return arrays[:-1]


def every(*arrays):
    return arrays


def given(function, of, count, keeps_hint=False):
    return Entry(function, of, of, count, keeps_hint)


def normalised(*arrays):
    x, y, z, _ = jnp.broadcast_arrays(*arrays)
    size = functools.reduce(jnp.maximum, map(abs, (x, y, z)))
    return x / size, y / size, z / size


ENTRIES = {
    "materialise": given(lambda *x: _xla.materialise(x[:-1], x[-1]), but_last, 6),
    "materialise_once": given(_xla.materialise_once, but_last, 2),
    "materialise_two": given(_xla.materialise_two, but_last, 3),
    "materialise_vector": given(
        lambda *x: _xla.materialise_vector(x[:-1], x[-1]), but_last, 4
    ),
    "materialise_direction": given(
        lambda *x: _xla.materialise_direction(x[:-1], x[-1]), normalised, 4
    ),
    "cut": given(_xla.cut, but_last, 2),
    "hand_over": given(_xla.hand_over, but_last, 3),
    "between_steps": given(lambda *x: _xla.between_steps(x, 1, EVERY_STEP), every, 3),
    "stay_fused": given(_xla.stay_fused, every, 1),
    "recompute": given(_xla.recompute, but_last, 2, keeps_hint=True),
    "in_units": Entry(
        lambda x: _xla.in_units(x, FACTOR),
        lambda x: (x * np.asarray(FACTOR, x.dtype),),
        every,
        1,
    ),
    "recomputed": Entry(
        lambda a, b, c, d, w: _xla.recomputed((a, b), (c, d), w),
        lambda a, b, c, d, w: (a, b),
        lambda a, b, c, d, w: (c, d),
        5,
    ),
    "reread": given(lambda *x: _xla.reread(x[:-1], x[-1]), but_last, 3),
}
LINEAR = {k: v for k, v in ENTRIES.items() if k != "materialise_direction"}


@pytest.fixture(params=ENTRIES)
def entry(request):
    return ENTRIES[request.param]


@pytest.fixture(params=LINEAR)
def linear(request):
    return LINEAR[request.param]


def arrays_of(entry, dtype, shape=(5,), seed=0):
    rng = np.random.default_rng(seed)
    return [rng.normal(size=shape).astype(dtype) for _ in range(entry.count)]


def check_equal(found, expected, entry):
    """To the bit; a direction, of quotients, to rounding."""
    found, expected = jax.tree.leaves(found), jax.tree.leaves(expected)
    assert len(found) == len(expected)
    for x, y in zip(found, expected, strict=True):
        assert x.dtype == y.dtype
        assert x.shape == y.shape
        if entry.function is ENTRIES["materialise_direction"].function:
            eps = np.finfo(y.dtype).eps
            np.testing.assert_allclose(x, y, rtol=8 * eps, atol=8 * eps)
        else:
            np.testing.assert_array_equal(x, y)


# Values


def test_all_are_here():
    """Every primitive is reached by an entry of the table."""
    primitives = {x.primitive for x in vars(_xla).values() if isinstance(x, _xla.Hint)}
    found = {
        equation.primitive
        for entry in ENTRIES.values()
        for equation in jax.make_jaxpr(entry.function)(*arrays_of(entry, "f4")).eqns
    }
    assert primitives <= found


WAYS = {
    "eager": lambda function: function,
    "jit": jax.jit,
    "vmap": jax.vmap,
    "jit of vmap": lambda function: jax.jit(jax.vmap(function)),
    "vmap of jit": lambda function: jax.vmap(jax.jit(function)),
    "checkpoint": jax.checkpoint,
}


@pytest.mark.parametrize("way", WAYS)
def test_values(entry, way, dtype):
    """Of NumPy's arrays and of JAX's."""
    arrays = arrays_of(entry, dtype)
    function = WAYS[way](entry.function)
    check_equal(function(*arrays), entry.expected(*arrays), entry)
    check_equal(function(*map(jnp.asarray, arrays)), entry.expected(*arrays), entry)


def test_values_with_jit_disabled(entry, dtype):
    """Once an endless recursion: what is eager is compiled by itself."""
    arrays = arrays_of(entry, dtype)
    with jax.disable_jit():
        check_equal(entry.function(*arrays), entry.expected(*arrays), entry)
        found = jax.vmap(entry.function)(*arrays)
    check_equal(found, entry.expected(*arrays), entry)


@pytest.mark.parametrize("shapes", [((), (3,)), ((4, 1), (3,)), ((2, 1), (1, 3))])
def test_shapes_broadcast(entry, shapes, dtype):
    """To the shape of all, but where each array is for itself."""
    arrays = [
        np.full(shapes[i % len(shapes)], i + 1, dtype) for i in range(entry.count)
    ]
    expected = entry.expected(*arrays)
    if entry.function not in (
        ENTRIES["between_steps"].function,
        ENTRIES["reread"].function,
    ):
        shape = np.broadcast_shapes(*(x.shape for x in arrays))
        expected = [np.broadcast_to(x, shape) for x in expected]
    for way in ("eager", "jit"):
        check_equal(WAYS[way](entry.function)(*arrays), expected, entry)


def test_trees_keep_their_form(dtype):
    x = np.ones(3, dtype)
    tree = {"a": x, "b": (2 * x, [3 * x])}
    for found in (_xla.recomputed(tree, tree, x), _xla.reread(tree, x)):
        assert jax.tree.structure(found) == jax.tree.structure(tree)
        jax.tree.map(np.testing.assert_array_equal, found, tree)


def test_before_the_first_step_nothing_is_between(dtype):
    x = np.ones(3, dtype)
    for number, limit in ((0, 1), (1, 2), (3, 2)):
        state = [x, 2 * x]
        found = _xla.between_steps(state, number, _xla.StepLimit(1, limit))
        assert found[0] is x


def test_infinities_and_nan(linear, dtype):
    """No NaN of an operand leaves its pair, no infinity its array."""
    most = np.finfo(dtype).max
    special = np.array([1, np.inf, -np.inf, np.nan, 0, 1e-30], dtype)
    for i in range(linear.count):
        arrays = [np.full(6, j + 2, dtype) for j in range(linear.count)]
        arrays[i] = special
        found = jax.jit(linear.function)(*arrays)
        expected = linear.expected(*arrays)
        for x, y in zip(jax.tree.leaves(found), expected, strict=True):
            usable = np.isfinite(special)
            np.testing.assert_array_equal(np.asarray(x)[usable], y[usable])
            # An infinity may become the largest float; NaN spreads within a pair.
            for place in (1, 2):
                allowed = {float(y[place]), float(np.clip(y[place], -most, most))}
                assert float(x[place]) in allowed
            assert np.isnan(x[3]) or x[3] == y[3]


@pytest.mark.parametrize(
    "name", ["materialise", "materialise_once", "cut", "recompute", "hand_over"]
)
def test_a_witness_that_is_nan_poisons(name, dtype):
    entry = ENTRIES[name]
    arrays = arrays_of(entry, dtype)
    arrays[-1][2] = np.nan
    for x, y in zip(
        jax.tree.leaves(entry.function(*arrays)), entry.expected(*arrays), strict=True
    ):
        assert np.isnan(x[2])
        np.testing.assert_array_equal(np.delete(x, 2), np.delete(y, 2))


def direction(u):
    return jnp.stack(_xla.materialise_direction(tuple(u), u[0]))


def test_direction(dtype):
    """Divided by its largest component; zeros and signs to the bit."""
    u = np.random.default_rng(0).normal(size=(3, 3000)).astype(dtype)
    u[:, :3], u[:, 3:6] = np.eye(3), -np.eye(3)
    u[0, 6:50], u[1, 30:80] = 0, 0
    u[:, 80:100] *= np.array([[1], [1e-8], [3]], dtype)
    u[:, 100:110] *= np.array([[-1], [0], [1e-15]], dtype)
    expected = u / abs(u).max(axis=0)
    kept_exactly = abs(expected) > 1e-8
    for function in (direction, functools.partial(elsewhere, direction)):
        found = np.array(function(u))
        rounding = 2 * np.finfo(dtype).eps
        np.testing.assert_allclose(found, expected, rtol=rounding, atol=1e-9)
        assert np.all(np.signbit(found)[kept_exactly] == np.signbit(u)[kept_exactly])
        assert np.all(found[u == 0] == 0)
        bad = u.copy()
        bad[1, 5] = np.nan
        assert np.isnan(np.array(function(bad))[:, 5]).any()


def test_an_infinity_leaves_its_partner_alone(dtype):
    x = np.array([5.0, -5.0], dtype)
    infinite, one = np.full(2, np.inf, dtype), np.ones(2, dtype)
    found, most = _xla.materialise_two(x, infinite, one)
    np.testing.assert_array_equal(found, x)
    assert np.all(np.asarray(most) == np.finfo(dtype).max)


def test_lower_bound_of_far_bodies():
    """The upper bound overflows there; the lower one is the margin all the same."""
    f, eye = np.float32, np.eye(3, dtype=np.float32)
    box = jaxbe.Box(np.zeros(3, f), eye, np.ones(3, f))
    ball = jaxbe.Ellipsoid(np.array([1e22, 0, 0], f), eye, np.ones(3, f))
    lower, _ = jaxbe.margin_bounds(box, ball, steps=0)
    np.testing.assert_allclose(lower, jaxbe.margin(box, ball, steps=0), rtol=1e-6)


# Derivatives


def test_tangents(entry):
    arrays, moved = arrays_of(entry, np.float64), arrays_of(entry, np.float64, seed=1)
    found = jax.jvp(entry.function, arrays, moved)
    differentiated = value_of(entry)
    expected = jax.jvp(differentiated, arrays, moved)
    check_equal(found[1], expected[1], entry)
    check_equal(found[0], entry.expected(*arrays), entry)


def value_of(entry):
    """As derivatives see it: in JAX's own terms."""
    return lambda *x: tuple(entry.expected(*map(jnp.asarray, x)))


@pytest.mark.parametrize("transform", [jax.jacfwd, jax.jacrev])
def test_derivatives_of_some_operands(entry, transform):
    """Of each alone: the tangents of the others are symbolic zeros."""
    arrays = arrays_of(entry, np.float64, (2,))
    for i in range(entry.count):
        found = transform(entry.function, argnums=i)(*arrays)
        expected = transform(value_of(entry), argnums=i)(*arrays)
        check_equal(found, expected, entry)


def test_second_derivatives(entry):
    """Along a direction, of the cubes of the results: both mixed modes."""
    arrays = arrays_of(entry, np.float64)
    moved = arrays_of(entry, np.float64, seed=1)
    everything = tuple(range(entry.count))

    def forward_over_reverse(function):
        return jax.jvp(jax.grad(cubes(function), everything), arrays, moved)[1]

    def reverse_over_forward(function):
        def slope(*x):
            return jax.jvp(cubes(function), x, tuple(moved))[1]

        return jax.grad(slope, everything)(*arrays)

    for second in (forward_over_reverse, reverse_over_forward):
        found, expected = second(entry.function), second(value_of(entry))
        for x, y in zip(found, expected, strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-12)


def cubes(function):
    return lambda *x: sum(jnp.sum(y**3) for y in tupled(function)(*x))


def tupled(function):
    return lambda *x: tuple(jax.tree.leaves(function(*x)))


def test_transposed(linear):
    """Linear in its values, with the witness held: that is no part of them."""
    *values, last = arrays_of(linear, np.float64)
    has_witness = linear.expected is not every and linear.count > 1
    held = [last] if has_witness else []
    values = values if has_witness else [*values, last]

    def function(*x):
        return tupled(linear.function)(*x, *held)

    def expected(*x):
        return tuple(linear.expected(*x, *held))

    results = function(*values)
    cotangents = tuple(x + 1 for x in results)
    found = jax.linear_transpose(function, *values)(cotangents)
    np.testing.assert_allclose(
        sum(np.sum(a * b) for a, b in zip(found, values, strict=True)),
        sum(np.sum(a * b) for a, b in zip(results, cotangents, strict=True)),
        rtol=100 * np.finfo(np.float64).eps,
    )
    of_value = jax.linear_transpose(expected, *map(jnp.asarray, values))
    check_equal(found, of_value(cotangents), linear)


@pytest.mark.parametrize("name", ENTRIES)
def test_which_derivatives_are_hinted_at(name):
    """Those that would else be computed of what is read, or in units, no more."""
    entry = ENTRIES[name]
    arrays = arrays_of(entry, "f4")
    gradient = jax.grad(lambda *x: sum(map(jnp.sum, tupled(entry.function)(*x))))
    names = [
        str(equation.primitive)
        for equation in jax.make_jaxpr(gradient)(*arrays).eqns
        if str(equation.primitive).startswith("jaxbe")
    ]
    assert len(names) == 1 + entry.keeps_hint
    assert len(set(names)) == 1


# Batches


@pytest.mark.parametrize("axis", [0, 1])
def test_some_operands_mapped(entry, axis):
    """One alone, or all but one; the others are alike for all of the batch."""
    for i in range(entry.count):
        for others in (None, 1 - axis):
            shapes = [(3, 3) if j == i or others is not None else (3,)
                      for j in range(entry.count)]  # fmt: skip
            arrays = [
                x
                for s in shapes
                for x in arrays_of(entry, np.float64, s, len(shapes))[:1]
            ]
            axes = tuple(axis if j == i else others for j in range(entry.count))
            found = jax.vmap(entry.function, in_axes=axes)(*arrays)
            expected = jax.vmap(value_of(entry), in_axes=axes)(*arrays)
            check_equal(found, expected, entry)


def test_nested(entry):
    """Of two axes, one operand has both, one neither, others one of them."""
    shapes = [((2, 3, 4), (4,), (2, 4), (3, 4))[i % 4] for i in range(entry.count)]
    outer = tuple((0, None, 0, None)[i % 4] for i in range(entry.count))
    inner = tuple((0, None, None, 0)[i % 4] for i in range(entry.count))
    arrays = [arrays_of(entry, np.float64, s, 7)[0] for s in shapes]

    def both(function):
        return jax.vmap(jax.vmap(function, in_axes=inner), in_axes=outer)

    check_equal(both(entry.function)(*arrays), both(value_of(entry))(*arrays), entry)
    gradient = jax.grad(lambda *x: sum(map(jnp.sum, tupled(entry.function)(*x))))
    expected = jax.grad(lambda *x: sum(map(jnp.sum, value_of(entry)(*x))))
    check_equal(both(gradient)(*arrays), both(expected)(*arrays), entry)


# Platforms


def exported(function, arrays, *platforms):
    """A program for these; that it is not called on others is not checked."""
    unchecked = export.DisabledSafetyCheck.platform()
    forms = [jax.ShapeDtypeStruct(jnp.shape(x), x.dtype) for x in arrays]
    return export.export(
        jax.jit(function), platforms=platforms, disabled_checks=[unchecked]
    )(*forms)


def elsewhere(function, *arrays):
    """What a GPU's program computes, run on a CPU."""
    return exported(function, arrays, "cuda").call(*arrays)


@pytest.mark.parametrize("platform", ["cuda", "rocm", "tpu"])
def test_elsewhere(entry, platform, dtype):
    """No tricks: barriers and nothing else, but what a direction is divided by."""
    arrays = arrays_of(entry, dtype)
    program = exported(tupled(entry.function), arrays, platform)
    check_equal(program.call(*arrays), entry.elsewhere(*arrays), entry)
    text = str(program.mlir_module())
    assert "complex" not in text
    if entry.function is ENTRIES["in_units"].function:
        assert operations(text) <= {"constant", "broadcast_in_dim", "multiply"}
    elif entry.function is not ENTRIES["materialise_direction"].function:
        assert operations(text) <= {"optimization_barrier"}


def operations(text):
    return {
        line.split("stablehlo.")[1].split()[0]
        for line in text.splitlines()
        if " = stablehlo." in line
    }


HAS_BARRIER = {name: name not in {"hand_over", "stay_fused", "recompute", "in_units"}
               for name in ENTRIES}  # fmt: skip
"""On other platforms than CPUs."""


@pytest.mark.parametrize("name", ENTRIES)
def test_barriers_are_for_other_platforms(name):
    arrays = arrays_of(ENTRIES[name], "f4")
    traced = jax.jit(ENTRIES[name].function).trace(*arrays)
    for platform in ("cpu", "cuda", "tpu"):
        text = traced.lower(lowering_platforms=(platform,)).as_text()
        has_barrier = "optimization_barrier" in text
        assert has_barrier == (HAS_BARRIER[name] and platform != "cpu")


def test_one_artifact_for_all_platforms(entry):
    """Called on a CPU it is the CPU's."""
    arrays = arrays_of(entry, np.float64)
    program = exported(tupled(entry.function), arrays, "cpu", "cuda", "tpu")
    assert program.platforms == ("cpu", "cuda", "tpu")
    check_equal(program.call(*arrays), entry.expected(*arrays), entry)


# Devices


def test_over_two_devices():
    """`shard_map` with its checks on, and axes that are part of the arrays' types."""
    told = json.loads(python("-m", "tests.xla_on_devices", devices=2))
    assert {name: fault for name, fault in told.items() if fault} == {}
    assert {name.split(",")[0] for name in told} == ENTRIES.keys()
    ways = {name.split(", ", 1)[1] for name in told}
    assert {"shard_map", "shard_map, eager"} <= ways
    assert ("explicit axis" in ways) == hasattr(jax, "set_mesh")


@pytest.mark.parametrize("query", [jaxbe.margin, jaxbe.scaled_distance])
def test_a_pullback_may_be_run_on_another_platform(query):
    """What it keeps is in the units of the platform that computed it."""
    bodies = scenes.random(100, seed=3).bodies()

    def slopes(*pair):
        return jax.grad(lambda *x: query(*x).sum(), argnums=(0, 1))(*pair)

    values, pullback = jax.vjp(slopes, *bodies)
    cotangent = jax.tree.map(jnp.ones_like, values)
    leaves, structure = jax.tree.flatten(cotangent)

    def flat(*leaves):
        return jax.tree.leaves(pullback(jax.tree.unflatten(structure, leaves)))

    crossed = exported(flat, leaves, "cuda").call(*leaves)
    for found, expected in zip(crossed, flat(*leaves), strict=True):
        scale = np.nanmax(abs(np.asarray(expected)))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * scale)


@pytest.mark.parametrize("setting", ["0", "false", "OFF", ""])
def test_the_switch_is_on_or_off(setting):
    environment = os.environ | {"JAXBE_XLA": setting}
    words = [sys.executable, "-c", "import jaxbe"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert f"JAXBE_XLA must be on or off, got {setting!r}" in done.stderr
