"""A certified lower bound of the signed distance: rounding included, in metres.

Moved along any direction w the bodies are apart once they are by

    (w.(K - C) - sum e_i |u_i.w| - sqrt(sum (a_p v_p.w)^2)) / |w|,

so that each w gives a lower bound of the signed distance. The bodies are the sets
{C + U x, |x_i| <= e_i} and {K + V y, |y/a| <= 1}: for them it holds whether or not the
axes are orthonormal. Two directions are tried here:

- from the box to a ball about the ellipsoid's centre, the right one for a sphere;
- the kernel's, of the ellipsoid swollen by mu (see `jaxbe.separation`), the mu that
  the first direction suggests: d s for the unit direction, with its d >= 0 and its s.

For pairs that the first direction does not separate mu is zero, and the kernel's n
separates every pair that is apart.

Rounding. w is taken as computed, so only evaluating the above counts. With u = eps / 2,
and to first order, the sums by their absolute values, each against |w|:

    w.(K - C):       4 roundings of |K - C|
    extent:          6 of e_0 + e_1 + e_2
    radius:          4 + 2.5 of |a|
    differences:     2 of all these
    |w|, quotient:   2.5 + 2 of all these

so at most 13 u (|K - C| + sum e + |a|). Processors that divide and take roots less
exactly than IEEE says, as accelerators by 3 units in the last place, add 12 u of these
for |w| and the quotient and 6 u of |a| for the radius: at most 31 u, and 25 u of
|K - C|, which leaves room for a number of this dtype that the bound is compared with:
no distance is more than |K - C|. `ROUNDINGS` is 32 u.

Underflow. Lengths are in the pair's units, in which what underflows is far below this.
In metres, before and after, what is below the smallest normal float may be taken for
zero: K, C, K - C, e, a and the bound itself, together less than 11 such floats.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbe import _xla
from jaxbe.choice import choose, maximum
from jaxbe.components import (
    clip,
    column,
    dot,
    largest,
    split_matrix,
    split_vector,
    times,
    vector,
    where,
)
from jaxbe.envelope import directional_derivative
from jaxbe.kernel import nearest
from jaxbe.metric import inflated, metric_of, shape
from jaxbe.pose import (
    CanonicalPair,
    canonical_pair,
    materialised,
    reciprocal_power_of_two,
    runtime_witness,
)
from jaxbe.separation import refined_shift
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import ComponentMatrix, Components, Flags, Scalars

MAX_STEPS = 24

ROUNDINGS = 16
"""The slack, in units of eps (|K - C| + sum e + sum a), and in units of the smallest
normal float, in metres; see above."""


class World(NamedTuple):
    """A pair in world axes and in the units of its canonical form; c = K - C."""

    c: Components
    U: ComponentMatrix
    e: Components
    V: ComponentMatrix
    a: Components


class Along(NamedTuple):
    """What a direction gives.

    Attributes:
        n: the direction in box axes, a unit vector.
        distance: the bound, in the pair's units.
        radius: s(n), in the pair's units.
    """

    n: Components
    distance: Scalars
    radius: Scalars


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def distance_lower_bound(box: Box, ellipsoid: Ellipsoid, steps: int) -> Scalars:
    """A number that the signed distance of the very floats given is not below.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        steps: 0 to 24, evaluations of the kernel. None is needed for spheres.

    Returns:
        Metres, of the common batch shape; at one step or more positive for every pair
        that is apart by more than rounding. NaN if any number is NaN, or an axis is
        shorter than half or longer than twice a unit; if one is
        infinite, or lost to under- or overflow, NaN or minus infinity. Derivatives are
        those of the distance along the direction found.
    """
    pair = canonical_pair(box, ellipsoid)
    world = _world(box, ellipsoid, pair)
    bound = (
        _best(world, pair, steps).distance - _slack(world, pair.per_unit)
    ) / pair.per_unit
    return choose(_has_usable_axes(world), bound, jnp.nan)


@distance_lower_bound.defjvp
def _distance_lower_bound_jvp(steps: int, bodies: Any, tangents: Any) -> Any:
    """With the direction held."""
    box, ellipsoid = bodies
    pair = canonical_pair(box, ellipsoid)

    def found(pair: CanonicalPair) -> tuple[Scalars, ...]:
        along = _best(_world(box, ellipsoid, pair), pair, steps)
        return *along.n, along.radius / pair.per_unit

    witness = runtime_witness(pair)
    n_0, n_1, n_2, radius = materialised(found, pair, (2, 4), witness)
    one = jnp.ones_like(radius)
    tangent = directional_derivative(
        bodies, tangents, (n_0, n_1, n_2), radius, of_extent=one, of_radius=one
    )
    return distance_lower_bound(box, ellipsoid, steps), tangent


def _world(box: Box, ellipsoid: Ellipsoid, pair: CanonicalPair) -> World:
    rank = pair.k[0].ndim
    C, K = split_vector(box.center, rank), split_vector(ellipsoid.center, rank)
    return World(
        c=vector(lambda i: (K[i] - C[i]) * pair.per_unit),
        U=split_matrix(box.axes, rank),
        e=pair.e,
        V=split_matrix(ellipsoid.axes, rank),
        a=pair.a,
    )


def _best(world: World, pair: CanonicalPair, steps: int) -> Along:
    """The better one of both directions."""
    toward = _toward_center(pair)
    first = _along(world, toward)
    if not steps:
        return first
    mu = _xla.stay_fused(maximum(first.distance, 0) * first.radius)
    second = _along(world, _scaled(_kernel_normal(pair, mu, steps), toward))
    better = second.distance > first.distance
    return Along(
        where(better, second.n, first.n),
        maximum(second.distance, first.distance),
        choose(better, second.radius, first.radius),
    )


def _along(world: World, n: Components) -> Along:
    """Evaluates a direction n, in box axes, of any length."""
    w = times(world.U, n)
    extent = dot(vector(lambda i: abs(dot(column(world.U, i), w))), world.e)
    terms = vector(lambda p: world.a[p] * dot(column(world.V, p), w))
    radius = _xla.stay_fused(jnp.sqrt(dot(terms, terms)))
    per_norm = _xla.stay_fused(1 / jnp.sqrt(dot(w, w)))
    return Along(
        n=vector(lambda i: n[i] * per_norm),
        distance=(dot(w, world.c) - extent - radius) * per_norm,
        radius=radius * per_norm,
    )


def _toward_center(pair: CanonicalPair) -> Components:
    """From the nearest point of the box to the ellipsoid's centre.

    Where that is within the box: the normal of the nearest face.
    """
    k, e = pair.k, pair.e
    out = vector(lambda i: k[i] - clip(k[i], -e[i], e[i]))
    return _scaled(out, _nearest_face(k, e))


def _nearest_face(k: Components, e: Components) -> Components:
    depth = vector(lambda i: e[i] - abs(k[i]))
    first = (depth[0] <= depth[1]) & (depth[0] <= depth[2])
    second = ~first & (depth[1] <= depth[2])
    chosen = (first, second, ~first & ~second)
    sign = vector(lambda i: choose(k[i] < 0, -1, 1).astype(k[i].dtype))
    return vector(lambda i: choose(chosen[i], sign[i], 0))


def _kernel_normal(pair: CanonicalPair, mu: Scalars, steps: int) -> Components:
    mu = refined_shift(pair, mu, steps - 1)
    form = inflated(shape(pair.R, pair.a), mu)
    return nearest(pair.k, pair.e, metric_of(form, _xla.stay_fused)).n


def _scaled(n: Components, otherwise: Components) -> Components:
    """The direction n with its largest component in [1, 2), if it has one."""
    size = largest(vector(lambda i: abs(n[i])))
    factor = reciprocal_power_of_two(size)
    usable = (size * factor >= 1) & (size * factor <= 2)
    return where(usable, vector(lambda i: n[i] * factor), otherwise)


def _has_usable_axes(world: World) -> Flags:
    """Whether all axes are from half to twice as long as they should be."""
    usable = world.c[0] == world.c[0]
    for axes in (world.U, world.V):
        for i in range(3):
            square = dot(column(axes, i), column(axes, i))
            usable = usable & (square >= 0.25) & (square <= 4)
    return usable


def _slack(world: World, per_unit: Scalars) -> Scalars:
    """How much rounding can add to the bound, in the pair's units."""
    c, e, a = world.c, world.e, world.a
    # Infinite lengths of the wrong sign are not to be decided, either.
    sizes = vector(lambda i: abs(c[i]) + abs(e[i]) + abs(a[i]))
    info = np.finfo(per_unit.dtype)
    rounded = float(ROUNDINGS * info.eps) * (sizes[0] + sizes[1] + sizes[2])
    return rounded + float(ROUNDINGS * info.tiny) * per_unit
