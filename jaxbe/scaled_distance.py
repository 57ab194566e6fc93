"""`scaled_distance`: section 4 of the paper, distances in the ellipsoid's metric."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbe import kernel
from jaxbe.components import column, dot, largest, vector
from jaxbe.metric import metric
from jaxbe.pose import CanonicalPair, canonical_pair
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Components, Scalars


def scaled_distance(box: Box, ellipsoid: Ellipsoid) -> Scalars:
    """The distance from the ellipsoid's centre to the box, in ellipsoid radii.

    It is sqrt(q): the factor by which the ellipsoid must be scaled about its
    centre to touch the box. The pair overlaps exactly when it is at most 1.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.

    Returns:
        Dimensionless, of the common batch shape: 0 if the centre is in the box,
        1 at touching, NaN if any number is NaN or infinite. In float32 right to
        1e-5 (relative to max(1, answer)) at aspect ratios to 40, 1e-4 to 1000.

        Derivatives, forward and reverse, are exact in all inputs and finite; zero
        where the centre is in the box, where the function is constant.

    Raises:
        TypeError: arguments that are not a Box and an Ellipsoid of one dtype.
        ValueError: batch shapes that do not broadcast.

    Source:
        D. Eberly, "Intersection of Box and Ellipsoid", section 4.
    """
    return _scaled_distance(canonical_pair(box, ellipsoid))


@jax.custom_jvp
def _scaled_distance(pair: CanonicalPair) -> Scalars:
    return jnp.sqrt(kernel.squared_distance(pair.k, pair.e, metric(pair.R, pair.a)))


@_scaled_distance.defjvp
def _scaled_distance_jvp(primals: Any, tangents: Any) -> tuple[Scalars, Scalars]:
    """sqrt(q) is the maximum over n of `separation_ratio`; hold the best n.

    By the envelope theorem that derivative is exact, and it never differentiates
    through a clip, a minimum or the square root of zero.
    """
    (pair,) = primals
    n = kernel.nearest(pair.k, pair.e, metric(pair.R, pair.a)).n
    size = largest(vector(lambda i: abs(n[i])))
    inside = size == 0
    safe_size = jnp.where(inside, 1, size)
    n = vector(lambda i: jnp.where(inside, 1, n[i] / safe_size))
    _, tangent = jax.jvp(lambda p: separation_ratio(n, p), primals, tangents)
    return _scaled_distance(pair), jnp.where(inside, 0, tangent)


def separation_ratio(n: Components, pair: CanonicalPair) -> Scalars:
    """(n.k - e.|n|) / sqrt(n^T S n): above 1, the direction n separates the pair."""
    k, R, e, a = pair
    gap = dot(n, k) - dot(vector(lambda i: abs(n[i])), e)
    radii = vector(lambda p: a[p] * dot(column(R, p), n))
    return gap / jnp.sqrt(dot(radii, radii))
