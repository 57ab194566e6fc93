"""Box and Ellipsoid: construction, validation, being pytrees."""

import dataclasses
import functools
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental import checkify

import jaxbe
from benchmarks import scenes
from jaxbe import Box, Ellipsoid

KINDS = (Box, Ellipsoid)


def no_x64():
    """Float64 off for a while, also with older releases of JAX."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(False)
    from jax.experimental import disable_x64

    return disable_x64()


@pytest.fixture(params=KINDS, ids=lambda kind: kind.__name__)
def kind(request):
    return request.param


def fields(dtype=np.float32):
    return [np.zeros(3, dtype), np.eye(3, dtype=dtype), np.ones(3, dtype)]


def lengths_name(kind):
    return {Box: "half_extents", Ellipsoid: "semi_axes"}[kind]


def test_frozen(kind):
    body = kind(*fields())
    with pytest.raises(dataclasses.FrozenInstanceError):
        body.center = jnp.ones(3)


def test_lists_take_the_default_dtype(kind):
    body = kind([0, 0, 0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [1, 2, 3])
    assert {x.dtype for x in jax.tree.leaves(body)} == {jnp.zeros(()).dtype}


def test_lists_take_the_dtype_of_arrays(kind, dtype):
    body = kind(np.zeros(3, dtype), np.eye(3, dtype=dtype), [1, 2, 3])
    assert {x.dtype for x in jax.tree.leaves(body)} == {dtype}


def test_no_weak_types(kind):
    body = kind(jnp.full(3, 1.0), jnp.eye(3), [1.0, 1.0, 1.0])
    assert not any(x.weak_type for x in jax.tree.leaves(body))


@pytest.mark.parametrize("position", [0, 1, 2])
@pytest.mark.parametrize("bad", [np.int32, np.float16, np.complex64, bool])
def test_wrong_dtype(kind, position, bad):
    given = fields()
    given[position] = given[position].astype(bad)
    name = ["center", "axes", lengths_name(kind)][position]
    message = f"{kind.__name__}: {name} must be float32 or float64, got"
    with pytest.raises(TypeError, match=message):
        kind(*given)


def test_two_dtypes(kind):
    given = fields()
    given[0] = given[0].astype(np.float64)
    with pytest.raises(TypeError, match=r"one dtype.*float64.*float32"):
        kind(*given)


@pytest.mark.parametrize(
    ("position", "shape"), [(0, (2,)), (1, (3,)), (1, (3, 2)), (2, (3, 1)), (0, ())]
)
def test_wrong_shape(kind, position, shape):
    given = fields()
    given[position] = np.ones(shape, np.float32)
    name = ["center", "axes", lengths_name(kind)][position]
    with pytest.raises(ValueError, match=rf"{name} must have shape \(\.\.\., 3"):
        kind(*given)


def test_leading_axes_that_do_not_broadcast(kind):
    given = fields()
    given[0], given[2] = np.zeros((4, 3), np.float32), np.ones((5, 3), np.float32)
    with pytest.raises(ValueError, match=r"leading axes .* must broadcast"):
        kind(*given)


def test_form_errors_are_raised_while_tracing(kind):
    with pytest.raises(ValueError, match="center must have shape"):
        jax.eval_shape(lambda x: kind(x, *fields()[1:]), np.zeros(4, np.float32))


@pytest.mark.parametrize("position", [0, 1, 2])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_must_be_finite(kind, position, bad):
    given = fields()
    given[position].flat[1] = bad
    name = ["center", "axes", lengths_name(kind)][position]
    with pytest.raises(ValueError, match=rf"{name} must be finite, got .*{bad}"):
        kind(*given)


def test_negative_half_extents():
    with pytest.raises(ValueError, match=r"half_extents must be non-negative.*-2\.0"):
        Box(*fields()[:2], [1.0, -2.0, 1.0])
    Box(*fields()[:2], [0.0, 0.0, 0.0])


@pytest.mark.parametrize("length", [0.0, -1.0])
def test_semi_axes_must_be_positive(length):
    with pytest.raises(ValueError, match=rf"semi_axes must be positive.*{length}"):
        Ellipsoid(*fields()[:2], [1.0, length, 1.0])


def test_the_first_bad_value_of_a_batch_is_named():
    half_extents = np.ones((2, 3, 3), np.float32)
    half_extents[1, 2, 0] = -3.0
    message = r"got \[-3\.0, 1\.0, 1\.0\] at batch index \(1, 2\)"
    with pytest.raises(ValueError, match=message):
        Box(*fields()[:2], half_extents)


def test_axes_must_be_orthonormal(kind, dtype):
    center, axes, lengths = fields(dtype)
    tolerance = 1000 * np.finfo(dtype).eps
    for error in (tolerance, 0.1):
        skew = axes.copy()
        skew[0, 1] = 2 * error
        with pytest.raises(ValueError, match="axes must be orthonormal"):
            kind(center, skew, lengths)
    skew[0, 1] = tolerance / 2
    kind(center, skew, lengths)


def test_mirrored_axes_are_legal(kind):
    center, axes, lengths = fields()
    assert np.array_equal(kind(center, -axes, lengths).axes, -axes)


def test_random_rotations_are_orthonormal_enough(kind, dtype):
    """A batch of them all pass: the tolerance is not tighter than rounding."""
    wxyz = np.random.default_rng(0).normal(size=(10_000, 4))
    axes = scenes.rotations(wxyz).astype(dtype)
    body = kind(np.zeros(3, dtype), axes, np.ones(3, dtype))
    assert body.check_form() == (10_000,)


def test_from_quaternion(kind, dtype):
    """A quarter turn about z takes x to y; the length of the quaternion is free."""
    for size in (1e-15, 1.0, 1e15):
        wxyz = size * np.array([1, 0, 0, 1], dtype)
        body = kind.from_quaternion(np.zeros(3, dtype), wxyz, np.ones(3, dtype))
        expected = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
        np.testing.assert_allclose(body.axes, expected, atol=2 * np.finfo(dtype).eps)
        assert body.axes.dtype == dtype


def test_from_quaternion_is_orthonormal(kind, dtype):
    wxyz = np.random.default_rng(0).normal(size=(1000, 4)).astype(dtype)
    body = kind.from_quaternion(np.zeros(3, dtype), wxyz, np.ones(3, dtype))
    kind(*jax.tree.leaves(body))  # passes the check of the axes
    assert np.all(np.linalg.det(body.axes) > 0)


def test_from_quaternion_errors(kind):
    center, _, lengths = fields()
    with pytest.raises(ValueError, match="wxyz must be of non-zero length"):
        kind.from_quaternion(center, [0, 0, 0, 0], lengths)
    with pytest.raises(ValueError, match=r"wxyz must have shape \(\.\.\., 4\)"):
        kind.from_quaternion(center, [1, 0, 0], lengths)
    with pytest.raises(ValueError, match=f"{lengths_name(kind)} must be"):
        kind.from_quaternion(center, [1, 0, 0, 0], -lengths)


def test_from_quaternion_is_differentiable():
    def height(wxyz):
        body = Box.from_quaternion([0, 0, 0], wxyz, [1, 1, 1])
        return body.axes[2, 0]

    wxyz = jnp.array([0.9, 0.1, -0.3, 0.2])
    slope = jax.grad(height)(wxyz)
    step = 1e-6 * np.eye(4)
    expected = [(height(wxyz + s) - height(wxyz - s)) / 2e-6 for s in step]
    np.testing.assert_allclose(slope, expected, atol=1e-8)


def test_pytree_round_trip(kind):
    body = kind(*fields())
    leaves, treedef = jax.tree.flatten(body)
    again = jax.tree.unflatten(treedef, leaves)
    assert type(again) is kind
    assert all(x is y for x, y in zip(jax.tree.leaves(again), leaves, strict=True))


def test_unflattening_takes_anything(kind):
    """Gradients, axis numbers and masks are bodies too."""
    body = kind(*fields())
    negative = jax.tree.map(lambda x: -x, body)
    assert np.all(getattr(negative, lengths_name(kind)) < 0)
    assert jax.tree.leaves(jax.tree.map(lambda x: None, body)) == []


def test_paths_are_named(kind):
    paths = [p for p, _ in jax.tree_util.tree_leaves_with_path(kind(*fields()))]
    names = [jax.tree_util.keystr(p) for p in paths]
    assert names == [".center", ".axes", f".{lengths_name(kind)}"]


def test_constructors_work_while_tracing(kind):
    """Constants are checked even there, traced values are not read."""

    @jax.jit
    def build(center):
        return kind(center, *fields()[1:])

    assert np.isnan(build(np.full(3, np.nan, np.float32)).center).all()


def test_unchecked_reads_no_values(kind):
    given = fields()
    given[0][0] = np.nan
    assert np.isnan(kind.unchecked(*given).center[0])
    with pytest.raises(ValueError, match="center must have shape"):
        kind.unchecked(np.zeros(2, np.float32), *fields()[1:])
    with pytest.raises(TypeError, match="must be float32"):
        kind.unchecked(np.zeros(3, int), *fields()[1:])


def moved_afterwards(build, *arrays):
    """The fields of a body, built of arrays that change as soon as it is there."""
    body = build(*arrays)
    for x in arrays:
        x += 1
    return [np.asarray(x) for x in jax.tree.leaves(body)]


@pytest.mark.parametrize("build", ["__call__", "unchecked", "from_quaternion"])
def test_bodies_share_no_memory_with_numpy(kind, build, dtype):
    """JAX takes over arrays of NumPy where they are, if they are aligned there."""
    build = kind if build == "__call__" else getattr(kind, build)
    for count in (1, 2, 3, 64, 1000):
        arrays = [np.repeat(x[None], count, axis=0) for x in fields(dtype)]
        if build == kind.from_quaternion:
            arrays[1] = np.repeat(np.eye(4, dtype=dtype)[:1], count, axis=0)
        found = moved_afterwards(build, *arrays)
        for x, expected in zip(found, fields(dtype), strict=True):
            assert np.all(x == expected)


def test_bodies_on_the_host_stay_where_they_are(kind):
    arrays = fields()
    found = moved_afterwards(kind.on_host, *arrays)
    assert all(np.all(x == y) for x, y in zip(found, arrays, strict=True))


@pytest.mark.parametrize("as_traced", [False, True])
def test_float64_bodies_where_float64_is_off(method, as_traced):
    """Built where it was on: once an answer of two booleans, one of them wrong."""
    bodies = Box(*fields(np.float64)), Ellipsoid(*fields(np.float64))
    overlap = functools.partial(jaxbe.overlap, method=method)
    overlap = jax.jit(overlap) if as_traced else overlap
    assert overlap(*bodies)
    with no_x64(), pytest.raises(TypeError, match=r"Box: center is float64.*x64"):
        overlap(*bodies)
    assert overlap(*bodies)


def test_denormal_lengths_count_as_zero(kind, dtype):
    """As in compiled programs; once axes of NaN, and a pair that never is apart."""
    denormal = np.full(4, np.finfo(dtype).tiny / 4, dtype)
    center, _, lengths = fields(dtype)
    with pytest.raises(ValueError, match=r"wxyz must be of non-zero length.*denormal"):
        kind.from_quaternion(center, denormal, lengths)
    if kind is Ellipsoid:
        with pytest.raises(ValueError, match=r"semi_axes must be positive.*denormal"):
            kind(center, np.eye(3, dtype=dtype), denormal[:3])
    else:
        kind(center, np.eye(3, dtype=dtype), denormal[:3])
    smallest = np.full(4, np.finfo(dtype).tiny, dtype)
    kind.from_quaternion(center, smallest, smallest[:3])


def test_queries_name_what_is_wrong_with_the_pair(method):
    box, ellipsoid = Box(*fields()), Ellipsoid(*fields())
    overlap = functools.partial(jaxbe.overlap, method=method)
    with pytest.raises(TypeError, match=r"box must be a jaxbe\.Box, got Ellipsoid"):
        overlap(ellipsoid, box)
    with pytest.raises(TypeError, match=r"ellipsoid must be a jaxbe\.Ellipsoid"):
        overlap(box, box)
    with pytest.raises(TypeError, match="one dtype, got float32 and float64"):
        overlap(box, Ellipsoid(*fields(np.float64)))
    with pytest.raises(ValueError, match=r"batch shapes .* got \(4,\) and \(5,\)"):
        overlap(
            Box(np.zeros((4, 3), np.float32), *fields()[1:]),
            Ellipsoid(np.zeros((5, 3), np.float32), *fields()[1:]),
        )
    broken = jax.tree.map(lambda x: x[..., :2], box)
    with pytest.raises(ValueError, match="Box: center must have shape"):
        overlap(broken, ellipsoid)


def test_unknown_method():
    with pytest.raises(ValueError, match=r"one of closest_features, .* got 'sat'"):
        jaxbe.overlap(Box(*fields()), Ellipsoid(*fields()), method="sat")


def test_checked_passes_legal_values(dtype):
    box, ellipsoid = Box(*fields(dtype)), Ellipsoid(*fields(dtype))
    assert jaxbe.checked(jaxbe.overlap)(box, ellipsoid)
    assert jaxbe.checked(jax.vmap(jaxbe.overlap, in_axes=(None, 0)))(
        box, jax.tree.map(lambda x: jnp.stack([x, x]), ellipsoid)
    ).all()


@pytest.mark.parametrize(
    ("field", "index", "value", "message"),
    [
        ("center", 0, np.nan, "Box: center must be finite"),
        ("axes", (0, 1), 0.5, "Box: axes must be orthonormal"),
        ("half_extents", 2, -1.0, "Box: half_extents must be non-negative"),
    ],
)
def test_checked_finds_bad_values_of_a_box(field, index, value, message):
    box = Box(*fields())
    arrays = box.fields()
    arrays[field] = arrays[field].at[index].set(value)
    bad = Box.unchecked(*arrays.values())
    overlap = jaxbe.checked(functools.partial(jaxbe.overlap, method="minkowski"))
    with pytest.raises(checkify.JaxRuntimeError, match=message):
        overlap(bad, Ellipsoid(*fields()))


def test_checked_finds_bad_semi_axes_in_a_batch():
    ellipsoid = Ellipsoid.unchecked(
        *fields()[:2], np.array([[1, 1, 1], [1, 0, 1.0]], "f")
    )
    with pytest.raises(checkify.JaxRuntimeError, match="semi_axes must be positive"):
        jaxbe.checked(jaxbe.overlap)(Box(*fields()), ellipsoid)


def test_float32_alone():
    """The library without x64, as most users run it: a fresh interpreter."""
    program = """
import jax, numpy as np, jaxbe
assert not jax.config.jax_enable_x64
box = jaxbe.Box([0, 0, 0], np.eye(3), [1, 1, 1])
ball = jaxbe.Ellipsoid.from_quaternion([2.5, 0, 0], [1, 0, 0, 0], [2, 1, 1])
assert box.axes.dtype == "float32"
for method in jaxbe.METHODS:
    assert jaxbe.overlap(box, ball, method=method)
print(float(jaxbe.scaled_distance(box, ball)))
"""
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert float(run.stdout) == 0.75
