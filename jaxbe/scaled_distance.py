"""`scaled_distance`: section 4 of the paper, distances in the ellipsoid's metric."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbe import _xla, kernel
from jaxbe.choice import choose
from jaxbe.components import vector
from jaxbe.envelope import directional_derivative
from jaxbe.metric import metric
from jaxbe.pose import (
    CanonicalPair,
    canonical_pair,
    materialised,
    runtime_witness,
)
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.touching import touching
from jaxbe.types import Components, Scalars


def scaled_distance(box: Box, ellipsoid: Ellipsoid) -> Scalars:
    """The distance from the ellipsoid's centre to the box, in ellipsoid radii.

    It is sqrt(q): the factor by which the ellipsoid must be scaled about its
    centre to touch the box. The pair overlaps exactly when it is at most 1.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.

    Returns:
        Dimensionless, of the common batch shape; 0 if the centre is in the box,
        1 at touching, NaN if any number is NaN or infinite. In float32 right to
        1e-5 (relative to max(1, answer)) at spreads (see `overlap`) to 40, 1e-4 to
        1000, and finite as long as the centres are nearer than some 1e18 of the
        smallest semi-axis.

        First derivatives, forward and reverse, are exact and finite; zero where the
        centre is in the box, where the function is constant. In the single entries of
        the axes, which a rotation cannot vary alone, they are those of the support
        functions (see `jaxbe.envelope`). For second derivatives use `margin`.

    Raises:
        TypeError: arguments that are not a Box and an Ellipsoid of one dtype.
        ValueError: batch shapes that do not broadcast.

    Source:
        D. Eberly, "Intersection of Box and Ellipsoid", section 4.
    """
    return _scaled_distance(box, ellipsoid)


@jax.custom_jvp
def _scaled_distance(box: Box, ellipsoid: Ellipsoid) -> Scalars:
    pair = canonical_pair(box, ellipsoid)
    return jnp.sqrt(kernel.squared_distance(pair.k, pair.e, metric(pair.R, pair.a)))


@_scaled_distance.defjvp
def _scaled_distance_jvp(bodies: Any, tangents: Any) -> tuple[Scalars, Scalars]:
    """sqrt(q) is the maximum over n of (n.k - E) / s: hold the best n."""
    box, ellipsoid = bodies
    distance = _scaled_distance(box, ellipsoid)
    pair = canonical_pair(box, ellipsoid)
    distance = _xla.materialise_once(distance, runtime_witness(pair))
    one = jnp.ones_like(distance)
    n_0, n_1, n_2 = materialised(_normal, pair, (2, 4), distance)
    still = jax.lax.stop_gradient(pair)
    r_0, r_1, r_2 = materialised(_reach, still, (8, 16), distance)
    tangent = directional_derivative(
        bodies,
        tangents,
        (n_0, n_1, n_2),
        one,
        of_extent=one,
        of_radius=distance,
        reach=(r_0, r_1, r_2),
    )
    return distance, tangent


def _normal(pair: CanonicalPair) -> Components:
    """The best direction n with s = 1, in 1 / metre; zero with the centre inside."""
    near, s = _nearest(pair)
    inside = near.q == 0
    s = s / pair.per_unit
    return vector(
        lambda i: choose(inside | ~near.active[i], 0, near.n[i] / choose(inside, 1, s))
    )


def _reach(pair: CanonicalPair) -> Components:
    """Where the scaled ellipsoid touches, from its centre, in its axes and metres."""
    near, _ = _nearest(pair)
    root = jnp.sqrt(near.q)
    reach = touching(pair, near, near.n, root, root).reach
    return vector(lambda p: reach[p] / pair.per_unit)


def _nearest(pair: CanonicalPair) -> tuple[kernel.Nearest, Scalars]:
    """The kernel's answer and s of its n."""
    near = kernel.nearest(pair.k, pair.e, metric(pair.R, pair.a))
    root = jnp.sqrt(near.q)
    return near, touching(pair, near, near.n, root, root).radius
