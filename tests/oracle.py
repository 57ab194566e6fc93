"""The truth, in exact rational arithmetic.

A pair is six nested lists of numbers: the box's centre C, axes U (columns) and
half extents e, the ellipsoid's centre K, axes V (columns) and semi-axes a.
Floats are taken at their exact values. With k = U^T (K - C), R = U^T V and
S = R diag(a^2) R^T the pair overlaps if and only if

    q = min over |x_i| <= e_i of (x - k)^T S^-1 (x - k)

is at most one. The minimum is found by the conditions of Karush, Kuhn and Tucker
over all 27 active sets: nothing here is shared with jaxbe.
"""

from __future__ import annotations

import itertools
from fractions import Fraction
from typing import NamedTuple


class ExactPair(NamedTuple):
    C: list
    U: list
    e: list
    K: list
    V: list
    a: list


def exact(C, U, e, K, V, a) -> ExactPair:
    """Reads floats, Fractions or ints at their exact values."""

    def vector(x):
        return [Fraction(v) for v in x]

    def matrix(m):
        return [vector(row) for row in m]

    return ExactPair(vector(C), matrix(U), vector(e), vector(K), matrix(V), vector(a))


def transpose(m):
    return [list(row) for row in zip(*m, strict=True)]


def product(m, n):
    return [
        [
            sum(x * y for x, y in zip(row, column, strict=True))
            for column in zip(*n, strict=True)
        ]
        for row in m
    ]


def apply(m, x):
    return [sum(p * q for p, q in zip(row, x, strict=True)) for row in m]


def inverse(m):
    """The inverse of a 3x3 matrix by cofactors."""
    cofactors = [
        [
            m[(i + 1) % 3][(j + 1) % 3] * m[(i + 2) % 3][(j + 2) % 3]
            - m[(i + 1) % 3][(j + 2) % 3] * m[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    determinant = sum(m[0][j] * cofactors[0][j] for j in range(3))
    return [[x / determinant for x in row] for row in transpose(cofactors)]


def canonical(pair: ExactPair):
    """k and S^-1."""
    k = apply(transpose(pair.U), [x - y for x, y in zip(pair.K, pair.C, strict=True)])
    R = product(transpose(pair.U), pair.V)
    scaled = [[R[i][p] * pair.a[p] for p in range(3)] for i in range(3)]
    return k, inverse(product(scaled, transpose(scaled)))


def solve(m, b):
    """Solves m x = b by Gauss-Jordan elimination; m is positive definite."""
    rows = [[*row, y] for row, y in zip(m, b, strict=True)]
    for i in range(len(rows)):
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for j in range(len(rows)):
            if j != i:
                rows[j] = [
                    x - rows[j][i] * y for x, y in zip(rows[j], rows[i], strict=True)
                ]
    return [row[-1] for row in rows]


def restricted_minimiser(N, k, e, sides):
    """The minimiser with x_i = sides_i e_i where sides_i is not 0, the rest free."""
    fixed = [i for i in range(3) if sides[i]]
    free = [i for i in range(3) if not sides[i]]
    d = [sides[i] * e[i] - k[i] if sides[i] else Fraction(0) for i in range(3)]
    right = [-sum(N[i][j] * d[j] for j in fixed) for i in free]
    left = [[N[i][j] for j in free] for i in free]
    for i, x in zip(free, solve(left, right), strict=True):
        d[i] = x
    return d


def satisfies_kkt(N, k, e, sides, d) -> bool:
    """Free coordinates in the box, multipliers of active ones of the right sign."""
    gradient = apply(N, d)
    return all(
        sides[i] * gradient[i] <= 0 if sides[i] else abs(k[i] + d[i]) <= e[i]
        for i in range(3)
    )


def squared_distance(pair: ExactPair) -> Fraction:
    """q, from the active set that satisfies the conditions (the problem is convex)."""
    k, N = canonical(pair)
    for sides in itertools.product((0, -1, 1), repeat=3):
        d = restricted_minimiser(N, k, pair.e, sides)
        if satisfies_kkt(N, k, pair.e, sides, d):
            return sum(x * y for x, y in zip(d, apply(N, d), strict=True))
    raise AssertionError("no active set satisfies the optimality conditions")


def overlaps(pair: ExactPair) -> bool:
    return squared_distance(pair) <= 1


def moved(pair: ExactPair, rotation, translation) -> ExactPair:
    """Both bodies moved by one rigid motion."""

    def move(x):
        return [p + q for p, q in zip(apply(rotation, x), translation, strict=True)]

    return pair._replace(
        C=move(pair.C),
        U=product(rotation, pair.U),
        K=move(pair.K),
        V=product(rotation, pair.V),
    )


def rational_rotation(w, x, y, z):
    """The rotation of an integer quaternion, as Fractions."""
    s = Fraction(2, w * w + x * x + y * y + z * z)
    return [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
