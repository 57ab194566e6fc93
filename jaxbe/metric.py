"""The ellipsoid's metric in box coordinates, ready for conditional optima.

With the letters of the paper, S = R diag(a^2) R^T is the shape matrix
(S_ii = l_i^2 of section 5) and N = S^-1 = U^T M U the metric: the ellipsoid is
(x - k)^T N (x - k) <= 1. Both are computed from R and a, without inversion and
without cancellation in their diagonals; N as its multiple D2 N by the
determinant D2 = (a_0 a_1 a_2)^2, the adjugate of S, so that it needs no division.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from jaxbe.choice import choose
from jaxbe.components import dot, matrix, vector
from jaxbe.types import ComponentMatrix, Components, Flags, Scalars


class Metric(NamedTuple):
    """The quadratic form as sums of three squares, one for each order (i, j, l).

    Put x_i on a plane, at d_i = x_i - k_i. Then the optimum for x_j lies at
    k_j + in_plane[j][i] d_i, and with x_j on a line of that plane the optimum
    for x_l lies at k_l - on_line[l][i] d_i - on_line[l][j] d_j. With r_j and r_l
    the distances from these optima,

        (x - k)^T N (x - k) = plane[i] d_i^2 + line[i][l] r_j^2 + point[l] r_l^2

    for {i, j, l} = {0, 1, 2}. Expanded as a polynomial instead, the form loses
    all digits of a float32 at an aspect ratio of a few thousand.

    Attributes:
        width: l_i = sqrt(S_ii), half the ellipsoid's width along the box axes.
        plane: 1 / S_ii.
        line: S_ii / (D2 N_ll), indexed [i][l].
        point: N_ll.
        in_plane: S_ij / S_ii, indexed [j][i].
        on_line: N_lj / N_ll, indexed [l][j].
    """

    width: Components
    plane: Components
    line: ComponentMatrix
    point: Components
    in_plane: ComponentMatrix
    on_line: ComponentMatrix


class Shape(NamedTuple):
    """An ellipsoid's form: what S and D2 N are made of, which adds up with inflation.

    Attributes:
        squares: a_p^2.
        S: the shape matrix.
        adjugate: D2 N.
    """

    squares: Components
    S: ComponentMatrix
    adjugate: ComponentMatrix


def shape(R: ComponentMatrix, a: Components) -> Shape:
    """The form of an ellipsoid with axes R and semi-axes a."""
    squares = vector(lambda p: a[p] * a[p])
    products = vector(lambda p: squares[(p + 1) % 3] * squares[(p + 2) % 3])
    return Shape(squares, _congruence(R, squares), _congruence(R, products))


def inflated(form: Shape, mu: Scalars) -> Shape:
    """The form with squares a_p^2 + mu, mu >= 0: no diagonal entry cancels."""
    S = form.S
    trace = S[0][0] + S[1][1] + S[2][2]

    def adjugate(i: int, j: int) -> Scalars:
        if i != j:
            return form.adjugate[i][j] - mu * S[i][j]
        return form.adjugate[i][i] + mu * (trace - S[i][i] + mu)

    return Shape(
        vector(lambda p: form.squares[p] + mu),
        matrix(lambda i, j: S[i][j] + mu if i == j else S[i][j]),
        matrix(adjugate),
    )


def metric(R: ComponentMatrix, a: Components) -> Metric:
    """Computes the metric of an ellipsoid with axes R and semi-axes a.

    The semi-axes' squares must be representable in pairs: with the largest
    scaled to about one, in float32 the two smallest may have a product down to
    1e-19 (aspect ratios to 1e9). Below that entries overflow to infinity or
    become NaN, and so does what is computed from them.
    """
    return metric_of(shape(R, a))


def metric_of(form: Shape, hold: Callable[[Scalars], Scalars] = lambda x: x) -> Metric:
    """The metric of a form; `hold` is applied to the quotients in it."""
    squares, S, D2N = form
    per_S = vector(lambda i: hold(1 / S[i][i]))
    per_D2N = vector(lambda i: hold(1 / D2N[i][i]))
    per_D2 = hold(1 / (squares[0] * (squares[1] * squares[2])))
    return Metric(
        width=vector(lambda i: jnp.sqrt(S[i][i])),
        plane=per_S,
        line=matrix(lambda i, l: S[i][i] * per_D2N[l]),
        point=vector(lambda l: D2N[l][l] * per_D2),
        in_plane=matrix(lambda j, i: S[j][i] * per_S[i]),
        on_line=matrix(lambda l, j: D2N[l][j] * per_D2N[l]),
    )


def squared_length(x: Components, m: Metric) -> Scalars:
    """Of x in the metric, squared: x^T N x."""
    r_1 = x[1] - m.in_plane[1][0] * x[0]
    r_2 = x[2] + (m.on_line[2][0] * x[0] + m.on_line[2][1] * x[1])
    return m.plane[0] * x[0] * x[0] + m.line[0][2] * r_1 * r_1 + m.point[2] * r_2 * r_2


def active_inverse(active: tuple[Flags, Flags, Flags], m: Metric) -> ComponentMatrix:
    """(S_AA)^-1 for the set A of active coordinates, without cancellation.

    By Jacobi's identities its entries are those of N, of a line or of a plane,
    whether three, two or one coordinates are active. Rows and columns of inactive
    coordinates hold no meaning.
    """

    def entry(i: int, j: int) -> Scalars:
        others = [p for p in range(3) if p not in (i, j)]
        if i == j:
            j, l = others
            both = choose(active[l], m.point[i], m.line[j][l])
            return choose(active[j], both, choose(active[l], m.line[l][j], m.plane[i]))
        (l,) = others
        alone = -m.in_plane[j][i] * m.line[i][l]
        return choose(active[l], m.on_line[i][j] * m.point[i], alone)

    return matrix(lambda i, j: entry(min(i, j), max(i, j)))


def _congruence(R: ComponentMatrix, diagonal: Components) -> ComponentMatrix:
    """R diag(diagonal) R^T."""
    weighted = matrix(lambda i, p: R[i][p] * diagonal[p])
    return matrix(lambda i, j: dot(weighted[min(i, j)], R[max(i, j)]))
