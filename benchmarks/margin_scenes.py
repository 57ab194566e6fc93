"""Scenes for the margin's benchmarks, and its true value on them."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import scenes
from jaxbe.contact_normal import contact_normal
from jaxbe.growth import MAX_STEPS
from jaxbe.pose import canonical_pair

THIN, LONG = (0.01, 0.05), (0.5, 2.0)
"""Ranges of half extents and semi-axes of needles and plates."""

NEAR = 1e-3
"""Near-touching pairs have a growth distance within 1 +- this."""


@functools.cache
def compiled(steps: int) -> Callable[..., jax.Array]:
    """The margin of bodies with arrays (N, 3) and (N, 3, 3), under vmap."""
    return jax.jit(jax.vmap(functools.partial(jaxbe.margin, steps=steps)))


def margin(pairs: scenes.Scene, steps: int) -> np.ndarray:
    """The margin in the dtype of the pairs."""
    return np.asarray(compiled(steps)(*pairs.bodies()))


def truth(pairs: scenes.Scene) -> np.ndarray:
    """The margin of the very same numbers, to about 15 digits, in float64.

    The quotient n.k / (e.|n| + sqrt(n^T S n)), which defines it for axes that are
    not quite orthonormal too, in extended precision, at the direction n that the
    most steps find in float64; at a maximum its error counts as its square.
    """
    n = np.asarray(_normals(*pairs.astype(np.float64).bodies())).astype(np.longdouble)
    C, U, e, K, V, a = (x.astype(np.longdouble) for x in pairs)
    world = np.einsum("nri,ni->nr", U, n)
    extent = np.sum(e * abs(n), axis=1)
    radius = np.sqrt(np.sum((a * np.einsum("nrp,nr->np", V, world)) ** 2, axis=1))
    projected = np.sum(world * (K - C), axis=1)
    return (projected / (extent + radius) - 1).astype(np.float64)


@jax.jit
def _normals(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """The contact normals (N, 3) in box axes."""
    pair = canonical_pair(box, ellipsoid)
    growth = 1 + jaxbe.margin(box, ellipsoid, steps=MAX_STEPS)
    return jnp.stack(contact_normal(pair, growth).n, axis=-1)


def near_touching(pairs: scenes.Scene, growth: np.ndarray) -> scenes.Scene:
    """The ellipsoids moved along K - C to the growth distances wanted."""
    factor = growth / (1 + truth(pairs))
    return pairs._replace(K=pairs.C + (pairs.K - pairs.C) * factor[:, None])


def needles(n: int, seed: int) -> scenes.Scene:
    """One long axis in each body."""
    return _shaped(n, seed, long_axes=1)


def plates(n: int, seed: int) -> scenes.Scene:
    """One short axis in each body."""
    return _shaped(n, seed, long_axes=2)


def _shaped(n: int, seed: int, long_axes: int) -> scenes.Scene:
    """Random poses of bodies with so many long axes, others thin; see `random`."""
    rng = np.random.default_rng(seed)
    pairs = scenes.random(n, seed)
    e, a = (_lengths(rng, n, long_axes) for _ in range(2))
    reach = scenes.REACH * (e + scenes.half_widths(pairs.U, pairs.V, a))
    k = reach * rng.uniform(-1, 1, (n, 3))
    K = pairs.C + np.einsum("nij,nj->ni", pairs.U, k)
    return pairs._replace(e=e, a=a, K=K)


def _lengths(rng: np.random.Generator, n: int, long_axes: int) -> np.ndarray:
    thin, long = (
        np.exp(rng.uniform(*np.log(limits), (n, 3))) for limits in (THIN, LONG)
    )
    return np.where(np.arange(3) < long_axes, long, thin)


def _near(n: int, seed: int) -> scenes.Scene:
    growth = 1 + NEAR * np.random.default_rng(seed).uniform(-1, 1, n)
    return near_touching(scenes.random(n, seed), growth)


KINDS: dict[str, Callable[[int, int], scenes.Scene]] = {
    "random, aspect to 40": scenes.random,
    "random, aspect to 1000": functools.partial(scenes.random, low=0.002, high=2.0),
    f"near touching, {NEAR:g}": _near,
    "needles": needles,
    "plates": plates,
}
"""Scenes by name, functions of the number of pairs and a seed."""
