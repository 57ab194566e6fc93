"""A program of `test_xla.py`: the functions of `jaxbe._xla` over all devices.

python -m tests.xla_on_devices  prints one JSON object: by function and way what went
wrong.
"""

from __future__ import annotations

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from tests.test_xla import ENTRIES, arrays_of, tupled

EACH = 3
"""Numbers of a device."""


def over_devices(function, mesh, specs):
    """`shard_map` with its checks on: under its present name, or that of old."""
    if hasattr(jax, "shard_map"):
        return jax.shard_map(
            function, mesh=mesh, in_specs=specs, out_specs=PartitionSpec("x")
        )
    from jax.experimental.shard_map import shard_map

    return shard_map(function, mesh, specs, PartitionSpec("x"), check_rep=True)


def value_and_gradients(entry):
    """Of the squares of the results."""

    def both(*x):
        values, pulled_back = jax.vjp(tupled(entry.function), *x)
        return values, pulled_back(tuple(2 * y for y in values))

    return both


def fault(function, arrays, expected):
    """What JAX says of it, or that numbers differ, or None."""
    try:
        found = jax.tree.leaves(function(*arrays))
        for x, y in zip(found, jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-5)
    except Exception as error:  # Whatever it is, it is reported.
        return f"{type(error).__name__}: {str(error)[:600]}"
    return None


def of_shards(entry, mesh, told, name):
    """All operands on their device; one alone is, the others are alike for all.

    (Of a direction the witness, too: its results are of all operands.)
    """
    arrays = arrays_of(entry, np.float32, (EACH * jax.device_count(),))
    specs = (PartitionSpec("x"),) * entry.count
    both = value_and_gradients(entry)
    function = over_devices(both, mesh, specs)
    told[f"{name}, shard_map"] = fault(jax.jit(function), arrays, both(*arrays))
    told[f"{name}, shard_map, eager"] = fault(
        over_devices(tupled(entry.function), mesh, specs), arrays, both(*arrays)[0]
    )
    is_direction = name == "materialise_direction"
    for i in sorted({0, entry.count - 1 - is_direction}):
        here = {i, entry.count - 1} if is_direction else {i}
        some = [x if j in here else x[:EACH] for j, x in enumerate(arrays)]
        specs = tuple(PartitionSpec(*("x",) * (j in here)) for j in range(entry.count))

        def function(*x, i=i):
            # A result that is alike for all would not fit what is said of it.
            return sum(tupled(entry.function)(*x)) + 0 * x[i]

        spread = over_devices(function, mesh, specs)
        whole = functools.partial(_repeated, function, here)
        for way, of in (("", lambda f: f), (", gradients", gradients)):
            told[f"{name}, shard_map, {i} alone{way}"] = fault(
                jax.jit(of(spread)), some, of(whole)(*some)
            )


def gradients(function):
    """In all operands, of the sum of the squares."""

    def total(*x):
        return jnp.sum(function(*x) ** 2)

    return lambda *x: jax.grad(total, range(len(x)))(*x)


def _repeated(function, here, *arrays):
    """Without devices: what all have is there once for each."""
    count = jax.device_count()
    return function(
        *(x if j in here else jnp.tile(x, count) for j, x in enumerate(arrays))
    )


def of_types(entry, mesh, told, name):
    """`vmap` over an axis that is part of the types: of all operands, and of one."""
    arrays = arrays_of(entry, np.float32, (EACH * jax.device_count(),))
    both, spread = value_and_gradients(entry), NamedSharding(mesh, PartitionSpec("x"))
    expected = jax.vmap(both)(*arrays)
    one = [x[0] for x in arrays]
    some = {
        i: jax.vmap(both, tuple(0 if i == j else None for j in range(entry.count)))(
            *(x if i == j else one[j] for j, x in enumerate(arrays))
        )
        for i in {0, entry.count - 1}
    }
    with jax.set_mesh(mesh):
        given = jax.device_put(arrays, spread)
        alike = jax.device_put(one, NamedSharding(mesh, PartitionSpec()))
        told[f"{name}, explicit axis"] = fault(jax.jit(jax.vmap(both)), given, expected)
        told[f"{name}, explicit axis, no vmap"] = fault(
            jax.jit(tupled(entry.function)), given, expected[0]
        )
        for i in sorted({0, entry.count - 1}):
            axes = tuple(0 if i == j else None for j in range(entry.count))
            told[f"{name}, explicit axis, {i} alone"] = fault(
                jax.vmap(both, axes),
                [x if i == j else alike[j] for j, x in enumerate(given)],
                some[i],
            )


def mesh_of(axis_type):
    kinds = (AxisType[axis_type],)
    return jax.make_mesh((jax.device_count(),), ("x",), axis_types=kinds)


def main():
    told = {}
    for name, entry in ENTRIES.items():
        of_shards(entry, mesh_of("Auto"), told, name)
        if hasattr(jax, "set_mesh"):
            of_types(entry, mesh_of("Explicit"), told, name)
    print(json.dumps(told))


if __name__ == "__main__":
    main()
