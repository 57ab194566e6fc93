"""Batches that stay on the host, computed chunk by chunk."""

import functools
import gc
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from tests.test_shapes import no_x64

BATCHES = [
    ((300,), (300,)),
    ((), (300,)),
    ((300,), ()),
    ((30, 1), (1, 70)),
    ((2, 1, 1), (5, 130)),
    ((1,), (1,)),
    ((), ()),
]


def pairs(box_batch, ellipsoid_batch, dtype, seed=0):
    """Bodies in NumPy arrays; some touch, and some do not."""
    rng = np.random.default_rng(seed)
    return (
        jaxbe.Box.on_host(*fields(rng, box_batch, dtype)),
        jaxbe.Ellipsoid.on_host(*fields(rng, ellipsoid_batch, dtype)),
    )


def fields(rng, batch, dtype):
    center = rng.uniform(-1, 1, (*batch, 3))
    axes = scenes.rotations(rng.normal(size=(math.prod(batch), 4)))
    lengths = rng.uniform(0.1, 1, (*batch, 3))
    return [x.astype(dtype) for x in (center, axes.reshape(*batch, 3, 3), lengths)]


def check_same(found, expected, roundings):
    """The same tree of the same arrays, floats to so many units of rounding."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    leaves = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    for x, y in leaves:
        assert type(x) is np.ndarray
        assert (x.shape, x.dtype) == (y.shape, y.dtype)
        if x.dtype == bool:
            np.testing.assert_array_equal(x, y)
        else:
            rtol = roundings * float(np.finfo(x.dtype).eps)
            np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol)


@functools.cache
def compilations():
    """A list that grows by one with every program that XLA compiles."""
    seen = []

    def listen(event, duration, **_):
        if event == "/jax/core/compile/backend_compile_duration":
            seen.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    return seen


@pytest.mark.parametrize("batches", BATCHES, ids=str)
@pytest.mark.parametrize("most", [40, 10**6])
def test_the_same_as_in_one_piece(batches, most, dtype):
    bodies = pairs(*batches, dtype)
    found = jaxbe.chunked(jaxbe.overlap, pairs_per_chunk=most)(*bodies)
    assert found.shape == np.broadcast_shapes(*batches)
    check_same(found, jax.jit(jaxbe.overlap)(*bodies), 0)


@pytest.mark.parametrize("batches", BATCHES[2:4], ids=str)
def test_floats_and_tuples(batches, dtype):
    bodies = pairs(*batches, dtype)
    bounds = functools.partial(jaxbe.margin_bounds, steps=1)
    found = jaxbe.chunked(bounds, pairs_per_chunk=128)(*bodies)
    check_same(found, jax.jit(bounds)(*bodies), 50)


def test_named_tuples_with_vectors():
    bodies = pairs((40,), (40,), np.float32)
    contact = functools.partial(jaxbe.contact, steps=1)
    found = jaxbe.chunked(contact, pairs_per_chunk=16)(*bodies)
    assert isinstance(found, jaxbe.Contact)
    check_same(found, jax.jit(contact)(*bodies), 1000)


def test_gradients_of_each_pair():
    bodies = pairs((100,), (100,), np.float32)
    margin = functools.partial(jaxbe.margin, steps=1)
    slopes = jax.vmap(jax.value_and_grad(margin, argnums=(0, 1)))
    value, (box, ellipsoid) = jaxbe.chunked(slopes, pairs_per_chunk=32)(*bodies)
    assert isinstance(box, jaxbe.Box)
    assert isinstance(ellipsoid, jaxbe.Ellipsoid)
    found = value, box.fields(), ellipsoid.fields()
    value, (box, ellipsoid) = jax.jit(slopes)(*bodies)
    check_same(found, (value, box.fields(), ellipsoid.fields()), 1000)


def test_one_program_for_all_chunks_and_all_lengths(dtype):
    function = jaxbe.chunked(jaxbe.overlap, pairs_per_chunk=64)
    batches = [pairs((n,), (n,), dtype) for n in (1000, 64, 777)]
    before = len(compilations())
    for bodies in batches:
        function(*bodies)
    assert len(compilations()) == before + 1


@pytest.mark.parametrize("batch", [(0,), (3, 0)])
def test_no_pairs(batch, dtype):
    bodies, before = pairs(batch, (1,), dtype), len(compilations())
    found = jaxbe.chunked(jaxbe.margin_bounds)(*bodies)
    assert [x.shape for x in found] == [batch, batch]
    assert {x.dtype for x in found} == {dtype}
    assert len(compilations()) == before


def test_nan_stays_where_it_is(dtype):
    box, ellipsoid = pairs((50,), (50,), dtype)
    box.center[[7, 49]] = np.nan
    found = jaxbe.chunked(jaxbe.margin, pairs_per_chunk=8)(box, ellipsoid)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found)), [7, 49])
    kept = jaxbe.chunked(jaxbe.overlap, pairs_per_chunk=8)(box, ellipsoid)
    assert kept[[7, 49]].all()


def memory_mapped(folder, body):
    """The same body, its fields in files."""
    files = []
    for name, x in body.fields().items():
        np.save(folder / f"{type(body).__name__}-{name}.npy", x)
        files.append(np.load(folder / f"{type(body).__name__}-{name}.npy", "r"))
    return type(body).on_host(*files)


def test_memory_mapped(tmp_path, dtype):
    bodies = pairs((500,), (500,), dtype)
    mapped = [memory_mapped(tmp_path, body) for body in bodies]
    for x in jax.tree.leaves(mapped):
        assert isinstance(x, np.memmap) or isinstance(x.base, np.memmap)
    found = jaxbe.chunked(jaxbe.margin, pairs_per_chunk=128)(*mapped)
    expected = jaxbe.chunked(jaxbe.margin, pairs_per_chunk=128)(*bodies)
    np.testing.assert_array_equal(found, expected)


WIDE = 10_000


def live_bytes():
    return sum(x.nbytes for x in jax.live_arrays())


def held(batches, dtype, most=64):
    """The bytes in arrays on the device: within every chunk, and after sending each.

    Results are `WIDE` bytes a pair, so that one too many shows.
    """
    within, after = [], []

    def watched(box, ellipsoid):
        jax.debug.callback(lambda: within.append(live_bytes()))
        touching = jaxbe.overlap(box, ellipsoid)
        return jnp.broadcast_to(touching[..., None], (*touching.shape, WIDE))

    def progress(chunks):
        for number in chunks:
            yield number
            after.append(live_bytes())

    gc.collect()
    before, bodies = live_bytes(), pairs(*batches, dtype)
    jaxbe.chunked(watched, pairs_per_chunk=most, progress=progress)(*bodies)
    jax.effects_barrier()
    assert len(within) == -(-np.prod(np.broadcast_shapes(*batches)) // most)
    return np.array(within) - before, np.array(after) - before


@pytest.mark.parametrize("chunks", [4, 40])
def test_the_device_holds_two_chunks(chunks, dtype):
    """The inputs of two; the result of one, while that of the other is computed."""
    within, after = held(((64 * chunks,), (64 * chunks,)), dtype)
    inputs, result = 64 * 30 * dtype.itemsize, 64 * WIDE
    assert within.max() <= 2 * inputs + result
    assert after.max() <= inputs + result
    assert after.min() >= result


def test_what_broadcasts_is_not_expanded(dtype):
    number = 15 * dtype.itemsize
    one, _ = held(((), (64 * 10,)), dtype)
    assert one.max() <= 2 * (number + 64 * number) + 64 * WIDE
    rows, _ = held(((80, 1), (1, 32)), dtype)
    assert rows.max() <= 2 * (2 * number + 32 * number) + 64 * WIDE


def test_the_program_knows_only_a_chunk(dtype):
    """So that its memory does not grow with the batch."""
    seen = []

    def margin(box, ellipsoid):
        seen.append({x.shape[0] for x in jax.tree.leaves((box, ellipsoid))})
        return jaxbe.margin(box, ellipsoid)

    jaxbe.chunked(margin, pairs_per_chunk=64)(*pairs((6400,), (6400,), dtype))
    assert seen
    assert all(lengths == {64} for lengths in seen)


def test_progress_is_told_of_every_chunk(dtype):
    told = []

    def progress(chunks):
        assert len(chunks) == 5
        for number in chunks:
            told.append(number)
            yield number

    function = jaxbe.chunked(jaxbe.overlap, pairs_per_chunk=64, progress=progress)
    assert function(*pairs((300,), (), dtype)).shape == (300,)
    assert told == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("kept", [(), (0, 1), (1, 2, 3, 4), (0, 1, 2, 3)])
def test_progress_that_leaves_out_chunks(kept):
    """Once there was uninitialised memory in their places."""
    function = jaxbe.chunked(
        jaxbe.overlap,
        pairs_per_chunk=64,
        progress=lambda chunks: (i for i in chunks if i in kept),
    )
    message = rf"progress must yield .* {5 - len(kept)} of 5 chunks are missing"
    with pytest.raises(ValueError, match=message):
        function(*pairs((300,), (), np.float32))


def test_results_that_are_random_keys():
    def keys(box, ellipsoid):
        seeds = box.center[..., 0].astype(np.uint32)
        return jax.vmap(jax.random.key)(seeds)

    function = jaxbe.chunked(keys, pairs_per_chunk=64)
    with pytest.raises(TypeError, match=r"got key<.*return jax\.random\.key_data"):
        function(*pairs((300,), (), np.float32))


def test_bodies_on_the_device_are_taken_too(dtype):
    bodies = pairs((100,), (100,), dtype)
    on_device = jaxbe.Box(*bodies[0].fields().values()), bodies[1]
    function = jaxbe.chunked(jaxbe.margin, pairs_per_chunk=30)
    np.testing.assert_array_equal(function(*on_device), function(*bodies))


def test_float64_is_rounded_where_jax_has_none():
    bodies = pairs((100,), (100,), np.float64)
    with no_x64():
        found = jaxbe.chunked(jaxbe.margin, pairs_per_chunk=30)(*bodies)
    assert found.dtype == np.float32
    rounded = jax.tree.map(lambda x: x.astype(np.float32), bodies)
    expected = jaxbe.chunked(jaxbe.margin, pairs_per_chunk=30)(*rounded)
    np.testing.assert_array_equal(found, expected)


def test_map_bounds_the_memory_inside_jit():
    """What `chunked` says of `jax.lax.map`."""
    bodies = pairs((96,), (96,), np.float32)
    margin = functools.partial(jaxbe.margin, steps=1)

    def total(bodies):
        return jax.lax.map(lambda pair: margin(*pair), bodies, batch_size=32).sum()

    found = jax.jit(jax.grad(total))(bodies)
    expected = jax.jit(jax.grad(lambda pair: margin(*pair).sum()))(bodies)
    for x, y in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-4)


def test_on_host_keeps_the_arrays(dtype):
    given = fields(np.random.default_rng(0), (5,), dtype)
    body = jaxbe.Box.on_host(*given)
    for x, y in zip(given, body.fields().values(), strict=True):
        assert x is y


def test_on_host_checks_the_form():
    given = fields(np.random.default_rng(0), (5,), np.float32)
    with pytest.raises(ValueError, match=r"Box: half_extents must have shape"):
        jaxbe.Box.on_host(*given[:2], given[2][:, :2])
    with pytest.raises(TypeError, match=r"Box: its fields must have one dtype"):
        jaxbe.Box.on_host(*given[:2], given[2].astype(np.float64))
    with pytest.raises(TypeError, match=r"Box: center must be float32 or float64"):
        jaxbe.Box.on_host(given[0].astype(">f4"), *given[1:])
    assert jaxbe.Box.on_host([0, 0, 0], given[1], [1, 2, 3]).center.dtype == np.float32


@pytest.mark.parametrize("most", [1.5, "many", None])
def test_a_count_that_is_no_integer(most):
    with pytest.raises(TypeError, match="pairs_per_chunk must be a Python integer"):
        jaxbe.chunked(jaxbe.overlap, pairs_per_chunk=most)


@pytest.mark.parametrize("most", [0, -1, 2**31])
def test_a_count_out_of_range(most):
    with pytest.raises(ValueError, match="pairs_per_chunk must be from 1 to"):
        jaxbe.chunked(jaxbe.overlap, pairs_per_chunk=most)


def test_bad_arguments():
    box, ellipsoid = pairs((4,), (4,), np.float32)
    overlap = jaxbe.chunked(jaxbe.overlap)
    with pytest.raises(TypeError, match="function must be callable, got 3"):
        jaxbe.chunked(3)
    with pytest.raises(TypeError, match=r"box must be a jaxbe\.Box, got Ellipsoid"):
        overlap(ellipsoid, box)
    with pytest.raises(TypeError, match="box and ellipsoid must have one dtype"):
        overlap(box, pairs((4,), (4,), np.float64)[1])
    with pytest.raises(ValueError, match=r"must broadcast, got \(4,\) and \(3,\)"):
        overlap(box, pairs((3,), (3,), np.float32)[1])
    with pytest.raises(TypeError, match=r"box is traced.*lax\.map"):
        jax.jit(overlap)(box, ellipsoid)


def test_a_function_that_mixes_the_pairs():
    bodies = pairs((4,), (4,), np.float32)
    with pytest.raises(ValueError, match=r"for \(4,\) it returned \(\)"):
        jaxbe.chunked(lambda *pair: jnp.sum(jaxbe.margin(*pair)))(*bodies)
