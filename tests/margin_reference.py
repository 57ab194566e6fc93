"""What the margin's tests share: scenes, compiled functions, judges, differences."""

from __future__ import annotations

import functools
import itertools
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import reference, scenes
from jaxbe import growth
from jaxbe.pose import CanonicalPair
from tests import oracle, truth

LOWS = {"aspect40": 0.05, "aspect1000": 0.002, "aspect1e5": 2e-5}
"""The smallest length; the largest is 2."""

KINDS = {
    "near-touching": scenes.near_touching,
    "plates": lambda s: scenes.flattened(s, 1),
    "rods": lambda s: scenes.flattened(s, 2),
    "points": lambda s: scenes.flattened(s, 3),
    "axis-aligned-plates": lambda s: scenes.flattened(scenes.axis_aligned(s), 1),
    "coincident": scenes.coincident,
    "coincident-rods": lambda s: scenes.coincident(scenes.flattened(s, 2)),
    "permuted": scenes.permuted,
    "tiny": lambda s: scenes.scaled(s, 1e-15),
    "huge": lambda s: scenes.scaled(s, 1e15),
    "far": lambda s: scenes.shifted(s, 1e6),
    "needles": lambda s: s._replace(a=s.a * [1, 1e-3, 1e-3]),
    "ties": lambda s: in_line_with_a_feature(scenes.axis_aligned(s)),
    **scenes.ROUND_OR_ALIGNED,
}
"""Whatever is round, aligned, degenerate, on a tie or badly scaled, of a scene."""


def in_line_with_a_feature(scene):
    """K - C along a face normal, an edge's or a vertex's diagonal of the box."""
    rng = np.random.default_rng(9)
    k = scene.e * rng.integers(-3, 4, size=scene.e.shape)
    K = scene.C + np.einsum("nij,nj->ni", scene.U, k)
    return scene._replace(K=K)


@functools.cache
def margin_at(steps=None):
    """`jaxbe.margin`, compiled, at a number of steps or the default one."""
    options = {} if steps is None else {"steps": steps}
    return jax.jit(functools.partial(jaxbe.margin, **options))


@functools.cache
def bounds_at(steps):
    return jax.jit(functools.partial(jaxbe.margin_bounds, steps=steps))


@jax.jit
def gradient(box, ellipsoid):
    def total(box, ellipsoid):
        return jaxbe.margin(box, ellipsoid).sum()

    return jax.grad(total, argnums=(0, 1))(box, ellipsoid)


CHUNK = 1000
"""Gradients are taken of so many pairs at a time: one compilation for all tests."""


def gradient_fields(scene):
    """The six gradients in the order of a scene, as float64 numpy arrays."""
    chunks = range(0, scene.size, CHUNK)
    parts = [_gradient_of_a_chunk(scene.part(slice(i, i + CHUNK))) for i in chunks]
    return [np.concatenate(x).astype(np.float64) for x in zip(*parts, strict=True)]


def _gradient_of_a_chunk(part):
    repeated = part.part(np.arange(CHUNK) % part.size)
    found = jax.tree.leaves(gradient(*repeated.bodies()))
    return [np.asarray(x)[: part.size] for x in found]


def relative_errors(found, expected):
    """Relative to max(1, growth)."""
    difference = abs(np.asarray(found).astype(expected.dtype) - expected)
    return (difference / np.maximum(1, expected)).astype(np.float64)


def growth_errors(scene, margins):
    """Errors of the growth distance 1 + margin on the floats of the scene.

    The margin is rounded once more than the growth distance, by 1e-16 of it.
    """
    found = np.asarray(margins).astype(np.longdouble) + 1
    return relative_errors(found, reference.growth_by_bisection(scene))


def is_exactly_within(scene, i, margin, tolerance) -> bool:
    """Whether the growth distance of pair i is 1 + margin, in exact arithmetic.

    Within `tolerance` relative to max(1, growth): the bodies grown by a bit less
    are apart, those grown by a bit more are not.
    """
    pair = truth.exact(scene, i)
    alpha = Fraction(float(margin)) + 1
    slack = Fraction(tolerance) * max(1, alpha)
    return _apart(pair, max(alpha - slack, Fraction(0))) and not _beyond(
        pair, alpha + slack
    )


