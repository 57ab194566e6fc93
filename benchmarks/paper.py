"""The paper's three tests as published: their answers are wrong, on purpose.

D. Eberly, "Intersection of Box and Ellipsoid" (Geometric Tools, created 2013-08-04,
(c) 1998-2014), sections 2, 3 and 5, in numpy: line by line, every scalar an array
over the pairs, `return true` and `return false` as masks.

The mathematics is as printed. Repaired are only slips of the pen that a careful
reader repairs without thinking about geometry, marked T1 to T5 (the tags of the
errata that jaxbe's modules list). Errors of the mathematics that remain:
    M1: an edge is tested as its line;
    M2: a face as its plane;
    M4: the cylinder over an edge drops the ellipsoid's own axis of the same number;
    M5: only the vertex and the edges of the centre's octant are tested.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.scenes import Scene

Vector3 = np.ndarray
"""(n, 3)"""


class Box(NamedTuple):
    """Section 1, `struct Box`; `axis[i]` and `extent[i]` are indexed as printed."""

    center: Vector3
    axis: tuple[Vector3, ...]
    extent: tuple[np.ndarray, ...]


class Ellipsoid(NamedTuple):
    """Section 1, `struct Ellipsoid`; with the inverse of M, as V D^-2 V^T."""

    center: Vector3
    axis: tuple[Vector3, ...]
    extent: tuple[np.ndarray, ...]
    M: np.ndarray
    inverse_M: np.ndarray


def bodies(pairs: Scene) -> tuple[Box, Ellipsoid]:
    """The pairs in the paper's data structures, in float64."""
    p = Scene(*(x.astype(np.float64) for x in pairs))
    V, Vt = p.V, np.swapaxes(p.V, 1, 2)
    a = p.a[:, None, :]
    return (
        Box(p.C, _columns(p.U), tuple(p.e.T)),
        Ellipsoid(
            p.K,
            _columns(V),
            tuple(p.a.T),
            M=V / a**2 @ Vt,
            inverse_M=V * a**2 @ Vt,
        ),
    )


# Section 2.

EDGE = (
    *((0, 1), (1, 3), (3, 2), (2, 0)),
    *((4, 5), (5, 7), (7, 6), (6, 4)),
    *((0, 4), (1, 5), (3, 7), (2, 6)),
)
"""`int2 edge[12]` of TestIntersectionAllFeatures."""

FACE = ((0, 0), (1, 0), (0, 1), (2, 1), (0, 2), (4, 2))
"""`int2 face[6]` of TestIntersectionAllFeatures: point index, axis index."""


def ellipsoid_contains_vertex(E: Ellipsoid, V: Vector3) -> np.ndarray:
    """`EllipsoidContainsVertex`."""
    return _dot(V, _times(E.M, V)) <= 1


def ellipsoid_overlaps_edge(E: Ellipsoid, V0: Vector3, V1: Vector3) -> np.ndarray:
    """`EllipsoidOverlapsEdge`: the discriminant alone, so the edge's line (M1)."""
    D, MV = V1 - V0, _times(E.M, V0)
    q0, q1, q2 = _dot(V0, MV) - 1, _dot(D, MV), _dot(D, _times(E.M, D))
    return q1 * q1 - q0 * q2 >= 0


def ellipsoid_overlaps_face(E: Ellipsoid, V: Vector3, N: Vector3) -> np.ndarray:
    """`EllipsoidOverlapsFace`: the extreme along N alone, so the face's plane (M2)."""
    return np.abs(_dot(V, N)) <= np.sqrt(_dot(N, _times(E.inverse_M, N)))


def box_contains_point(B: Box, V: Vector3) -> np.ndarray:
    """`BoxContainsPoint`, with fabs (T2)."""
    return _all(np.abs(_dot(B.axis[i], V)) <= B.extent[i] for i in range(3))


