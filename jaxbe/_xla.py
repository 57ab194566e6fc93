"""All that is here because of a compiler: XLA, which JAX compiles with.

The rest of jaxbe is mathematics, and calls these functions by what they ask for. For
values and derivatives each is the identity. They are primitives, because what they ask
for takes other means on a CPU than elsewhere:

- XLA's CPU backend makes of every expression a fusion, a loop over the batch, with one
  result. What several results need it computes again in each, and a fusion of more than
  some 3,000 operations it cuts into functions that call each other, each of which
  computes anew what it shares with others. It removes optimization barriers before it
  fuses. Only a division is never computed twice: divided by a one that it does not see
  through, an array is a fusion and stays; two arrays, as a complex number, are one too.
- Its GPU backend merges fusions of several results by itself, and heeds barriers until
  it has fused. There a program is cut by them alone; complex numbers, packed exponents
  and repeated evaluations would only cost. Uncut, `signed_distance` is one fusion of 30
  million instructions a pair, and the time to compile a fusion grows faster than it.
- Its TPU backend fuses as much as it can, and heeds barriers: they shorten compilation.

Seen in jax 0.6.0 to 0.12.0 (`python -m benchmarks programs`); each entry says when it
may go. `JAXBE_XLA=off` in the environment makes identities of all of them, to measure
what they do.
"""

from __future__ import annotations

import functools
import operator
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxbe.choice import choose, maximum, minimum
from jaxbe.types import Components, Flags, Scalars

Rule = Callable[..., Sequence[Scalars]]

IS_ON = os.environ.get("JAXBE_XLA", "on") != "off"


# Step limits. Each count of steps may be any number: what is beyond them is another
# fusion. They may go when a CPU fusion of any size computes what it shares once.

GROWTH_STEPS = 5
"""Steps of `jaxbe.growth` in one fusion."""

SEPARATION_STEPS = 4
"""Steps of `jaxbe.separation` in one fusion."""

DESCENT_STEPS = 3
"""Steps of two descents of `jaxbe.closest` in one fusion."""

STEPS_BETWEEN_CUTS = 2
"""See `between_steps`."""


def runtime_witness(arrays: Sequence[Scalars]) -> Scalars:
    """An array over the whole batch that is a constant only if all of these are.

    What is a constant inside `jit`, or the same for many pairs, materialises nothing
    on a CPU: a division by it becomes a product. May go with `materialise`.
    """
    return functools.reduce(operator.add, arrays)


def materialise(values: Sequence[Scalars], witness: Scalars) -> list[Scalars]:
    """The arrays, which several results need, each computed once.

    An infinity may become the largest float. May go when a CPU's fusions have several
    results.

    Args:
        values: arrays of one computation. On a CPU it is made anew for every two.
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
    """A positive multiple of u, its largest component 1 or -1, from one computation.

    What is far below rounding is zero. May go with `materialise`.
    """
    u_0, u_1, u_2 = _direction(*_alike(*u, witness))
    return u_0, u_1, u_2


def cut(x: Scalars, witness: Scalars) -> Scalars:
    """The array x, computed before what uses it, and apart, even if that is one fusion.

    (On a CPU `materialise_once` does not part a fusion from the only one that uses it.)
    """
    return _cut(*_alike(x, witness))[0]


def between_steps(state: Sequence[Scalars], number: int) -> list[Scalars]:
    """What an iteration has before another step, where the program may be cut.

    A GPU's and a TPU's are cut after every STEPS_BETWEEN_CUTS: the time to compile a
    fusion there grows faster than the fusion. May go when it does not.
    """
    if not number or number % STEPS_BETWEEN_CUTS:
        return list(state)
    return list(_between(*_alike(*state)))


def stay_fused(x: Scalars) -> Scalars:
    """The quotient or root x, about to be used several times within one fusion.

    XLA's CPU backend gives those a fusion of their own, and with them all that is used
    both before and after. A cheap operation on top of it may be computed again, and
    keeps the fusion whole. May go when quotients may be computed again.
    """
    return _stay_fused(x)[0]


def recompute(x: Scalars, witness: Scalars) -> Scalars:
    """The array x, from which a fusion computes anew what others compute of it, too.

    XLA writes down and reads again, in dozens of arrays, what two fusions share. On a
    CPU it does not see that this x is the one that others have. May go when it weighs
    arrays against operations.

    Args:
        x: any array, of the inputs: it is read again.
        witness: at hand, of the whole batch, another one for each fusion; best one that
            the fusion needs anyway. Where it is NaN so may be the result.
    """
    return _recompute(*_alike(x, witness))[0]


def in_units(x: Scalars, factor: float) -> Scalars:
    """A length x times a power of two, or x: for a fusion in units of its own.

    As `recompute`, for what is not of the inputs: fusions in different units share
    little. Callers must reckon in whatever units they are given.
    """
    return _in_units(x, factor=factor)[0]


def _alike(*arrays: Scalars) -> list[Scalars]:
    """Of one shape, as JAX's arrays."""
    if len({jnp.shape(x) for x in arrays}) > 1:
        return jnp.broadcast_arrays(*arrays)
    return [x if isinstance(x, jax.Array) else jnp.asarray(x) for x in arrays]


