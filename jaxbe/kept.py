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

from jaxbe.types import Scalars


@jax.custom_jvp
def kept(x: Scalars, given: Scalars) -> Scalars:
    """The array x.

    Args:
        x: what several results need.
        given: an array at hand, best an argument of the program; NaN makes x NaN.
    """
    return x / _one(given)


@kept.defjvp
def _kept_jvp(primals: Any, tangents: Any) -> Any:
    return kept(*primals), tangents[0]


@jax.custom_jvp
def kept_pair(x: Scalars, y: Scalars, given: Scalars) -> tuple[Scalars, Scalars]:
    """The arrays x and y, of one shape, from one loop; `given` as for `kept`.

    An infinity becomes the largest float: it would make the other one NaN.
    """
    one = _one(given)
    both = lax.complex(_finite(x), _finite(y)) / lax.complex(one, jnp.zeros_like(one))
    return both.real, both.imag


@kept_pair.defjvp
def _kept_pair_jvp(primals: Any, tangents: Any) -> Any:
    return kept_pair(*primals), tangents[:2]


def kept_from(x: Scalars, given: Scalars) -> Scalars:
    """The array x, kept even if only one loop uses it (`kept` leaves it to that)."""
    return jnp.minimum(*kept_pair(x, x, given))


def _finite(x: Scalars) -> Scalars:
    most = np.asarray(np.finfo(x.dtype).max, x.dtype)
    return jnp.maximum(-most, jnp.minimum(x, most))


def _one(given: Scalars) -> Scalars:
    """1, in a way that the compiler does not see through."""
    return jnp.where(given == given, 1, jnp.nan).astype(given.dtype)


def shared(x: Scalars) -> Scalars:
    """The quotient or root x, about to be used several times within one loop.

    XLA gives those a loop of their own, and with them all that is used both before and
    after. A cheap operation on top of it may be repeated, and keeps the loop in one.
    """
    return jnp.maximum(x, np.asarray(np.finfo(x.dtype).min, x.dtype))
