"""A program of `test_scale.py`: `vmap` over an axis that is part of the arrays' types.

python -m tests.on_explicit_mesh [every]  prints one JSON object: by function what went
wrong; of every one also where one field alone is mapped, which takes minutes.
"""

from __future__ import annotations

import functools
import json
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec

import jaxbe
from jaxbe.choice import choose, maximum, minimum
from jaxbe.lower_bound import distance_lower_bound
from jaxbe.mjx import Pairs, filter_contacts
from tests.on_devices import roundings
from tests.test_chunked import fields


def filtered(box, ellipsoid):
    """As two geoms of a model, whose poses and sizes are mapped."""
    size, position, axes = (
        jnp.stack(x)
        for x in zip(
            (box.half_extents, box.center, box.axes),
            (ellipsoid.semi_axes, ellipsoid.center, ellipsoid.axes),
            strict=True,
        )
    )
    model = types.SimpleNamespace(geom_size=size)
    data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
    pairs = Pairs(np.array([[1, 0]]))
    found = filter_contacts(pairs, model, data, distance=0.1, max_pairs=2)
    return found


ANSWERS = {
    **{m: functools.partial(jaxbe.overlap, method=m) for m in jaxbe.METHODS},
    "certify": jaxbe.certify,
    "margin_bounds": jaxbe.margin_bounds,
    "filter_contacts": filtered,
    "distance_bounds": functools.partial(jaxbe.distance_bounds, steps=1),
}
DIFFERENTIABLE = {
    "scaled_distance": jaxbe.scaled_distance,
    "margin": functools.partial(jaxbe.margin, steps=6),
    "signed_distance": functools.partial(jaxbe.signed_distance, steps=1),
    "contact": functools.partial(jaxbe.contact, steps=1),
    "lower bound": functools.partial(distance_lower_bound, steps=1),
}
MORE = {"signed_distance, 5 steps": functools.partial(jaxbe.signed_distance, steps=5)}
TWICE = ("margin", "signed_distance", "scaled_distance")
ONE_FIELD = ("minkowski", "scaled_distance, gradient")


def total(function):
    return lambda *pair: sum(x.sum() for x in jax.tree.leaves(function(*pair)))


def functions(every):
    """By name: functions of a pair, to be mapped."""
    differentiable = DIFFERENTIABLE | (MORE if every else {})
    yield from (ANSWERS | differentiable).items()
    for name, function in differentiable.items():
        gradient = jax.grad(total(function), argnums=(0, 1))
        yield f"{name}, gradient", gradient
        if name == "margin" or (every and name in TWICE):
            yield f"{name}, Hessian", jax.jacfwd(gradient, argnums=0)


def turned(box, wxyz, ellipsoid):
    wxyz = wxyz / jnp.linalg.norm(wxyz)
    turned = jaxbe.Box.from_quaternion(box.center, wxyz, box.half_extents)
    return jaxbe.overlap(turned, ellipsoid)


def chosen(x):
    """With all derivatives of constants and ties."""
    sides = choose(x > 0, 1, -1) * x, choose(x > 1, 2.0, 0.5) * x
    return maximum(sides[0], 1) + minimum(x, sides[1])


def with_one_field_mapped(function, spread, one):
    """Only centres, only axes and so on: all else is constant in the mapped program."""
    leaves, structure = jax.tree.flatten(one)
    for i, mapped in enumerate(jax.tree.leaves(spread)):

        def value(x, i=i):
            given = [x if i == j else leaf for j, leaf in enumerate(leaves)]
            return function(*jax.tree.unflatten(structure, given))

        yield f"field {i} alone", fault(jax.vmap(value), mapped)


def fault(function, *args):
    """What JAX says of it, or None."""
    try:
        jax.eval_shape(function, *args)
    except Exception as error:  # Whatever it is, it is reported.
        return f"{type(error).__name__}: {str(error)[:300]}"
    return None


def main(every):
    count, rng = jax.device_count(), np.random.default_rng(0)
    mesh = jax.make_mesh((count,), ("x",))
    given = [fields(rng, (2 * count,), np.dtype(np.float32)) for _ in range(2)]
    alone = jaxbe.Box(*given[0]), jaxbe.Ellipsoid(*given[1])
    x = np.float32([-2, -1, -0.5, 0, 0.5, 1, 2, 3])
    slope = jax.vmap(jax.value_and_grad(chosen))
    margin = jax.jit(jax.vmap(jax.value_and_grad(jaxbe.margin)))
    expected = margin(*alone), slope(x)
    jax.set_mesh(mesh)
    spread = jax.device_put(alone, NamedSharding(mesh, PartitionSpec("x")))
    here = jax.device_put(x, NamedSharding(mesh, PartitionSpec("x")))
    told = {n: fault(jax.vmap(f), *spread) for n, f in functions(every)}
    one = jax.tree.map(lambda x: x[0], alone)
    one = jax.device_put(one, NamedSharding(mesh, PartitionSpec()))
    for name, function in functions(every):
        if name in ONE_FIELD or (every and "Hessian" not in name):
            for field, wrong in with_one_field_mapped(function, spread, one):
                told[f"{name}, {field}"] = wrong
    wxyz = jnp.concatenate([spread[0].center, spread[0].center[:, :1]], axis=1)
    told["from_quaternion"] = fault(jax.vmap(turned), spread[0], wxyz, spread[1])
    found = margin(*spread), slope(here)
    told["roundings"] = max(
        map(roundings, jax.tree.leaves(found), jax.tree.leaves(expected))
    )
    print(json.dumps(told))


if __name__ == "__main__":
    main("every" in sys.argv)