# On a CPU.


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


def _scaled(x: Scalars, *, factor: float) -> list[Scalars]:
    return [x * factor]


def _compared(x: Scalars) -> list[Scalars]:
    return [maximum(x, np.asarray(np.finfo(x.dtype).min, x.dtype))]


def _packed(*operands: Scalars) -> list[Scalars]:
    """The two components that are not the largest, over it, as a pair of arrays.

    Which one is the largest, and its sign, go into their exponents.
    """
    *u, witness = operands
    step, least = _exponents(witness)
    is_first, is_last, held = _largest(u)
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


def _largest(u: Sequence[Scalars]) -> tuple[Flags, Flags, Scalars]:
    """Whether the largest component is the first, or the last one; and itself."""
    size = [abs(x) for x in u]
    is_first = (size[0] >= size[1]) & (size[0] >= size[2])
    is_last = ~is_first & (size[2] > size[1])
    return is_first, is_last, choose(is_first, u[0], choose(is_last, u[2], u[1]))


def _not_zero(x: Scalars, least: float) -> Scalars:
    return choose(abs(x) < least, least / 4, x)


def _or_zero(x: Scalars, least: float) -> Scalars:
    return choose(abs(x) < least, 0, x)


# Elsewhere: of the values alone.


def _barred(*values: Scalars) -> Sequence[Scalars]:
    barred: Sequence[Scalars] = lax.optimization_barrier(values)  # type: ignore[no-untyped-call]
    return barred


def _barred_direction(*u: Scalars) -> Sequence[Scalars]:
    return _barred(*_normalised(*u))


def _normalised(*u: Scalars) -> list[Scalars]:
    """The components over the size of the largest one."""
    _, least = _exponents(u[0])
    *_, held = _largest(u)
    size = abs(held)
    return [choose(x == held, jnp.sign(held), _or_zero(x / size, least)) for x in u]


def _unchanged(*values: Scalars, **_: Any) -> Sequence[Scalars]:
    return values


# What both are told.


