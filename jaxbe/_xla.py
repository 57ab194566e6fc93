"""Everything in jaxbe that exists because of a compiler: XLA, which JAX compiles with.

The rest of jaxbe is mathematics, and calls these functions for what they ask of the
compiler. To values and derivatives each is the identity, or nearly. They are primitives
(`jaxbe._xla_primitives`), because a CPU needs other means than every other platform,
which is what "elsewhere" means here:

- A fusion of XLA's CPU backend, one loop over the batch, has one result. What several
  results need it computes again for each, and it cuts a fusion of more than some 3,000
  operations into functions that call each other, each of which computes again what it
  shares. It removes optimization barriers before it fuses. Only a division is never
  computed twice: divided by a one that the compiler does not see through, an array is a
  fusion and stays; two arrays, as a complex number, are one fusion.
- Its GPU backend makes fusions of several results by itself, and honours barriers until
  it has fused. There they alone cut a program, and the rest is the identity. Uncut,
  `signed_distance` is 30 million instructions a pair, for the same reason as on a CPU,
  and the time to compile a fusion grows faster than the fusion.
- Its TPU backend fuses all it can, and honours barriers: with them it compiles faster.

All this was seen in jax 0.6.0 to 0.12.0 (`python -m benchmarks programs` shows what
the programs are); each entry says when it may go. With `JAXBE_XLA=off` in the
environment all are identities, to measure what they do.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbe._xla_primitives import EachHint, Hint, LinearHint, unchanged
from jaxbe.choice import choose, maximum, minimum
from jaxbe.types import Components, Scalars

Tree = TypeVar("Tree")


class StepLimit(NamedTuple):
    """How many steps of an iteration go into one fusion; more steps take more fusions.

    May go when a fusion of any size computes once what it shares, in linear time.

    Attributes:
        at_once: on a CPU. The next ones start from what `hand_over` or `materialise`
            has written down.
        uncut: elsewhere, see `between_steps`.
    """

    at_once: int
    uncut: int


GROWTH_LIMIT = StepLimit(5, 2)
SEPARATION_LIMIT = StepLimit(4, 3)

MAX_TABLE_RATIO = 4
"""A table of all rows against all columns may have so many times the entries wanted.

