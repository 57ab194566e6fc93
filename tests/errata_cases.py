"""The counterexamples of the errata: box centre 0, box axes I, exact numbers.

Each has its exact q = f*. A correct test answers q <= 1; the published one does
not. The axes are given as vectors, one a row.
"""

from __future__ import annotations

from fractions import Fraction as F
from typing import NamedTuple

from tests import oracle

IDENTITY = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


class Case(NamedTuple):
    name: str
    e: tuple
    K: tuple
    a: tuple
    q: F
    axes: tuple = IDENTITY

    def pair(self) -> oracle.ExactPair:
        V = oracle.transpose(self.axes)
        return oracle.exact((0, 0, 0), IDENTITY, self.e, self.K, V, self.a)


def thirds(*rows):
    return tuple(tuple(F(x, 3) for x in row) for row in rows)


ONE = (1, 1, 1)
HALF = F(1, 2)

CASES = (
    Case("M1-edge-line-AF", ONE, (3, 1, 1), ONE, F(4)),
    Case("M1-edge-line-CF", ONE, (1, F(5, 2), F(3, 2)), ONE, F(5, 2)),
    Case("M2-face-plane-AF", ONE, (1, 0, 3), ONE, F(4)),
    Case("M2-face-plane-AF-far", ONE, (1, 0, 100), ONE, F(9801)),
    Case("M2-face-plane-CF", ONE, (F(3, 2), 0, 3), ONE, F(17, 4)),
    Case("M2-inside-slab-box", ONE, (F(7, 4),) * 3, ONE, F(27, 16)),
    Case(
        "M3-silhouette-edge", (1, HALF, 1), (-2, -2, 3), (1, 8, 1), F(13, 18),
        thirds((-2, 1, -2), (-2, -2, 1), (-1, 2, 2)),
    ),
    Case(
        "M4-sphere-FN", ONE, (F(3, 2), F(3, 2), 0), ONE, HALF,
        ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    ),
    Case(
        "M4-sphere-FP", ONE, (F(9, 5), F(9, 5), F(4, 5)), ONE, F(32, 25),
        ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    ),
    Case(
        "M4-permuted", (HALF, 1, 1), (-1, -2, 0), (1, 2, 2), F(5, 16),
        ((0, 0, 1), (0, -1, 0), (1, 0, 0)),
    ),
    Case(
        "M4-tilted-FN", ONE, (0, 3, 0), (1, 5, 3), F(766, 2025),
        thirds((1, 2, -2), (2, -2, -1), (-2, -1, -2)),
    ),
    Case(
        "M4-tilted-FP", ONE, (2, 0, -2), (2, 1, 2), F(3, 2),
        thirds((2, -2, 1), (2, 1, -2), (1, 2, 2)),
    ),
    Case(
        "M5-one-face", ONE, (F(1, 4), -4, F(1, 4)), (1, 1, 4), F(1613, 1280),
        ((0, 0, -1), (F(-4, 5), F(-3, 5), 0), (F(-3, 5), F(4, 5), 0)),
    ),
    Case(
        "M5-two-faces", ONE, (1, 2, 5), (1, 4, 8), F(69, 16),
        ((F(3, 5), 0, F(-4, 5)), (0, -1, 0), (F(-4, 5), 0, F(-3, 5))),
    ),
    Case(
        "M5-three-faces", ONE, (-2, -3, 3), (6, F(1, 3), 1), F(71, 59),
        thirds((2, 2, -1), (-2, 1, -2), (-1, 2, 2)),
    ),
    Case("T1-vertex-loop-FN", ONE, (0, F(-3, 2), F(-3, 2)), ONE, HALF),
    Case("T1-vertex-loop-FP", ONE, (-3, 0, 0), (HALF,) * 3, F(16)),
    Case("T2-contains-point", ONE, (3, 3, 3), ONE, F(12)),
    Case("T3-select-FN", ONE, (0, 0, 0), (HALF,) * 3, F(0)),
    Case("T3-select-FP", ONE, (-3, -3, -3), ONE, F(12)),
    Case("T4-bits-FN", ONE, (0, F(3, 2), 0), (F(3, 4),) * 3, F(4, 9)),
    Case("T4-bits-FP", ONE, (0, 3, 0), ONE, F(4)),
    Case(
        "T5-missing-edge", (HALF, HALF, 2), (-1, -1, 4), (4, HALF, 1), F(70, 107),
        thirds((2, 1, -2), (-1, -2, -2), (-2, 2, -1)),
    ),
    Case("T6-exponent", ONE, (0, 0, 10), ONE, F(81)),
    Case("T6-shell", (F(1, 4),) * 3, (0, 0, 0), ONE, F(0)),
)  # fmt: skip
