"""Closest-Features testing: section 3 of the paper, corrected.

Only faces that are visible from the ellipsoid's centre can hold the nearest
point. Of the faces x_i = +-e_i at most one is visible, the one on the side of
k_i; on it the nearest point is found one dimension lower in the same way. Done
without branches that is the kernel: three choices of the first face, two of the
edge on it.

Corrects these errata of the paper:
    M1, M2: segments and rectangles instead of lines and planes;
    M3: the count of features in the text (the optimum can be on a silhouette
        edge or vertex), for the code's 7 vertices, 9 edges, 3 faces, here 3
        faces and 6 edges with their ends;
    T3, T4, T5: slips in the selection, the vertex bits and the edge table.
"""

from __future__ import annotations

from jaxbe.kernel import squared_distance
from jaxbe.metric import Metric
from jaxbe.types import Components, Flags


def overlaps(k: Components, e: Components, m: Metric) -> Flags:
    """Whether the nearest point of the box is within the ellipsoid.

    Args:
        k: the ellipsoid's centre in box coordinates.
        e: the half extents.
        m: the ellipsoid's metric in box coordinates.

    Returns:
        True when they overlap or touch, and when a number is NaN.
    """
    return ~(squared_distance(k, e, m) > 1)