XLA computes the entries that are chosen from it and no more, in one fusion, and gathers
each row and column once: on a CPU four times as fast as gathering both for each entry.
May go when gathers are fused there.
"""


def runtime_witness(arrays: Sequence[Scalars]) -> Scalars:
    """An array over the whole batch that is a constant only if all of these are.

    What is a constant inside `jit`, or the same for many pairs, materialises nothing
    on a CPU: a division by it becomes a product. May go with `materialise`.
    """
    return functools.reduce(operator.add, arrays)


def materialise(values: Sequence[Scalars], witness: Scalars) -> list[Scalars]:
    """The arrays, which several results need, each computed once.

    An infinity may become the largest float. May go when a fusion of the CPU backend
    has several results.

    Args:
        values: arrays of one computation, which a CPU repeats for every two of them.
        witness: at hand, of the whole batch; see `runtime_witness`. Where it is NaN so
            may be the results.
    """
    return _materialise(*_alike(*values, witness))


def materialise_once(x: Scalars, witness: Scalars) -> Scalars:
    """The array x, computed once: as `materialise`."""
    return materialise([x], witness)[0]


def materialise_two(
    x: Scalars, y: Scalars, witness: Scalars
) -> tuple[Scalars, Scalars]:
    """The arrays x and y, computed once: as `materialise`."""
    x, y = materialise([x, y], witness)
    return x, y


def materialise_vector(x: Components, witness: Scalars) -> Components:
    """The components of x, computed once: as `materialise`."""
    x_0, x_1, x_2 = materialise(x, witness)
    return x_0, x_1, x_2


def materialise_direction(u: Components, witness: Scalars) -> Components:
    """A multiple of u, its largest component 1 or -1 to rounding, computed once.

    What is far below rounding is zero. May go with `materialise`.
    """
    u_0, u_1, u_2 = _direction(*_alike(*u, witness))
    return u_0, u_1, u_2


def cut(x: Scalars, witness: Scalars) -> Scalars:
    """The array x, computed apart from what uses it, even if that is one fusion.

    (On a CPU `materialise_once` does not part a fusion from the only one that uses it.)
    """
    return _cut(*_alike(x, witness))[0]


def hand_over(x: Scalars, y: Scalars, witness: Scalars) -> tuple[Scalars, Scalars]:
    """The state of an iteration after as many steps as a fusion has room for on a CPU.

    As `materialise_two` there; elsewhere `between_steps` cuts. See `StepLimit`.
    """
    x, y = _hand_over(*_alike(x, y, witness))
    return x, y


def between_steps(
    state: Sequence[Scalars], number: int, limit: StepLimit
) -> list[Scalars]:
    """The state of an iteration after so many steps, where a program may be cut.

    A GPU's and a TPU's are cut after every `limit.uncut` steps. See `StepLimit`.
    """
    if number == 0 or number % limit.uncut:
        return list(state)
    return _between_steps(*state)


def stay_fused(x: Scalars) -> Scalars:
    """The quotient or root x, about to be used several times within one fusion.

    XLA's CPU backend gives those a fusion of their own, and with them all that is used
    both before and after. A cheap operation on top of it may be computed again, and
    keeps the fusion whole. May go when quotients may be computed again.
    """
    return _stay_fused(*_alike(x))[0]


def recompute(x: Scalars, witness: Scalars) -> Scalars:
    """The array x, from which a CPU computes anew what others compute of it, too.

    XLA writes down and reads again, in dozens of arrays, what two fusions share. It
    does not see that this x is the one that others have. May go when it weighs arrays
    against operations, as it does for GPUs.

    Args:
        x: of the inputs: it is read again.
        witness: at hand, of the whole batch, another one for each fusion; best one that
            the fusion needs anyway. Where it is NaN so may be the result.
    """
    return _recompute(*_alike(x, witness))[0]


def in_units(x: Scalars, factor: float) -> Scalars:
    """A length x in other units on a CPU: times a power of two, elsewhere unchanged.

    As `recompute`, for what is not of the inputs: fusions in different units share
    little. All lengths of a computation have to be converted, and no result may depend
    on the unit.
    """
    # The unit is a value: derivatives keep the one that they were computed with.
    return x * _unit(jnp.ones((), jnp.result_type(x)), factor=factor)[0]


def recomputed(anew: Tree, known: Tree, witness: Scalars) -> Tree:
    """What is computed anew on a CPU, and elsewhere what is known already.

    Elsewhere these arrays, and only these, are written down for the fusions that
    follow: left alone, XLA's GPU backend, too, writes down all that fusions share. May
    go when it weighs arrays against operations.

    Args:
        anew: arrays of `recompute`.
        known: the same arrays, without.
        witness: as for `recompute`.
    """
    leaves, structure = jax.tree.flatten(anew)
    operands = _alike(*leaves, *jax.tree.leaves(known), witness)
    found: Tree = jax.tree.unflatten(structure, _recomputed(*operands))
    return found


def reread(inputs: Tree, witness: Scalars) -> Tree:
    """The inputs, read again elsewhere than on a CPU by what follows the witness.

    Nothing computed of them before crosses the cut. May go when `recomputed` may.
    """
    leaves, structure = jax.tree.flatten(inputs)
    found: Tree = jax.tree.unflatten(structure, _reread(*leaves, witness))
    return found


def _alike(*arrays: Scalars) -> list[Scalars]:
    """Of one shape, as JAX's arrays."""
    if len({jnp.shape(x) for x in arrays}) > 1:
        return jnp.broadcast_arrays(*arrays)
    return [x if isinstance(x, jax.Array) else jnp.asarray(x) for x in arrays]


# On a CPU: of values, and a witness after them.


def _opaque_one(witness: Scalars) -> Scalars:
    """1, in a way that the compiler does not see through."""
    return choose(witness == witness, 1, jnp.nan).astype(witness.dtype)


def _divided(*operands: Scalars) -> list[Scalars]:
    """A fusion for every two of the values, and for the last one if it is alone."""
    *values, witness = operands
    one = _opaque_one(witness)
    results: list[Scalars] = []
    for x, y in zip(values[::2], values[1::2], strict=False):
        both = lax.complex(_finite(x), _finite(y))
        both = both / lax.complex(one, jnp.zeros_like(one))
        results += [both.real, both.imag]
    return results + [x / one for x in values[len(results) :]]


def _finite(x: Scalars) -> Scalars:
    """An infinity would make the other part of a complex number NaN."""
    most = np.asarray(np.finfo(x.dtype).max, x.dtype)
    return maximum(-most, minimum(x, most))


