"""Primitives that each platform lowers in its own words, for `jaxbe._xla`."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxbe.choice import has_explicit_axes, times_one
from jaxbe.types import Scalars

Rule = Callable[..., Sequence[Scalars]]

SWITCH = "JAXBE_XLA"


def _is_on() -> bool:
    setting = os.environ.get(SWITCH, "on")
    if setting not in ("on", "off"):
        raise ValueError(f"{SWITCH} must be on or off, got {setting!r}")
    return setting == "on"


IS_ON = _is_on()


def unchanged(*operands: Scalars, **_: Any) -> Sequence[Scalars]:
    """The identity."""
    return operands


class Hint:
    """A primitive that returns its operands, but for a witness, which comes last.

    Args:
        name: of the primitive, in programs.
        on_cpu: computes the results, and perhaps more after them, on a CPU.
        elsewhere: computes them on every other platform.
        count: how many results there are of so many operands.
        value: what it is to derivatives, where it is not quite the identity.
    """

    def __init__(
        self,
        name: str,
        on_cpu: Rule,
        elsewhere: Rule,
        count: Callable[[int], int] = lambda operands: operands - 1,
        value: Rule = unchanged,
    ) -> None:
        self.primitive = Primitive(f"jaxbe_{name}")
        self.primitive.multiple_results = True
        self.count = count
        self.value = value
        self.primitive.def_abstract_eval(self._values)  # type: ignore[no-untyped-call]
        self.primitive.def_impl(self._called)  # type: ignore[no-untyped-call]
        batching.primitive_batchers[self.primitive] = self._batched
        ad.primitive_jvps[self.primitive] = self._differentiated
        if value is unchanged:
            ad.primitive_transposes[self.primitive] = self._transposed
        self._lower(elsewhere if IS_ON else value, None)
        self._lower(on_cpu if IS_ON else value, "cpu")

    def __call__(self, *operands: Scalars, **parameters: Any) -> list[Scalars]:
        results: list[Scalars] = self.primitive.bind(*operands, **parameters)  # type: ignore[no-untyped-call]
        return results

    def _values(self, *operands: Any, **_: Any) -> list[Any]:
        count = self.count(len(operands))
        if self.value is unchanged:
            return list(operands[:count])
        # Each is computed of all: where they differ among devices, so does the witness.
        return [operands[-1]] * count

    def _lower(self, rule: Rule, platform: str | None) -> None:
        def results(*operands: Scalars, **parameters: Any) -> Sequence[Scalars]:
            return rule(*operands, **parameters)[: self.count(len(operands))]

        lowered = mlir.lower_fun(results, multiple_results=True)
        mlir.register_lowering(self.primitive, lowered, platform=platform)

    def _called(self, *operands: Scalars, **parameters: Any) -> list[Scalars]:
        """On arrays, outside of any transformation."""
        # Where `jit` is disabled it would call this again, without end.
        with jax.disable_jit(False):
            results: list[Scalars] = _compiled(self, *parameters.items())(*operands)
        return results

    def _batched(
        self, operands: Sequence[Any], axes: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[int]]:
        each = list(zip(operands, axes, strict=True))
        mapped = next(jnp.moveaxis(x, axis, 0) for x, axis in each if axis is not None)
        results = self(*(_batch_first(*one, mapped) for one in each), **parameters)
        return results, [0] * len(results)

    def _differentiated(
        self, primals: Sequence[Any], tangents: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[Any]]:
        if self.value is unchanged:
            moved = self._values(*tangents)
        else:
            whole = tuple(ad.instantiate_zeros(d) for d in tangents)  # type: ignore[no-untyped-call]
            _, moved = jax.jvp(self.value, primals, whole)
        return self(*primals, **parameters), list(moved)

    def _transposed(
        self, cotangents: Sequence[Any], *operands: Any, **parameters: Any
    ) -> list[Any]:
        return [*cotangents, *[None] * (len(operands) - len(cotangents))]


class LinearHint(Hint):
    """Of one value, and of its tangents and cotangents as well."""

    def _differentiated(
        self, primals: Sequence[Any], tangents: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[Any]]:
        moved = self._moved(tangents[0], primals[1:], parameters)
        return self(*primals, **parameters), [moved]

    def _transposed(
        self, cotangents: Sequence[Any], *operands: Any, **parameters: Any
    ) -> list[Any]:
        witness = operands[1:]
        moved = self._moved(cotangents[0], witness, parameters)
        return [moved, *[None] * len(witness)]

    def _moved(self, x: Any, witness: Sequence[Any], parameters: dict[str, Any]) -> Any:
        return x if type(x) is ad.Zero else self(x, *witness, **parameters)[0]


class EachHint(Hint):
    """Of values whose shapes may differ: batch axes stay where they are."""

    def _batched(
        self, operands: Sequence[Any], axes: Sequence[Any], **parameters: Any
    ) -> tuple[list[Scalars], list[Any]]:
        return self(*operands, **parameters), self._values(*axes)


def _batch_first(x: Scalars, axis: int | None, mapped: Scalars) -> Scalars:
    """As the mapped one is, also over an explicit axis of a mesh (`jaxbe.choice`)."""
    if axis is not None:
        return jnp.moveaxis(x, axis, 0)
    x = jnp.broadcast_to(x, mapped.shape)
    return times_one(x, (mapped == mapped) | True) if has_explicit_axes(mapped) else x


@functools.lru_cache
def _compiled(hint: Hint, *parameters: tuple[str, Any]) -> Callable[..., Any]:
    return jax.jit(functools.partial(hint.__call__, **dict(parameters)))
