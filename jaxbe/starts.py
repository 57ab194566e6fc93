"""Where the search for the best direction begins.

f (see `jaxbe.tangent`) has one minimum where the bodies are apart, and several where
they overlap. The search begins at seven directions: 0, where the two nearest points,
or the first contact of the bodies as they grow, point; 1 to 3, the face normals of the
box; 4 to 6, the axes of the ellipsoid.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jaxbe import _xla
from jaxbe.choice import choose, minimum
from jaxbe.components import column, dot, is_zero, vector, where
from jaxbe.growth import growth_estimate
from jaxbe.kernel import nearest
from jaxbe.metric import inflated, metric_of, shape
from jaxbe.pose import CanonicalPair, runtime_witness
from jaxbe.separation import shift
from jaxbe.support import extent
from jaxbe.types import Components, Scalars

Start = Callable[[CanonicalPair], Components]
"""A direction to begin at, of any length."""

Read = Callable[[Scalars], CanonicalPair]
"""The pair of the bodies at hand, for one more computation; given a witness."""

START_STEPS = 1
"""Enough for a start."""

TRIED = 3
"""Of the starts 1 to 6, so many are followed."""


def first_start(pair: CanonicalPair, read: Read, steps: int) -> Components:
    """Start 0, of any length."""
    mu = _xla.cut(shift(pair, steps), runtime_witness(pair))
    pair = read(mu)
    alpha = growth_estimate(pair, START_STEPS)
    # One of the two at a time: mu is zero where they overlap.
    alpha = choose(mu > 0, 1, minimum(alpha, 1))
    n = _direction(pair, alpha, mu)
    return _xla.materialise_direction(n, runtime_witness(pair))


def other_starts() -> list[Start]:
    """The starts 1 to 6."""
    faces = [functools.partial(_face, i=i) for i in range(3)]
    return [*faces, *(functools.partial(_axis, p=p) for p in range(3))]


def chosen_starts(pair: CanonicalPair) -> list[Start]:
    """The three best of the starts 1 to 6, the best one first."""
    numbers = _best_numbers(pair)
    return [functools.partial(_numbered, number=number) for number in numbers]


def _numbered(pair: CanonicalPair, number: Scalars) -> Components:
    """One of the starts 1 to 6."""
    u, *others = (start(pair) for start in other_starts())
    for i, other in enumerate(others, start=2):
        u = where(number == i, other, u)
    return u


def _best_numbers(pair: CanonicalPair) -> Components:
    values = [*_depths_of_faces(pair), *_depths_of_axes(pair)]
    numbers = []
    for _ in range(TRIED):
        number, least = jnp.ones_like(values[0]), values[0]
        for i, value in enumerate(values[1:], start=2):
            number = choose(value < least, i, number)
            least = minimum(value, least)
        values = [
            choose(number == i, float(np.finfo(v.dtype).max), v)
            for i, v in enumerate(values, start=1)
        ]
        numbers.append(number)
    # As one number: the cheapest array to compute once.
    number = numbers[0] + 8 * numbers[1] + 64 * numbers[2]
    return _digits(_xla.cut(number, runtime_witness(pair)))


def _direction(pair: CanonicalPair, alpha: Scalars, mu: Scalars) -> Components:
    """The multipliers of the box scaled by alpha and the ellipsoid swollen by mu."""
    m = metric_of(inflated(shape(pair.R, pair.a), mu), _xla.stay_fused)
    n = nearest(pair.k, vector(lambda i: alpha * pair.e[i]), m).n
    return where(is_zero(n), _face(pair, 0), n)


def _face(pair: CanonicalPair, i: int) -> Components:
    """The face normal i of the box, towards the ellipsoid."""
    sign = choose(pair.k[i] < 0, -1, 1).astype(pair.k[i].dtype)
    return vector(lambda j: sign if j == i else jnp.zeros_like(sign))


def _axis(pair: CanonicalPair, p: int) -> Components:
    """The axis p of the ellipsoid, away from the box."""
    axis = column(pair.R, p)
    back = dot(axis, pair.k) < 0
    return vector(lambda i: choose(back, -axis[i], axis[i]))


def _depths_of_faces(pair: CanonicalPair) -> Components:
    S = shape(pair.R, pair.a).S
    return vector(lambda i: pair.e[i] + jnp.sqrt(S[i][i]) - abs(pair.k[i]))


def _depths_of_axes(pair: CanonicalPair) -> Components:
    def depth(p: int) -> Scalars:
        axis = column(pair.R, p)
        return extent(axis, pair.e) + pair.a[p] - abs(dot(axis, pair.k))

    return vector(depth)


def _digits(x: Scalars) -> Components:
    """In base 8, the last one first."""
    highest = jnp.floor(x * (1 / 64))
    middle = jnp.floor((x - 64 * highest) * (1 / 8))
    return x - 64 * highest - 8 * middle, middle, highest
