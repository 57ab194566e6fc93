"""python examples/many_devices.py  (--pairs 4000000 --batches 1000: more; --help: all).

How likely does each of many pairs collide, if the ellipsoids are known to a few
centimetres only? Every batch moves them at random and asks `jaxbe.overlap`. One program
runs on all devices, each with pairs of its own; nothing is sent between them but the
one sum at the end. One machine needs no more than the command above. On a cluster,
one process a node or a device:

    srun python examples/many_devices.py                                (SLURM)
    mpirun python examples/many_devices.py --cluster    (what jax.distributed finds)
    python examples/many_devices.py --coordinator HOST:PORT --processes 2 --process 0
"""

from __future__ import annotations

import argparse
import functools
import os
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from rich.progress import track

import jaxbe


class Result(NamedTuple):
    """Of one run: `overlaps` of `pairs` pairs in all batches, on all devices."""

    overlaps: int
    pairs: int
    seconds: float


def join(options: argparse.Namespace) -> None:
    """Makes this process one of several, if it is; before JAX is used."""
    if options.coordinator:
        jax.distributed.initialize(
            options.coordinator, options.processes, options.process
        )
    elif options.cluster or int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) > 1:
        jax.distributed.initialize()


def over_devices() -> NamedSharding:
    """The first axis of an array cut evenly over all devices of all processes."""
    mesh = jax.make_mesh((jax.device_count(),), ("pairs",), axis_types=(AxisType.Auto,))
    return NamedSharding(mesh, PartitionSpec("pairs"))


def scene(count: int, seed: Sequence[int]) -> tuple[jaxbe.Box, jaxbe.Ellipsoid]:
    """Pairs to compute with, on the host. Yours may come from `np.load(file, "r")`."""
    rng = np.random.default_rng(seed)

    def bodies(kind: Any) -> Any:
        center = rng.uniform(-0.5, 0.5, (count, 3))
        axes = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
        lengths = rng.uniform(0.05, 0.4, (count, 3))
        return kind.on_host(*(x.astype(np.float32) for x in (center, axes, lengths)))

    return bodies(jaxbe.Box), bodies(jaxbe.Ellipsoid)


def own_part(pairs: int, seed: int) -> Any:
    """The pairs of this process's devices and their hits, none yet; on the host."""
    first = jax.process_index() * jax.local_device_count()
    numbers = range(first, first + jax.local_device_count())
    parts = [(scene(pairs, (seed, n)), np.zeros(pairs, np.int32)) for n in numbers]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def batch(
    box: jaxbe.Box,
    ellipsoid: jaxbe.Ellipsoid,
    hits: jax.Array,
    key: jax.Array,
    blur: float,
) -> jax.Array:
    """Adds to the hits (N,) those of the ellipsoids moved by `blur` metres or so."""
    step = blur * jax.random.normal(key, ellipsoid.center.shape, jnp.float32)
    center = ellipsoid.center + step
    moved = jaxbe.Ellipsoid.unchecked(center, ellipsoid.axes, ellipsoid.semi_axes)
    return hits + jaxbe.overlap(box, moved)


def run(options: argparse.Namespace, progress: Callable[[range], Any]) -> Result:
    """Compiles, then counts the overlaps of all batches."""
    sharding = over_devices()
    share = functools.partial(jax.make_array_from_process_local_data, sharding)
    own = own_part(options.pairs, options.seed)
    (box, ellipsoid), hits = jax.tree.map(share, own)
    key = jax.random.key(options.seed)
    blur = jnp.float32(options.blur)
    step = jax.jit(batch, out_shardings=sharding)
    total = jax.jit(lambda hits: jnp.sum(hits, dtype=jnp.int64))
    jax.block_until_ready((total(hits), step(box, ellipsoid, hits, key, blur)))
    start = time.perf_counter()
    for number in progress(range(options.batches)):
        before, hits = (
            hits,
            step(box, ellipsoid, hits, jax.random.fold_in(key, number), blur),
        )
        # One batch is computed while the next one is given out.
        jax.block_until_ready(before)
    overlaps = int(total(hits))
    seconds = time.perf_counter() - start
    return Result(overlaps, hits.size * options.batches, seconds)


def main(arguments: Sequence[str] | None = None) -> Result:
    """Joins the others, counts, and lets the first process say what was found."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--pairs", type=int, default=1_000_000, help="of each device")
    parser.add_argument("--batches", type=int, default=100)
    parser.add_argument("--blur", type=float, default=0.03, help="metres")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cluster", action="store_true", help="jax.distributed finds")
    parser.add_argument("--coordinator", help="HOST:PORT of process 0")
    parser.add_argument("--processes", type=int)
    parser.add_argument("--process", type=int, help="0, 1, ...: which one this is")
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)  # the sum of all hits is a large number
    join(options)
    first = jax.process_index() == 0
    result = run(options, track if first else iter)
    if first:
        print(
            f"{result.overlaps} overlaps of {result.pairs} pairs, "
            f"{result.pairs / result.seconds / 1e6:.1f} M pairs/s, "
            f"{jax.device_count()} devices ({jax.devices()[0].device_kind}) "
            f"of {jax.process_count()} processes"
        )
    return result


if __name__ == "__main__":
    main()
