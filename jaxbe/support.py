"""The support functions of the two bodies, seen from the box.

Along a direction n in box axes the box reaches E = e.|n| from its centre, the
ellipsoid s = sqrt(n^T S n): the length of the vector of a_p v_p.n.
"""

from __future__ import annotations

from jaxbe.components import column, dot, vector
from jaxbe.pose import CanonicalPair
from jaxbe.types import Components, Scalars


def extent(n: Components, e: Components) -> Scalars:
    """E = e.|n|."""
    return dot(vector(lambda i: abs(n[i])), e)


def along_axes(pair: CanonicalPair, n: Components) -> Components:
    """a_p v_p.n, in the ellipsoid's axes; its length is s."""
    return vector(lambda p: pair.a[p] * dot(column(pair.R, p), n))
