"""Arrays to be computed once, for XLA's CPU backend.

A loop that it makes has one result. What several results need it computes again for
each, and on the way cuts a kernel into dozens of loops; only a division is never done
twice. Divided by one, an array is one loop and stays; two arrays, as a complex number,
are one loop too. To other backends it makes no difference, and to derivatives none.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbe.choice import choose, maximum, minimum
from jaxbe.types import Components, Scalars


@jax.custom_jvp
def kept(x: Scalars, given: Scalars) -> Scalars:
    """The array x.

    Args:
        x: what several results need.
        given: an array at hand, of the whole batch and no constant (see
            `jaxbe.pose.of_all`): a division by a constant, or by what XLA repeats along
            an axis, becomes a product, and keeps nothing. NaN makes x NaN.
    """
    return x / opaque_one(given)


@kept.defjvp
def _kept_jvp(primals: Any, tangents: Any) -> Any:
    return kept(*primals), tangents[0]


@jax.custom_jvp
def kept_pair(x: Scalars, y: Scalars, given: Scalars) -> tuple[Scalars, Scalars]:
    """The arrays x and y, of one shape, from one loop; `given` as for `kept`.

    An infinity becomes the largest float: it would make the other one NaN.
    """
    one = opaque_one(given)
    both = lax.complex(_finite(x), _finite(y)) / lax.complex(one, jnp.zeros_like(one))
    return both.real, both.imag


@kept_pair.defjvp
def _kept_pair_jvp(primals: Any, tangents: Any) -> Any:
    return kept_pair(*primals), tangents[:2]


def kept_vector(x: Components, given: Scalars) -> Components:
    """The components of x, from two loops; `given` as for `kept`."""
    return (*kept_pair(x[0], x[1], given), kept(x[2], given))


def kept_from(x: Scalars, given: Scalars) -> Scalars:
    """The array x, kept even if only one loop uses it (`kept` leaves it to that)."""
    return minimum(*kept_pair(x, x, given))


def kept_direction(u: Components, given: Scalars) -> Components:
    """A positive multiple of u, its largest component +-1, from one loop.

    The other two components, over the largest, are a pair of arrays. Which one is the
    largest, and its sign, go into their exponents; what is far below rounding is zero.
    """
    step, least = _exponents(given)
    size = [abs(x) for x in u]
    is_first = (size[0] >= size[1]) & (size[0] >= size[2])
    is_last = ~is_first & (size[2] > size[1])
    held = choose(is_first, u[0], choose(is_last, u[2], u[1]))
    x = _not_zero(shared(choose(is_first, u[1], u[0]) / held), least)
    y = _not_zero(shared(choose(is_last, u[1], u[2]) / held), least)
    x = x * choose(is_first, 1, choose(is_last, step * step, step))
    x, y = kept_pair(x, y * choose(held < 0, step, 1), given)
    is_first, is_last = abs(x) < 16, abs(x) > 16 * step
    sign = choose(abs(y) < 16, 1, -1).astype(y.dtype)
    x = x * choose(is_first, 1, choose(is_last, 1 / (step * step), 1 / step))
    x = sign * _or_zero(x, least)
    y = sign * _or_zero(y * choose(sign < 0, 1 / step, 1), least)
    return (
        choose(is_first, sign, x),
        choose(is_first, x, choose(is_last, y, sign)),
        choose(is_last, sign, y),
    )


def _exponents(given: Scalars) -> tuple[float, float]:
    """A factor that tells numbers up to 1 apart, and the smallest of them."""
    return (2.0**40, 2.0**-30) if given.dtype == np.float32 else (2.0**100, 2.0**-80)


def _not_zero(x: Scalars, least: float) -> Scalars:
    return choose(abs(x) < least, least / 4, x)


def _or_zero(x: Scalars, least: float) -> Scalars:
    return choose(abs(x) < least, 0, x)


def _finite(x: Scalars) -> Scalars:
    most = np.asarray(np.finfo(x.dtype).max, x.dtype)
    return maximum(-most, minimum(x, most))


def opaque_one(given: Scalars) -> Scalars:
    """1, in a way that the compiler does not see through."""
    return choose(given == given, 1, jnp.nan).astype(given.dtype)


def shared(x: Scalars) -> Scalars:
    """The quotient or root x, about to be used several times within one loop.

    XLA gives those a loop of their own, and with them all that is used both before and
    after. A cheap operation on top of it may be repeated, and keeps the loop in one.
    """
    return maximum(x, np.asarray(np.finfo(x.dtype).min, x.dtype))