def box_vertex(B: Box, CmK: Vector3, v: int) -> Vector3:
    """V[v]: bit b of v is the side of axis b.

    T1: section 2 prints the bits i0, i1, i2 as axis indices. T4: section 3 prints
    `2*(v & 2) - 1` and `2*(v & 4) - 1` for the signs.
    """
    s = [2 * ((v >> b) & 1) - 1 for b in range(3)]
    return CmK + sum((s[b] * B.extent[b])[:, None] * B.axis[b] for b in range(3))


def all_features(B: Box, E: Ellipsoid) -> np.ndarray:
    """`TestIntersectionAllFeatures`."""
    CmK = B.center - E.center
    V = [box_vertex(B, CmK, j) for j in range(8)]
    found = _any(ellipsoid_contains_vertex(E, V[j]) for j in range(8))
    found |= _any(ellipsoid_overlaps_edge(E, V[i], V[j]) for i, j in EDGE)
    found |= _any(ellipsoid_overlaps_face(E, V[i], B.axis[j]) for i, j in FACE)
    return found | box_contains_point(B, CmK)


# Section 3.

EDGES_OF_FACES = {
    1: ((0, 1), (1, 2), (2, 3), (3, 0)),
    2: ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0), (0, 3)),
    # T5: printed with (4, 5) twice and without (6, 1).
    3: ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 1), (0, 1), (0, 3), (0, 5)),
}
"""`edge` of TestOverlap1Face, TestOverlap2Faces and TestOverlap3Faces."""

QUERY = (
    ((0, 1, 2), (0, 1, 3, 2, 6, 4, 5)),
    ((0, 1), (0, 1, 5, 4, 6, 2)),
    ((0, 1, 2), (4, 5, 1, 0, 2, 6, 7)),
    ((0, 2), (0, 1, 3, 2, 6, 4)),
    ((0,), (0, 2, 6, 4)),
    ((0, 2), (6, 2, 0, 4, 5, 7)),
    ((0, 1, 2), (2, 6, 7, 3, 1, 0, 4)),
    ((0, 1), (2, 0, 4, 6, 7, 3)),
    ((0, 1, 2), (6, 7, 5, 4, 0, 2, 3)),
    ((1, 2), (0, 2, 3, 1, 5, 4)),
    ((1,), (0, 1, 5, 4)),
    ((1, 2), (4, 0, 1, 5, 7, 6)),
    ((2,), (0, 1, 3, 2)),
    ((), ()),
    ((2,), (4, 5, 7, 6)),
    ((1, 2), (3, 1, 0, 2, 6, 7)),
    ((1,), (3, 2, 6, 7)),
    ((1, 2), (7, 3, 2, 6, 4, 5)),
    ((0, 1, 2), (1, 3, 7, 5, 4, 0, 2)),
    ((0, 1), (5, 4, 0, 1, 3, 7)),
    ((0, 1, 2), (5, 7, 6, 4, 0, 1, 3)),
    ((0, 2), (1, 0, 2, 3, 7, 5)),
    ((0,), (1, 3, 7, 5)),
    ((0, 2), (5, 1, 3, 7, 6, 4)),
    ((0, 1, 2), (3, 2, 0, 1, 5, 7, 6)),
    ((0, 1), (7, 5, 1, 3, 2, 6)),
    ((0, 1, 2), (7, 6, 4, 5, 1, 3, 2)),
)
"""`query[3][3][3]`, flattened: normal and vertex; function is the count of normals."""


def contains_point_or_overlaps_faces(
    B: Box,
    E: Ellipsoid,
    CmK: Vector3,
    normal: tuple[int, ...],
    vertex: tuple[int, ...],
) -> np.ndarray:
    """`ContainsPoint`, `TestOverlap1Face`, `TestOverlap2Faces`, `TestOverlap3Faces`.

    The last three differ in their tables only.
    """
    if not normal:
        return np.ones(len(CmK), bool)
    V = [box_vertex(B, CmK, v) for v in vertex]
    found = _any(ellipsoid_contains_vertex(E, v) for v in V)
    edges = EDGES_OF_FACES[len(normal)]
    found |= _any(ellipsoid_overlaps_edge(E, V[i], V[j]) for i, j in edges)
    return found | _any(ellipsoid_overlaps_face(E, V[0], B.axis[n]) for n in normal)


