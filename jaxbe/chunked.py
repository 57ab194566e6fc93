"""Batches that no device has room for: they stay on the host, and go chunk by chunk."""

from __future__ import annotations

import functools
import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbe import validate
from jaxbe.pose import batch_shape
from jaxbe.shapes import Box, Ellipsoid

IN_FLIGHT = 2
"""Chunks on the device at once: one computes while the next is on its way."""

MAX_PAIRS = 2**31 - 1

Body = Box | Ellipsoid
Shape = tuple[int, ...]


def chunked(
    function: Callable[[Box, Ellipsoid], Any],
    *,
    pairs_per_chunk: int = 2**18,
    progress: Callable[[range], Iterable[int]] | None = None,
) -> Callable[[Box, Ellipsoid], Any]:
    """Computes in chunks of pairs what does not fit into a device's memory at once.

    The bodies stay on the host, also memory-mapped from disk, if built by
    `Box.on_host` and `Ellipsoid.on_host`. Batch axes that broadcast are never expanded,
    on the host or on the way: of one box and N ellipsoids the box is sent as it is, of
    (A, 1) and (1, B) the rows and columns of a block. All chunks have one shape (the
    last one of an axis repeats its last pair, and that is cut off), so that one program
    is compiled. While one chunk is computed the next is sent: the device holds the
    inputs, results and temporaries of two chunks, however long the batch is.

    On arrays that fit, `jax.lax.map(f, pairs, batch_size=n)` bounds the temporaries
    inside `jit`, and can be differentiated.

    Args:
        function: answers pair by pair, as all of jaxbe's do: of a box and an ellipsoid,
            results whose leading axes are the common batch shape. Bind options first,
            as in `chunked(functools.partial(margin, steps=3))`. It is compiled here.
        pairs_per_chunk: the most pairs at once, at least 1. A float32 pair takes 120
            bytes on the device, and what its result and its temporaries take.
        progress: wraps the range of chunks, to show how far they are:
            `rich.progress.track` or `tqdm.tqdm`. It has to yield all of them.

    Returns:
        A function of the same arguments (not to be called inside `jit`) and result, in
        NumPy arrays on the host: equal to the bit where the same program is made of a
        chunk and of the whole, and else to rounding. Arrays of float64 are rounded to
        float32 where JAX has float64 switched off, as by the constructors.

    Raises:
        TypeError: a function that cannot be called, or a count that is not an integer;
            from the function returned: arguments that are not a Box and an Ellipsoid of
            one dtype, or traced ones, or results that are random keys.
        ValueError: a count out of range; from the function returned: batch shapes that
            do not broadcast, arrays on the devices of other processes, results that
            are not of the batch shape, or chunks that `progress` left out.
    """
    if not callable(function):
        raise TypeError(f"function must be callable, got {function!r}")
    most = validate.as_count("pairs_per_chunk", pairs_per_chunk, 1, MAX_PAIRS)
    compiled = jax.jit(function)

    @functools.wraps(function)
    def call(box: Box, ellipsoid: Ellipsoid) -> Any:
        batch = batch_shape(box, ellipsoid)
        bodies = _on_host("box", box), _on_host("ellipsoid", ellipsoid)
        chunks = _Chunks(batch, _chunk_shape(batch, most))
        leaves, structure = _results(compiled, bodies, chunks)
        _run(compiled, bodies, chunks, leaves, progress or iter)
        return jax.tree.unflatten(structure, leaves)

    return call


