"""A program of `test_scale.py`: one of several processes, each with its own pairs.

python -m tests.on_processes PORT PROCESS PROCESSES EACH  prints one JSON object.
"""

from __future__ import annotations

import functools
import json
import sys

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import jaxbe
from tests.on_devices import COLLECTIVE, roundings
from tests.test_chunked import fields


def own_fields(process, each):
    """The fields of a box and of an ellipsoid, (each, ...)."""
    rng = np.random.default_rng(process)
    return [fields(rng, (each,), np.dtype(np.float32)) for _ in range(2)]


def own_rows(x):
    """What this process has of an array, in order."""
    shards = sorted(x.addressable_shards, key=lambda shard: shard.index[0].start)
    return np.concatenate([np.asarray(shard.data) for shard in shards])


def main(port, process, processes, each):
    jax.distributed.initialize(
        f"127.0.0.1:{port}", processes, process, initialization_timeout=60
    )
    count = jax.device_count()
    mesh = jax.make_mesh((count,), ("pairs",), axis_types=(AxisType.Auto,))
    sharding = NamedSharding(mesh, PartitionSpec("pairs"))
    own = own_fields(process, each)
    share = functools.partial(jax.make_array_from_process_local_data, sharding)
    given = jax.tree.map(share, own)
    everywhere = jaxbe.Box(*given[0]), jaxbe.Ellipsoid(*given[1])
    here = jaxbe.Box(*own[0]), jaxbe.Ellipsoid(*own[1])
    told = {"devices": count, "local devices": jax.local_device_count()}
    for function in (jaxbe.overlap, jaxbe.margin):
        program = jax.jit(function).lower(*everywhere).compile()
        found = program(*everywhere)
        told[function.__name__] = {
            "collectives": sorted(set(COLLECTIVE.findall(program.as_text()))),
            "pairs": found.size,
            "rows": sorted({s.data.shape[0] for s in found.addressable_shards}),
            "roundings": roundings(own_rows(found), jax.jit(function)(*here)),
        }
    touching = jax.jit(jaxbe.overlap)(*everywhere)
    told["here"] = int(own_rows(touching).sum())
    told["in all"] = int(jax.jit(jnp.sum)(touching))
    print(json.dumps(told))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