class _Hint:
    """A primitive: values, and a witness after them if it needs one, to the values.

    Args:
        name: of the primitive, in programs.
        on_cpu: what a CPU computes, of values and witness.
        elsewhere: what others compute, of the values.
        has_witness: whether the last operand is one.
        value: what it is to derivatives.
    """

    def __init__(
        self,
        name: str,
        on_cpu: Rule,
        elsewhere: Rule = _unchanged,
        *,
        has_witness: bool = True,
        value: Rule = _unchanged,
    ) -> None:
        self.primitive = Primitive(f"jaxbe_{name}")
        self.primitive.multiple_results = True
        self.values = slice(-1 if has_witness else None)
        self.value = value
        self.primitive.def_abstract_eval(self._forms)
        self.primitive.def_impl(self._called)
        batching.primitive_batchers[self.primitive] = self._batched
        ad.primitive_jvps[self.primitive] = self._differentiated
        ad.primitive_transposes[self.primitive] = self._transposed
        on_others = _of_values(elsewhere if IS_ON else value, self.values)
        self._lower(on_others, None)
        self._lower(on_cpu if IS_ON else on_others, "cpu")

    def __call__(self, *operands: Scalars, **parameters: Any) -> list[Scalars]:
        results: list[Scalars] = self.primitive.bind(*operands, **parameters)
        return results

    def _lower(self, rule: Rule, platform: str | None) -> None:
        lowered = mlir.lower_fun(rule, multiple_results=True)
        mlir.register_lowering(self.primitive, lowered, platform=platform)

    def _forms(self, *operands: Any, **_: Any) -> list[Any]:
        return list(operands[self.values])

    def _called(self, *operands: Scalars, **parameters: Any) -> list[Scalars]:
        """On arrays, outside of any transformation."""
        return _compiled(self.primitive, *parameters.items())(*operands)

    def _batched(
        self, operands: Sequence[Any], axes: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[int]]:
        mapped = zip(operands, axes, strict=True)
        size = next(x.shape[axis] for x, axis in mapped if axis is not None)
        aligned = [
            _batch_first(*each, size) for each in zip(operands, axes, strict=True)
        ]
        results = self(*aligned, **parameters)
        return results, [0] * len(results)

    def _differentiated(
        self, primals: Sequence[Any], tangents: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[Any]]:
        moved = tangents[self.values]
        if self.value is not _unchanged:
            moved = [ad.instantiate_zeros(tangent) for tangent in moved]
            _, moved = jax.jvp(self.value, primals[self.values], tuple(moved))
        return self(*primals, **parameters), list(moved)

    def _transposed(
        self, cotangents: Sequence[Any], *operands: Any, **parameters: Any
    ) -> list[Any]:
        return [*cotangents, *[None] * (len(operands) - len(cotangents))]


class _LinearHint(_Hint):
    """Derivatives are told as well, for they compute of the values, too."""

    def _differentiated(
        self, primals: Sequence[Any], tangents: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[Any]]:
        tangent, witness = tangents[0], primals[1:]
        if type(tangent) is not ad.Zero:
            (tangent,) = self(tangent, *witness, **parameters)
        return self(*primals, **parameters), [tangent]

    def _transposed(
        self, cotangents: Sequence[Any], *operands: Any, **parameters: Any
    ) -> list[Any]:
        (cotangent,), witness = cotangents, operands[1:]
        if type(cotangent) is not ad.Zero:
            (cotangent,) = self(cotangent, *witness, **parameters)
        return [cotangent, *[None] * len(witness)]


def _of_values(rule: Rule, values: slice) -> Rule:
    return lambda *operands, **parameters: rule(*operands[values], **parameters)


def _batch_first(x: Scalars, axis: int | None, size: int) -> Scalars:
    if axis is None:
        return jnp.broadcast_to(x, (size, *jnp.shape(x)))
    return jnp.moveaxis(x, axis, 0)


@functools.lru_cache
def _compiled(p: Primitive, *parameters: tuple[str, Any]) -> Callable[..., Any]:
    return jax.jit(functools.partial(p.bind, **dict(parameters)))


_materialise = _Hint("materialise", _divided, _barred)
_direction = _Hint(
    "materialise_direction", _packed, _barred_direction, value=_normalised
)
_cut = _Hint("cut", _divided_twice, _barred)
_between = _Hint("between_steps", _unchanged, _barred, has_witness=False)
_stay_fused = _Hint("stay_fused", _compared, has_witness=False)
_recompute = _LinearHint("recompute", _multiplied)
_in_units = _LinearHint("in_units", _scaled, has_witness=False)