class _Chunks(NamedTuple):
    """A batch cut into blocks of one shape, counted along its last axes first."""

    batch: Shape
    shape: Shape

    def total(self) -> int:
        return math.prod(self._grid())

    def start(self, number: int) -> Shape:
        place = np.unravel_index(number, self._grid()) if self.batch else ()
        return tuple(int(i) * n for i, n in zip(place, self.shape, strict=True))

    def _grid(self) -> Shape:
        each = zip(self.batch, self.shape, strict=True)
        return tuple(-(-size // length) for size, length in each)


def _chunk_shape(batch: Shape, most: int) -> Shape:
    """A block of at most so many pairs; whole along the last axes where they fit.

    The first axis is cut at `most`, whatever its length: one program for all lengths.
    A later one is cut evenly, since what is left of it comes again in every row.
    """
    lengths: list[int] = []
    for axis in reversed(range(len(batch))):
        pieces = max(1, -(-batch[axis] // most))
        even = -(-batch[axis] // pieces)
        lengths.insert(0, max(1, most if axis == 0 and pieces > 1 else even))
        most = max(1, most // lengths[0])
    return tuple(lengths)


def _on_host(name: str, body: Body) -> Body:
    for x in body.fields().values():
        if isinstance(x, jax.core.Tracer):
            raise TypeError(
                f"{name} is traced, but chunks are run from the host: not inside jit, "
                "vmap or grad (there, jax.lax.map has a batch_size)"
            )
        if not validate.is_readable(x):
            raise ValueError(f"{name} must not be on the devices of other processes")
    return type(body).on_host(*body.fields().values())


def _cut(body: Body, chunks: _Chunks, start: Shape) -> Body:
    """The part of a body in the block from `start` on; broadcast axes stay at one."""

    def part(name: str, x: np.ndarray) -> np.ndarray:
        axes = validate.batch_axes(name, x)
        first = len(chunks.batch) - len(axes)
        for axis, size in enumerate(axes):
            if size != 1:
                begin, length = start[first + axis], chunks.shape[first + axis]
                x = _slice(x, axis, begin, length)
        return x

    return type(body).on_host(*(part(n, x) for n, x in body.fields().items()))


def _slice(x: np.ndarray, axis: int, begin: int, length: int) -> np.ndarray:
    """So many entries of an axis; past its end the last one again."""
    here = (slice(None),) * axis
    x = x[(*here, slice(begin, begin + length))]
    if 0 < x.shape[axis] < length:
        widths = [(0, 0)] * x.ndim
        widths[axis] = (0, length - x.shape[axis])
        x = np.pad(x, widths, mode="edge")
    return x


def _results(
    compiled: Callable[..., Any], bodies: tuple[Body, Body], chunks: _Chunks
) -> tuple[list[np.ndarray], Any]:
    """Room for the results of the whole batch: arrays and their tree."""
    start = (0,) * len(chunks.batch)
    first = [_cut(body, chunks, start) for body in bodies]
    found, structure = jax.tree.flatten(
        jax.eval_shape(compiled, *jax.tree.map(_form, first))
    )
    leading = tuple(map(min, chunks.shape, chunks.batch))
    rank = len(leading)
    for x in found:
        if not isinstance(x.dtype, np.dtype):
            raise TypeError(
                f"function must return arrays that NumPy has, got {x.dtype}: of random "
                "keys return jax.random.key_data"
            )
        if x.shape[:rank] != leading:
            raise ValueError(
                "function must return arrays whose leading axes are the batch shape: "
                f"for {leading} it returned {x.shape}"
            )
    rooms = [np.empty(chunks.batch + x.shape[rank:], x.dtype) for x in found]
    return rooms, structure


def _form(x: np.ndarray) -> Any:
    """Shape and dtype on the device."""
    dtype = jax.dtypes.canonicalize_dtype(x.dtype)
    return jax.ShapeDtypeStruct(x.shape, dtype)  # type: ignore[no-untyped-call]


def _run(
    compiled: Callable[..., Any],
    bodies: tuple[Body, Body],
    chunks: _Chunks,
    rooms: list[np.ndarray],
    progress: Callable[[range], Iterable[int]],
) -> None:
    """Fills the rooms. JAX returns before a chunk is computed; fetching it waits."""
    sent: deque[tuple[Shape, Any]] = deque()
    left = set(range(chunks.total()))
    for number in progress(range(chunks.total())):
        left.discard(number)
        start = chunks.start(number)
        # Never named here: an array that has a name stays on the device.
        sent.append((start, compiled(*_send(bodies, chunks, start))))
        if len(sent) == IN_FLIGHT:
            _fetch(*sent.popleft(), chunks, rooms)
    while sent:
        _fetch(*sent.popleft(), chunks, rooms)
    if left:
        raise ValueError(
            "progress must yield every number of the range that it is given, but "
            f"{len(left)} of {chunks.total()} chunks are missing, the first one "
            f"{min(left)}"
        )


def _send(bodies: tuple[Body, Body], chunks: _Chunks, start: Shape) -> Any:
    return jax.device_put(tuple(_cut(body, chunks, start) for body in bodies))


def _fetch(start: Shape, result: Any, chunks: _Chunks, rooms: list[np.ndarray]) -> None:
    each = zip(start, chunks.shape, chunks.batch, strict=True)
    place = tuple(slice(a, min(a + n, size)) for a, n, size in each)
    filled = tuple(slice(0, s.stop - s.start) for s in place)
    for room, x in zip(rooms, jax.tree.leaves(result), strict=True):
        room[place] = np.asarray(x)[filled]