def closest_features(B: Box, E: Ellipsoid) -> np.ndarray:
    """`TestIntersectionClosestFeatures`; pairs of one row of the table together."""
    KmC = E.center - B.center
    xi = [_dot(B.axis[i], KmC) for i in range(3)]
    # T3: printed without a colon and with the first comparison reversed.
    select = [
        np.where(xi[i] < -B.extent[i], 0, np.where(xi[i] <= B.extent[i], 1, 2))
        for i in range(3)
    ]
    row = 9 * select[0] + 3 * select[1] + select[2]
    found = np.empty(len(row), bool)
    for j, (normal, vertex) in enumerate(QUERY):
        at = row == j
        found[at] = contains_point_or_overlaps_faces(
            *_part((B, E, -KmC), at), normal, vertex
        )
    return found


# Section 5.


def minkowski(B: Box, E: Ellipsoid, *, fix_cylinders: bool = False) -> np.ndarray:
    """`TestIntersectionMinkowski`.

    Args:
        B: the boxes.
        E: the ellipsoids.
        fix_cylinders: repair M4, so that M5 alone is left.
    """
    L = [np.sqrt(_dot(U, _times(E.inverse_M, U))) for U in B.axis]
    KmC = E.center - B.center
    xi = [_dot(B.axis[i], KmC) for i in range(3)]
    separated = _any(np.abs(xi[i]) > B.extent[i] + L[i] for i in range(3))

    s = [np.where(xi[i] >= 0, 1, -1) for i in range(3)]
    PmC = sum((s[i] * B.extent[i])[:, None] * B.axis[i] for i in range(3))
    Delta = KmC - PmC
    MDelta = _times(E.M, Delta)
    rsqr = [(_dot(E.axis[i], Delta) / E.extent[i]) ** 2 for i in range(3)]
    UMD = [_dot(B.axis[i], MDelta) for i in range(3)]
    UMU = [[_dot(B.axis[j], _times(E.M, U)) for j in range(3)] for U in B.axis]

    # Outside the elliptical cylinders <P,U2>, <P,U1>, <P,U0>, in the printed order.
    for i, j, l in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        distance = rsqr[i] + rsqr[j]
        if fix_cylinders:
            distance = _dot(Delta, MDelta) - UMD[l] ** 2 / UMU[l][l]
        separated |= (
            (s[i] * (UMD[i] * UMU[l][l] - UMU[i][l] * UMD[l]) > 0)
            & (s[j] * (UMD[j] * UMU[l][l] - UMU[j][l] * UMD[l]) > 0)
            & (distance > 1)
        )
    outside = _all(s[i] * UMD[i] > 0 for i in range(3)) & (sum(rsqr) > 1)
    return ~(separated | outside)


def _columns(matrix: np.ndarray) -> tuple[Vector3, ...]:
    return tuple(matrix[:, :, i] for i in range(3))


def _dot(x: Vector3, y: Vector3) -> np.ndarray:
    return np.einsum("ni,ni->n", x, y)


def _times(matrix: np.ndarray, x: Vector3) -> Vector3:
    return np.einsum("nij,nj->ni", matrix, x)


def _part(tree: Any, which: np.ndarray) -> Any:
    return jax.tree.map(lambda x: x[which], tree)


def _any(masks: Iterable[np.ndarray]) -> np.ndarray:
    return np.logical_or.reduce(list(masks))


def _all(masks: Iterable[np.ndarray]) -> np.ndarray:
    return np.logical_and.reduce(list(masks))
