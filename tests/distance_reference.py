"""What the distance's tests share: compiled functions, and judges in numpy.

The value of a direction, n.k - e.|n| - s(n), bounds the signed distance from below
whatever found the direction; two points, one of either body, bound the distance of
bodies that are apart from above. Neither shares a line with jaxbe.
"""

from __future__ import annotations

import functools

import jax
import numpy as np

import jaxbe
from benchmarks import scenes
from benchmarks.reference import LONG
from benchmarks.reference import value_along as value_along
from jaxbe.distance import DEFAULT_STEPS


@functools.cache
def contact_at(steps):
    return jax.jit(functools.partial(jaxbe.contact, steps=steps))


@functools.cache
def bounds_at(steps):
    return jax.jit(functools.partial(jaxbe.distance_bounds, steps=steps))


CHUNK = 1000
"""Functions are called with so many pairs at a time: one compilation for all tests."""


def in_chunks(function, scene):
    """The arrays of a compiled function's result, as float64 numpy arrays."""
    parts = []
    for start in range(0, scene.size, CHUNK):
        which = np.arange(start, start + CHUNK) % scene.size
        result = jax.tree.leaves(function(*scene.part(which).bodies()))
        parts.append([np.asarray(x, np.float64) for x in result])
    return [np.concatenate(x)[: scene.size] for x in zip(*parts, strict=True)]


def found(scene, steps=None):
    """`jaxbe.contact` as float64 numpy arrays."""
    return jaxbe.Contact(*in_chunks(contact_at(steps or DEFAULT_STEPS), scene))


def bounds(scene, steps=None):
    """`jaxbe.distance_bounds` likewise."""
    return in_chunks(bounds_at(steps or DEFAULT_STEPS), scene)


def overlapping(scene):
    return np.asarray(jax.jit(jaxbe.overlap)(*scene.bodies()))


def value_in_box_axes(scene, n):
    """n.k - e.|n| - s(n), with n from the box to the ellipsoid, as it is."""
    C, U, e, K, V, a = scene
    w = np.einsum("nri,ni->nr", U, n.astype(LONG))
    radius = np.sqrt(np.sum((a * np.einsum("nrp,nr->np", V, w)) ** 2, axis=1))
    extent = np.sum(e * abs(n), axis=1)
    return (np.sum(w * (K - C), axis=1) - extent - radius).astype(np.float64)


def outside_box(scene, point):
    """How far points are outside the boxes, along the worst axis; negative inside."""
    C, U, e = (x.astype(LONG) for x in scene[:3])
    x = np.einsum("nri,nr->ni", U, point.astype(LONG) - C)
    return np.max(abs(x) - e, axis=1).astype(np.float64)


def outside_ellipsoid(scene, point):
    """By what factor, minus one, points are beyond the surface, in its metric."""
    K, V, a = (x.astype(LONG) for x in scene[3:])
    y = np.einsum("nrp,nr->np", V, point.astype(LONG) - K)
    return (np.sqrt(np.sum((y / a) ** 2, axis=1)) - 1).astype(np.float64)


def size(scene):
    """The longest length of a pair."""
    return np.max(np.concatenate([scene.e, scene.a], axis=1), axis=1)


def random_overlapping(n, seed, **options):
    """Random pairs that overlap."""
    scene = scenes.random(3 * n, seed=seed, **options)
    return scene.part(np.flatnonzero(overlapping(scene))[:n])
