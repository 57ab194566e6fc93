"""All-Features testing: section 2 of the paper, corrected.

The pair overlaps when the ellipsoid's centre is in the box, or a face or an edge
of the box meets the ellipsoid; a vertex is the end of an edge. That is 19
candidates: 1 + 6 + 12.

Corrects these errata of the paper:
    M1: edges are tested as segments (the optimum on the line is clipped), not as
        lines;
    M2: faces as rectangles (the optimum in the plane must lie on the face), not
        as planes;
    T1, T2, T6: slips in the vertex loop, the containment test and the quadric.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator

from jaxbe.choice import choose, minimum
from jaxbe.components import clip, largest, vector
from jaxbe.metric import Metric
from jaxbe.types import Components, Flags, Scalars

BEYOND = 2.0
"""A squared distance that decides nothing; infinity would stop `jax_debug_infs`."""


def overlaps(k: Components, e: Components, m: Metric) -> Flags:
    """Whether the nearest of all features is within the ellipsoid.

    Args:
        k: the ellipsoid's centre in box coordinates.
        e: the half extents.
        m: the ellipsoid's metric in box coordinates.

    Returns:
        True when they overlap or touch, and when a number is NaN.
    """
    candidates = itertools.chain([_inside(k, e)], _edges(k, e, m), _faces(k, e, m))
    return ~(functools.reduce(minimum, candidates) > 1)


def _inside(k: Components, e: Components) -> Scalars:
    """0 if the centre is in the box, else BEYOND; NaN if k is."""
    violation = largest(vector(lambda i: abs(k[i]) - e[i]))
    return choose(violation > 0, BEYOND, 0 * k[0])


def _faces(k: Components, e: Components, m: Metric) -> Iterator[Scalars]:
    """Squared distances to the 6 faces; BEYOND where the optimum is beside one."""
    for i, side in itertools.product(range(3), (-1, 1)):
        j, l = (i + 1) % 3, (i + 2) % 3
        d_i = side * e[i] - k[i]
        on_face = _spans(j, m.in_plane[j][i] * d_i, k, e) & _spans(
            l, m.in_plane[l][i] * d_i, k, e
        )
        yield choose(on_face, m.plane[i] * d_i * d_i, BEYOND)


def _spans(j: int, t: Scalars, k: Components, e: Components) -> Flags:
    """Whether the box has a point with x_j = k_j + t."""
    return (t >= -e[j] - k[j]) & (t <= e[j] - k[j])


def _edges(k: Components, e: Components, m: Metric) -> Iterator[Scalars]:
    """Squared distances to the 12 edges, their ends (the vertices) included."""
    for i, side_j, side_l in itertools.product(range(3), (-1, 1), (-1, 1)):
        j, l = (i + 1) % 3, (i + 2) % 3
        d_j = side_j * e[j] - k[j]
        d_l = side_l * e[l] - k[l]
        r_l = d_l - m.in_plane[l][j] * d_j
        t_i = -(m.on_line[i][j] * d_j + m.on_line[i][l] * d_l)
        r_i = clip(t_i, -e[i] - k[i], e[i] - k[i]) - t_i
        yield m.plane[j] * d_j * d_j + m.line[j][i] * r_l * r_l + m.point[i] * r_i * r_i