def _divided_twice(x: Scalars, witness: Scalars) -> list[Scalars]:
    return [minimum(*_divided(x, x, witness))]


def _multiplied(x: Scalars, witness: Scalars) -> list[Scalars]:
    return [x * _opaque_one(witness)]


def _scaled(one: Scalars, *, factor: float) -> list[Scalars]:
    return [one * factor]


def _compared(x: Scalars) -> list[Scalars]:
    return [maximum(x, np.asarray(np.finfo(x.dtype).min, x.dtype))]


def _packed(*operands: Scalars) -> list[Scalars]:
    """The two components that are not the largest, over it, as a pair of arrays.

    Which one is the largest, and its sign, go into their exponents.
    """
    *u, witness = operands
    step, least = _exponents(witness)
    size = [abs(x) for x in u]
    is_first = (size[0] >= size[1]) & (size[0] >= size[2])
    is_last = ~is_first & (size[2] > size[1])
    held = choose(is_first, u[0], choose(is_last, u[2], u[1]))
    (x,) = _compared(choose(is_first, u[1], u[0]) / held)
    (y,) = _compared(choose(is_last, u[1], u[2]) / held)
    x, y = _not_zero(x, least), _not_zero(y, least)
    x = x * choose(is_first, 1, choose(is_last, step * step, step))
    return _unpacked(*_divided(x, y * choose(held < 0, step, 1), witness))


def _unpacked(x: Scalars, y: Scalars) -> list[Scalars]:
    step, least = _exponents(x)
    is_first, is_last = abs(x) < 16, abs(x) > 16 * step
    sign = choose(abs(y) < 16, 1, -1).astype(y.dtype)
    x = x * choose(is_first, 1, choose(is_last, 1 / (step * step), 1 / step))
    x = sign * _or_zero(x, least)
    y = sign * _or_zero(y * choose(sign < 0, 1 / step, 1), least)
    return [
        choose(is_first, sign, x),
        choose(is_first, x, choose(is_last, y, sign)),
        choose(is_last, sign, y),
    ]


def _exponents(x: Scalars) -> tuple[float, float]:
    """A factor that tells numbers up to 1 apart, and the smallest of them."""
    return (2.0**40, 2.0**-30) if x.dtype == np.float32 else (2.0**100, 2.0**-80)


def _not_zero(x: Scalars, least: float) -> Scalars:
    return choose(abs(x) < least, least / 4, x)


def _or_zero(x: Scalars, least: float) -> Scalars:
    return choose(abs(x) < least, 0, x)


def _first_half(*operands: Scalars) -> Sequence[Scalars]:
    return operands[: len(operands) // 2]


# Elsewhere.


def _barrier(*operands: Scalars) -> Sequence[Scalars]:
    found: Sequence[Scalars] = lax.optimization_barrier(operands)  # type: ignore[no-untyped-call]
    return found


def _barrier_of_values(*operands: Scalars) -> Sequence[Scalars]:
    """Without the witness, which need not be there then."""
    return _barrier(*operands[:-1])


def _barrier_of_known(*operands: Scalars) -> Sequence[Scalars]:
    """With the witness: two barriers of the same arrays alone would become one."""
    return _barrier(*operands[len(operands) // 2 :])


def _barrier_of_direction(*operands: Scalars) -> Sequence[Scalars]:
    return _barrier(*_normalised(*operands))


def _normalised(*operands: Scalars) -> list[Scalars]:
    """The components over the size of the largest one."""
    u = operands[:3]
    _, least = _exponents(u[0])
    size = maximum(maximum(abs(u[0]), abs(u[1])), abs(u[2]))
    return [_or_zero(x / size, least) for x in u]


# The primitives.


def _every(operands: int) -> int:
    return operands


def _half(operands: int) -> int:
    return operands // 2


_materialise = Hint("materialise", _divided, _barrier_of_values)
_direction = Hint(
    "materialise_direction", _packed, _barrier_of_direction, value=_normalised
)
_cut = Hint("cut", _divided_twice, _barrier_of_values)
_hand_over = Hint("hand_over", _divided, unchanged)
_between_steps = EachHint("between_steps", unchanged, _barrier, _every)
_stay_fused = Hint("stay_fused", _compared, unchanged, _every)
_recompute = LinearHint("recompute", _multiplied, unchanged)
_unit = Hint("unit", _scaled, unchanged, _every)
_recomputed = Hint("recomputed", _first_half, _barrier_of_known, _half)
_reread = EachHint("reread", unchanged, _barrier)
