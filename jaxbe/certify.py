"""`certify`: a verdict with its proof, for the very floats that were given."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe import _xla, validate
from jaxbe.choice import choose, maximum
from jaxbe.components import (
    clip,
    column,
    dot,
    largest,
    matrix,
    split_matrix,
    split_vector,
    stack,
    times,
    vector,
)
from jaxbe.kernel import nearest
from jaxbe.metric import metric
from jaxbe.pose import batch_shape, canonical_pair, runtime_witness
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import ComponentMatrix, Components, Flags, Scalars, Vectors

ROUNDINGS = 32
"""More than the roundings that lie between the inputs and any number compared."""


class Certificate(NamedTuple):
    """A verdict and its proof.

    Attributes:
        verdict: int32: 1 overlap, -1 separated, 0 undecided.
        point: (..., 3), in box coordinates, metres: a point x of the box, |x_i| <=
            half_extents_i to the bit. Where the verdict is 1, C + U x is in the
            ellipsoid: the y with V y = C + U x - K has |y / a| <= 1.
        direction: (..., 3), in world axes. Where the verdict is -1 this w separates
            the bodies: w.(K - C) > sum e_i |u_i.w| + sqrt(sum (a_p v_p.w)^2).
    """

    verdict: jax.Array
    point: Vectors
    direction: Vectors


def certify(box: Box, ellipsoid: Ellipsoid) -> Certificate:
    """Decides whether a pair overlaps, and proves it.

    The proof holds in exact arithmetic for the floats given, axes that are not quite
    orthonormal included, and can be checked without jaxbe. It does not depend on how
    the point or the direction was found.

    Derivation of the band. A sum of products computed with at most m roundings on the
    way to each term differs from the exact one by at most gamma_m = m u / (1 - m u)
    times the sum of the terms' absolute values, u = eps / 2. All numbers compared here
    have fewer than 16 roundings, K - C being one; gamma_64 covers them, the root, and
    the sums of absolute values, which are computed too; and 6 roundings more for each
    of at most four quotients and roots on a way, which accelerators compute to some 3
    units in the last place. For an overlap, with
    z = V^T w, w = C + U x - K, and G = V^T V - I (as computed, plus its rounding),
    y = (I + G)^-1 z differs from z by at most |G| |z| / (1 - |G|). A verdict is given
    if its inequality holds by more than that. What is too
    small for normal floats may be flushed to zero, before and after the scaling to the
    pair's units: the band has so many of the smallest normal float, times the lengths,
    and the root of it for squares under a root.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.

    Returns:
        A `Certificate` of the common batch shape. Undecided are pairs that touch to
        rounding, in float32 some 1e-5 of sqrt(q) at spreads to 40; NaN and infinity.

    Raises:
        TypeError: arguments that are not a Box and an Ellipsoid of one dtype.
        ValueError: batch shapes that do not broadcast; and, for concrete bodies, values
            that mean no body, as an optimiser may leave them: negative lengths, or axes
            that differ from orthonormal by more than 1e-3. (See `jaxbe.checked`.)

    Source:
        N. J. Higham, "Accuracy and Stability of Numerical Algorithms", section 3.1.
    """
    batch_shape(box, ellipsoid)
    for body in (box, ellipsoid):
        validate.check_possible(type(body).__name__, body.fields())
    pair = canonical_pair(box, ellipsoid)
    rank = pair.per_unit.ndim
    near = nearest(pair.k, pair.e, metric(pair.R, pair.a))
    e = split_vector(box.half_extents, rank)
    witness = runtime_witness(pair)
    x = vector(lambda i: clip(near.x[i] / pair.per_unit, -e[i], e[i]))
    x = _xla.materialise_vector(x, witness)
    U = split_matrix(box.axes, rank)
    size = largest(_absolute(near.n))
    n = vector(lambda i: near.n[i] / choose(size > 0, size, 1))
    w = _xla.materialise_vector(times(U, n), witness)
    # The box alone: to reread the ellipsoid takes a kernel for each entry of its axes.
    proof = _Proof(_xla.reread(box, w[0]), ellipsoid, pair.per_unit)
    overlap = proof.overlaps(vector(lambda i: x[i] * pair.per_unit))
    separated = proof.separates(w)
    verdict = overlap.astype(np.int32) - separated.astype(np.int32)
    return Certificate(verdict, stack(x), stack(w))


class _Proof:
    """The inequalities, in the pair's units, with the letters of `jaxbe.pose`."""

    def __init__(self, box: Box, ellipsoid: Ellipsoid, per_unit: Scalars) -> None:
        rank = per_unit.ndim
        self.U = split_matrix(box.axes, rank)
        self.V = split_matrix(ellipsoid.axes, rank)
        C, K = split_vector(box.center, rank), split_vector(ellipsoid.center, rank)
        e = split_vector(box.half_extents, rank)
        a = split_vector(ellipsoid.semi_axes, rank)
        self.offset = vector(lambda r: (K[r] - C[r]) * per_unit)
        self.e = vector(lambda i: e[i] * per_unit)
        self.a = vector(lambda p: a[p] * per_unit)
        info = np.finfo(per_unit.dtype)
        self.gamma = float(ROUNDINGS * info.eps)
        # What is flushed to zero, before or after the scaling; and its square root.
        tiny = float(ROUNDINGS * info.tiny)
        lengths = (*_absolute(self.offset), *self.e, *self.a)
        self.flushed = tiny * maximum(per_unit, 1) * (1 + _sum_of(lengths))
        self.root = float(8 * np.sqrt(info.tiny))

    def separates(self, w: Components) -> Flags:
        """Whether w.(K - C) exceeds the sum of the support functions."""
        gap = dot(w, self.offset)
        reach = self._support(self.U, self.V, w)
        sizes = _absolute(w)
        doubt = dot(sizes, _absolute(self.offset)) + self._support(
            _absolute_matrix(self.U), _absolute_matrix(self.V), sizes
        )
        band = self.gamma * doubt + self.flushed + self.root
        proved: Flags = gap - reach > band
        return proved

    def overlaps(self, x: Components) -> Flags:
        """Whether C + U x is in the ellipsoid."""
        w = vector(lambda r: dot(self.U[r], x) - self.offset[r])
        sizes = vector(
            lambda r: dot(_absolute(self.U[r]), _absolute(x)) + abs(self.offset[r])
        )
        z = vector(lambda p: dot(column(self.V, p), w))
        doubt = vector(lambda p: dot(_absolute(column(self.V, p)), sizes))
        defect = self._defect()
        length = jnp.sqrt(dot(z, z)) + self.root + self.gamma * _sum_of(doubt)
        skew = defect * length / (1 - defect)
        errors = vector(
            lambda p: (
                (abs(z[p]) + self.gamma * doubt[p] + skew + self.flushed) / self.a[p]
            )
        )
        inside = dot(errors, errors) * (1 + self.gamma) < 1
        usable: Flags = defect < 0.5
        return inside & usable

    def _support(
        self, U: ComponentMatrix, V: ComponentMatrix, w: Components
    ) -> Scalars:
        """The sum of e_i |u_i.w| and the root of the sum of (a_p v_p.w)^2."""
        extents = vector(lambda i: abs(dot(column(U, i), w)))
        terms = vector(lambda p: self.a[p] * dot(column(V, p), w))
        return dot(self.e, extents) + jnp.sqrt(dot(terms, terms))

    def _defect(self) -> Scalars:
        """A bound of |V^T V - I|."""
        products = matrix(lambda p, q: dot(column(self.V, p), column(self.V, q)))
        G = matrix(lambda p, q: products[p][q] - (1 if p == q else 0))
        return jnp.sqrt(_sum_of([dot(row, row) for row in G])) + 4 * self.gamma


def _sum_of(terms: Sequence[Scalars]) -> Scalars:
    """The sum, in the order given."""
    return functools.reduce(operator.add, terms)


def _absolute(x: Components) -> Components:
    return vector(lambda i: abs(x[i]))


def _absolute_matrix(m: ComponentMatrix) -> ComponentMatrix:
    return matrix(lambda i, j: abs(m[i][j]))
