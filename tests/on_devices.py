"""A program of `test_scale.py`: kernels over all devices, and alone, compared.

python -m tests.on_devices AXIS_TYPE DTYPE  prints one JSON object, a kernel an entry.
"""

from __future__ import annotations

import functools
import json
import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import jaxbe
from tests.test_chunked import fields

COLLECTIVE = re.compile(r"all-reduce|all-gather|all-to-all|collective|reduce-scatter")
"""What sends between devices."""

EACH = 13
"""Pairs of a device: no other axis in the programs has this length, or that of all."""


def summed(box, ellipsoid):
    """Not free of collectives: shows that they would be seen."""
    return jnp.sum(jaxbe.overlap(box, ellipsoid))[None]


def margin_and_gradient(box, ellipsoid):
    margin = functools.partial(jaxbe.margin, steps=1)
    return margin(box, ellipsoid), jax.grad(
        lambda *pair: margin(*pair).sum(), argnums=(0, 1)
    )(box, ellipsoid)


def moved(box, ellipsoid):
    """The example's batch: with random numbers for every pair."""
    from many_devices import batch

    hits = jnp.zeros_like(ellipsoid.center[:, 0], jnp.int32)
    blur = jnp.asarray(0.1, jnp.float32)
    return batch(box, ellipsoid, hits, jax.random.key(0), blur)


KERNELS = {
    "overlap": jaxbe.overlap,
    "margin": functools.partial(jaxbe.margin, steps=2),
    "gradient": margin_and_gradient,
}

MORE = {
    "contact": functools.partial(jaxbe.contact, steps=1),
    "example": moved,
    "sum": summed,
}
"""Under automatic axes only: they take long to compile, or are no kernels."""


def compared(kernel, bodies, spread):
    """What the program over all devices is made of, and how far off its answers are."""
    program = jax.jit(kernel).lower(*spread).compile()
    alone = jax.jit(kernel).lower(*bodies).compile()
    found, expected = program(*spread), alone(*bodies)
    leaves = jax.tree.leaves(found)
    text, whole = program.as_text(), EACH * jax.device_count()
    return {
        "collectives": sorted(set(COLLECTIVE.findall(text))),
        "whole arrays": len(re.findall(rf"\[{whole}[],]", text)),
        "parts": len(re.findall(rf"\[{EACH}[],]", text)),
        "rows": sorted({s.data.shape[0] for x in leaves for s in x.addressable_shards}),
        "devices": sorted({len(x.sharding.device_set) for x in leaves}),
        "flops": program.cost_analysis()["flops"] / alone.cost_analysis()["flops"],
        "roundings": max(map(roundings, leaves, jax.tree.leaves(expected))),
    }


def roundings(x, y):
    """The largest difference in units of rounding of max(1, |y|)."""
    x, y = np.asarray(x), np.asarray(y)
    if x.dtype.kind in "bi":
        return float(np.sum(x != y)) * 1e9
    return float(
        np.max(np.abs(x - y) / np.maximum(1, np.abs(y))) / np.finfo(x.dtype).eps
    )


def main(axis_type, dtype):
    jax.config.update("jax_enable_x64", True)
    count, rng = jax.device_count(), np.random.default_rng(0)
    mesh = jax.make_mesh((count,), ("pairs",), axis_types=(AxisType[axis_type],))
    over_devices = NamedSharding(mesh, PartitionSpec("pairs"))
    on_all = NamedSharding(mesh, PartitionSpec())
    given = [fields(rng, (EACH * count,), dtype) for _ in range(2)]
    bodies = jaxbe.Box(*given[0]), jaxbe.Ellipsoid(*given[1])
    given = jax.device_put(given, over_devices)
    spread = jaxbe.Box(*given[0]), jaxbe.Ellipsoid(*given[1])
    kernels = KERNELS | (MORE if axis_type == "Auto" else {})
    told = {name: compared(f, bodies, spread) for name, f in kernels.items()}
    one = jax.tree.map(lambda x: x[0], bodies[0])
    one_box = (one, bodies[1]), (jax.device_put(one, on_all), spread[1])
    told["one box"] = compared(KERNELS["margin"], *one_box)
    print(json.dumps(told))


if __name__ == "__main__":
    main(sys.argv[1], np.dtype(sys.argv[2]))
