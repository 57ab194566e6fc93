"""Minkowski-sum testing: section 5 of the paper, corrected.

The pair overlaps when the ellipsoid's centre is in the sum of box and ellipsoid.
The centre is outside exactly if it is beyond one of the sum's 26 patches: 6 flat
ones (together the slab box B'), 12 elliptic cylinders over edges and 8 ellipsoids
over vertices. A patch over the feature sigma rejects the pair when the centre is
in its normal cone (all multipliers there have the sign of sigma) and further than
1 in the ellipsoid's metric. Each rejection is sound by itself: with positive
multipliers the point of the feature is the nearest one of a wedge that contains
the box.

The box is symmetric, so the octant of k suffices (x_i -> -x_i where k_i < 0):
features with no side facing k cannot reject, which leaves 19 = 3 + 9 + 7.

Corrects these errata of the paper:
    M4: the cylinder is the projection of the ellipsoid along the *edge*, not
        along the ellipsoid's own axis;
    M5: one vertex and three edges, those of K's octant, do not suffice.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator

import jax.numpy as jnp

from jaxbe.choice import choose
from jaxbe.components import matrix, vector
from jaxbe.metric import Metric
from jaxbe.types import ComponentMatrix, Components, Flags, Scalars

FACING_VERTICES = tuple(s for s in itertools.product((1, -1), repeat=3) if 1 in s)
FACING_EDGES = tuple(s for s in itertools.product((1, -1), repeat=2) if 1 in s)


def overlaps(k: Components, e: Components, m: Metric) -> Flags:
    """Whether no patch of the Minkowski sum rejects the pair.

    Args:
        k: the ellipsoid's centre in box coordinates.
        e: the half extents.
        m: the ellipsoid's metric in box coordinates.

    Returns:
        True when they overlap or touch, and when a number is NaN.
    """
    octant = vector(lambda i: choose(k[i] < 0, -1, 1).astype(k[i].dtype))
    k = vector(lambda i: abs(k[i]))
    m = m._replace(
        in_plane=_reflect(m.in_plane, octant), on_line=_reflect(m.on_line, octant)
    )
    rejections = itertools.chain(
        _beyond_faces(k, e, m), _beyond_edges(k, e, m), _beyond_vertices(k, e, m)
    )
    return ~functools.reduce(jnp.logical_or, rejections)


def _reflect(table: ComponentMatrix, octant: Components) -> ComponentMatrix:
    """The table after x_i -> octant_i x_i; its diagonal is not in use."""
    return matrix(lambda i, j: table[i][j] * octant[i] * octant[j])


def _beyond_faces(k: Components, e: Components, m: Metric) -> Iterator[Flags]:
    """Outside the slab box B': further than l_i = sqrt(S_ii) from a face."""
    for i in range(3):
        d_i = k[i] - e[i]
        yield (d_i > 0) & (m.plane[i] * d_i * d_i > 1)


def _beyond_edges(k: Components, e: Components, m: Metric) -> Iterator[Flags]:
    """Outside the cylinder over an edge along axis i, seen along that edge."""
    for i, (side_j, side_l) in itertools.product(range(3), FACING_EDGES):
        j, l = (i + 1) % 3, (i + 2) % 3
        d_j = k[j] - side_j * e[j]
        d_l = k[l] - side_l * e[l]
        r_j = d_j - m.in_plane[j][l] * d_l
        r_l = d_l - m.in_plane[l][j] * d_j
        distance = m.plane[j] * d_j * d_j + m.line[j][i] * r_l * r_l
        yield (side_j * r_j > 0) & (side_l * r_l > 0) & (distance > 1)


def _beyond_vertices(k: Components, e: Components, m: Metric) -> Iterator[Flags]:
    """Outside the ellipsoid over a vertex, in the cone of its normals."""
    for sides in FACING_VERTICES:
        d = vector(lambda i: k[i] - sides[i] * e[i])  # noqa: B023
        r = vector(lambda i: _line_residual(i, d, m))  # noqa: B023
        in_cone = functools.reduce(
            jnp.logical_and, (sides[i] * r[i] > 0 for i in range(3))
        )
        r_1 = d[1] - m.in_plane[1][0] * d[0]
        distance = (
            m.plane[0] * d[0] * d[0]
            + m.line[0][2] * r_1 * r_1
            + m.point[2] * r[2] * r[2]
        )
        yield in_cone & (distance > 1)


def _line_residual(l: int, d: Components, m: Metric) -> Scalars:
    """d_l minus its optimum given the other two: N_ll times it is a multiplier."""
    i, j = (l + 1) % 3, (l + 2) % 3
    return d[l] + m.on_line[l][i] * d[i] + m.on_line[l][j] * d[j]
