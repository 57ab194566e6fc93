"""A program of `test_elsewhere.py`: all public functions, one operation at a time.

JAXBE_XLA=off python -m tests.without_hints FILE DTYPE  writes the answers, without what
is there for a compiler: that is the mathematics of accelerators. (Compiled for a CPU it
would not come to an end.)
"""

from __future__ import annotations

import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import scenes
from jaxbe import _xla_primitives
from jaxbe.lower_bound import distance_lower_bound

PAIRS = 200
"""Of a kind."""

KINDS = {"random": lambda scene: scene, **scenes.ROUND_OR_ALIGNED}


def gradient(function):
    def total(*pair):
        return jnp.sum(function(*pair))

    return jax.grad(total, argnums=(0, 1))


FUNCTIONS = {
    **{m: functools.partial(jaxbe.overlap, method=m) for m in jaxbe.METHODS},
    "scaled_distance": jaxbe.scaled_distance,
    "margin, 5 steps": jaxbe.margin,
    "margin, 10 steps": functools.partial(jaxbe.margin, steps=10),
    "margin_bounds": jaxbe.margin_bounds,
    "certify": lambda *pair: jaxbe.certify(*pair).verdict,
    "signed_distance, 5 steps": functools.partial(jaxbe.signed_distance, steps=5),
    "contact": jaxbe.contact,
    "distance_bounds": jaxbe.distance_bounds,
    "lower bound, 0 steps": functools.partial(distance_lower_bound, steps=0),
    "lower bound, 6 steps": functools.partial(distance_lower_bound, steps=6),
    "gradient of margin": gradient(jaxbe.margin),
    "gradient of signed_distance": gradient(jaxbe.signed_distance),
}


def scene_of(dtype):
    """So many pairs of every kind, one after the other."""
    parts = [
        kind(scenes.random(PAIRS, seed=200 + i))
        for i, kind in enumerate(KINDS.values())
    ]
    together = (np.concatenate(x) for x in zip(*parts, strict=True))
    return scenes.Scene(*together).astype(dtype)


def answers(dtype):
    """By function and number, the arrays that it returns."""
    bodies = jax.tree.map(jnp.asarray, scene_of(dtype).bodies())
    with jax.disable_jit():
        return {
            f"{name}: {i}": np.asarray(x)
            for name, function in FUNCTIONS.items()
            for i, x in enumerate(jax.tree.leaves(function(*bodies)))
        }


def main(file, dtype):
    assert not _xla_primitives.IS_ON
    jax.config.update("jax_enable_x64", True)
    np.savez(file, **answers(dtype))


if __name__ == "__main__":
    main(*sys.argv[1:])