def _beyond(pair, alpha) -> bool:
    grown = pair._replace(e=[alpha * x for x in pair.e])
    return oracle.squared_distance(grown) > alpha * alpha


def _apart(pair, alpha) -> bool:
    return alpha == 0 or _beyond(pair, alpha)


def canonical_floats(scene, dtype):
    """Canonical pairs computed in float64, then rounded: (k, R, e, a)."""
    k, R = reference.canonical(scene)
    return tuple(x.astype(dtype) for x in (k, R, scene.e, scene.a))


def with_rotation(k, R, e, a):
    """The same pairs with the nearest rotation, to the square of the defect."""
    R = R.astype(np.longdouble)
    defect = np.einsum("nip,niq->npq", R, R) - np.eye(3)
    return k, R - np.einsum("nip,npq->niq", R, defect) / 2, e, a


def canonical_growth(k, R, e, a, steps):
    """The growth distance of canonical pairs."""
    vector = lambda x: tuple(jnp.asarray(x[:, i]) for i in range(3))  # noqa: E731
    rows = tuple(vector(R[:, i]) for i in range(3))
    unit = jnp.ones(len(k), k.dtype)
    pair = CanonicalPair(vector(k), rows, vector(e), vector(a), unit)
    return np.asarray(_growth_bounds(pair, steps)[0])


_growth_bounds = jax.jit(growth.growth_bounds, static_argnums=1)


def differences(scene, step=1e-6):
    """Central differences of the bisection in all 30 numbers, as six arrays."""
    scene = scene.astype(np.longdouble)
    places = [(p, i) for p, x in enumerate(scene) for i in np.ndindex(x.shape[1:])]
    shifted = [_shifted(scene, *q, h) for q in places for h in (step, -step)]
    together = scenes.Scene(*map(np.concatenate, zip(*shifted, strict=True)))
    values = reference.growth_by_bisection(together).reshape(30, 2, scene.size)
    slopes = (values[:, 0] - values[:, 1]) / (2 * step)
    return split(slopes.T.astype(np.float64))


def second_differences(scene, step=2e-5):
    """Those of the bisection, (n, 30, 30)."""
    scene = scene.astype(np.longdouble)
    places = [(p, i) for p, x in enumerate(scene) for i in np.ndindex(x.shape[1:])]
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    found = np.zeros((scene.size, 30, 30))
    for (i, p), (j, q) in itertools.combinations_with_replacement(enumerate(places), 2):
        moved = [
            _shifted(_shifted(scene, *p, s * step), *q, t * step) for s, t in signs
        ]
        together = scenes.Scene(*map(np.concatenate, zip(*moved, strict=True)))
        f = reference.growth_by_bisection(together).reshape(4, scene.size)
        second = (f[0] - f[1] - f[2] + f[3]) / (4 * step * step)
        found[:, i, j] = found[:, j, i] = second
    return found


def _shifted(scene, position, index, step):
    field = scene[position].copy()
    field[(slice(None), *index)] += step
    return scene._replace(**{scene._fields[position]: field})


def split(flat):
    """(n, 30) as the six fields of a scene."""
    parts = np.split(np.asarray(flat), np.cumsum([3, 9, 3, 3, 9]), axis=1)
    shapes = [(-1, 3), (-1, 3, 3), (-1, 3)] * 2
    return [x.reshape(shape) for x, shape in zip(parts, shapes, strict=True)]


def flat(fields):
    """Six fields of a scene as (n, 30)."""
    return np.concatenate([np.asarray(x).reshape(len(x), -1) for x in fields], axis=1)


def field_errors(found, expected):
    """Per pair, the largest error of a field relative to 1 + that field's size."""
    errors = []
    for x, y in zip(found, expected, strict=True):
        n = len(y)
        scale = 1 + np.max(abs(y).reshape(n, -1), axis=1)
        errors.append(np.max(abs(x - y).reshape(n, -1), axis=1) / scale)
    return np.max(errors, axis=0)
