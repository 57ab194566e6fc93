"""What makes a box or an ellipsoid legal: shapes, dtypes and values.

Shapes and dtypes are known while tracing, so they are checked always and cost
nothing. Values are checked in eager constructors, and on request inside
compiled code (`jaxbe.checked`).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbe.types import ArrayLike

DTYPES = ("float32", "float64")

NARROW = "bfloat16"
"""Taken by the constructors, and exactly converted to float32."""

ORTHONORMAL_ROUNDINGS = 1000
"""Axes may differ from orthonormal by so many units of rounding (`eps`)."""

NARROW_TOLERANCE = 0.03
"""Or, in bfloat16, by so much: four units of rounding."""

DRIFT = 1e-3
"""Axes that are further from orthonormal are no drifted rotation."""

DENORMAL = "(a denormal number counts as zero)"

_TAILS = {"axes": (3, 3), "wxyz": (4,)}
"""The trailing axes of the fields that are not vectors of three."""


class Rule(NamedTuple):
    """A condition on a field's values; `ok` has one entry a checked number."""

    argument: str
    requirement: str
    ok: Any


Rules = Callable[[Mapping[str, Any], ModuleType], Iterator[Rule]]


def as_count(name: str, count: Any, least: int, most: int) -> int:
    """A number of steps, which is part of the program.

    Raises:
        TypeError: not a Python integer.
        ValueError: out of range.
    """
    try:
        number = operator.index(_not_a_flag(count))
    except TypeError:
        raise TypeError(
            f"{name} must be a Python integer (static under jit), got {count!r}"
        ) from None
    if not least <= number <= most:
        raise ValueError(f"{name} must be from {least} to {most}, got {number}")
    return number


def as_number(name: str, number: Any) -> float:
    """A number that is known, and no more than one; NaN and infinity are some.

    Raises:
        TypeError: anything else.
    """
    try:
        if np.ndim(number) == 0 and not isinstance(number, str | bytes):
            return float(_not_a_flag(number))
    except (TypeError, ValueError, OverflowError):
        pass
    raise TypeError(f"{name} must be a number, got {number!r}")


def _not_a_flag(x: Any) -> Any:
    """To Python True is one, but nobody means it."""
    if isinstance(x, bool | np.bool_):
        raise TypeError("a boolean is no number")
    return x


def as_floats(kind: str, fields: Mapping[str, ArrayLike]) -> dict[str, jax.Array]:
    """Converts the fields of a shape to arrays of one floating-point dtype.

    Python numbers and lists take the dtype of the fields that are arrays, or
    JAX's default float. Arrays of bfloat16 become float32 (see `_widened`).

    Raises:
        TypeError: a field is an array of another dtype than float32, float64 or
            bfloat16, or two fields then differ in dtype.
    """
    wide = {
        name: _widened(name, owned(x)) if hasattr(x, "dtype") else x
        for name, x in fields.items()
    }
    arrays = _of_one_dtype(kind, wide, jnp)
    # A weak type would compile every caller a second time.
    return {n: lax.convert_element_type(x, x.dtype) for n, x in arrays.items()}


def owned(x: ArrayLike, dtype: Any = None) -> jax.Array:
    """An array of JAX that shares no memory with one of NumPy, which may change later.

    JAX by itself takes over what is aligned, or copies it at some later time.
    """
    return jnp.asarray(x if isinstance(x, jax.Array) else np.array(x, dtype), dtype)


def as_host_floats(kind: str, fields: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
    """As `as_floats`, but arrays of NumPy, where they are: nothing is copied or read.

    Raises:
        TypeError: as `as_floats`.
    """
    return _of_one_dtype(kind, fields, np)


def check_fields(kind: str, fields: Mapping[str, jax.Array]) -> tuple[int, ...]:
    """Checks dtypes and shapes, at trace time; returns the batch shape.

    Raises:
        TypeError: a dtype that is not float32 or float64, or not the same in
            all fields; an array of JAX in float64 where that is switched off.
        ValueError: a shape without the trailing axes that the field needs, or
            leading axes that do not broadcast.
    """
    for name, x in fields.items():
        _check_dtype(kind, name, x)
        _check_float64(kind, name, x)
        tail = _TAILS.get(name, (3,))
        if x.shape[-len(tail) :] != tail:
            expected = ", ".join(["...", *map(str, tail)])
            raise ValueError(
                f"{kind}: {name} must have shape ({expected}), got {x.shape}"
            )
    _check_one_dtype(kind, fields)
    leading = {name: batch_axes(name, x) for name, x in fields.items()}
    try:
        return lax.broadcast_shapes(*leading.values())
    except ValueError:
        raise ValueError(
            f"{kind}: the leading axes of its fields must broadcast, got {leading}"
        ) from None


def batch_axes(name: str, x: Any) -> tuple[int, ...]:
    """The lengths of the leading axes of the field so named."""
    return tuple(x.shape[: x.ndim - len(_TAILS.get(name, (3,)))])


def value_rules(fields: Mapping[str, Any], xp: ModuleType) -> Iterator[Rule]:
    """The conditions that legal values meet, each evaluated elementwise.

    Args:
        fields: arrays by argument name.
        xp: the module that computes: `numpy` for values at hand, `jax.numpy`
            for values inside a trace.
    """
    for name, x in fields.items():
        yield Rule(name, "finite", xp.isfinite(x))
    if "axes" in fields:
        axes = fields["axes"]
        if str(axes.dtype) == NARROW:
            yield _orthonormal(axes.astype("float32"), xp, NARROW_TOLERANCE)
        else:
            roundings = ORTHONORMAL_ROUNDINGS * float(np.finfo(axes.dtype).eps)
            yield _orthonormal(axes, xp, roundings)
    if "wxyz" in fields:
        nonzero = _is_normal(xp.abs(fields["wxyz"]))
        nonzero = xp.any(nonzero, axis=-1, keepdims=True)
        yield Rule("wxyz", f"of non-zero length {DENORMAL}", nonzero)
    if "half_extents" in fields:
        yield Rule("half_extents", "non-negative", fields["half_extents"] >= 0)
    if "semi_axes" in fields:
        positive = _is_normal(fields["semi_axes"])
        yield Rule("semi_axes", f"positive {DENORMAL}", positive)


def possible_rules(fields: Mapping[str, Any], xp: ModuleType) -> Iterator[Rule]:
    """What holds where simulations drift or fail, but not where bodies are optimised.

    Axes that are far from a rotation, and negative lengths, are finite numbers that
    mean no body; NaN and infinity pass.

    Args:
        fields: as for `value_rules`.
        xp: as for `value_rules`.
    """
    for name, x in fields.items():
        if name == "axes":
            yield _orthonormal(x, xp, DRIFT, unless_infinite=True)
        elif name != "center":
            yield Rule(name, "non-negative", (x >= 0) | ~xp.isfinite(x))


def check_possible(kind: str, fields: Mapping[str, Any]) -> None:
    """Checks concrete arrays by `possible_rules`, where they are: one flag is fetched.

    Raises:
        ValueError: as `check_values`.
    """
    if not all(map(is_readable, fields.values())):
        return
    with jax.ensure_compile_time_eval():
        if all(bool(jnp.all(rule.ok)) for rule in possible_rules(fields, jnp)):
            return
    check_values(kind, fields, possible_rules)


def check_values(
    kind: str, fields: Mapping[str, Any], rules: Rules = value_rules
) -> None:
    """Checks the values of concrete arrays; traced ones pass unread.

    Raises:
        ValueError: naming the argument, the requirement and the first value
            that breaks it.
    """
    if not all(map(is_readable, fields.values())):
        return
    values = {name: np.asarray(x) for name, x in fields.items()}
    for rule in rules(values, np):
        if not np.all(rule.ok):
            found = _first_broken(rule.argument, values[rule.argument], rule.ok)
            raise ValueError(
                f"{kind}: {rule.argument} must be {rule.requirement}, got {found}"
            )


def narrow_axes(fields: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    """The axes among the fields if they are in bfloat16: what is left to be checked."""
    axes = fields.get("axes")
    is_narrow = str(getattr(axes, "dtype", "")) == NARROW
    return {"axes": jnp.asarray(axes)} if is_narrow else {}


def _widened(name: str, x: jax.Array) -> jax.Array:
    """A bfloat16 array in float32, exactly; axes as the nearest orthonormal ones.

    In eight bits axes are orthonormal to 1 % only, which is no rotation: what fits
    neither the box nor the ellipsoid that was meant.
    """
    if str(x.dtype) != NARROW:
        return x
    wide = x.astype(jnp.float32)
    if name != "axes" or x.shape[-2:] != (3, 3):
        return wide
    # Newton's iteration for the polar factor: a defect d becomes 3/4 d^2.
    for _ in range(2):
        excess = _gram(wide, jnp) - _identity(wide, jnp)
        wide = wide - jnp.sum(wide[..., :, :, None] * excess[..., None, :, :], -2) / 2
    return wide


def _is_normal(x: Any) -> Any:
    """Where x is a positive number that compiled programs do not take for zero."""
    return x >= np.finfo(x.dtype).tiny


def _orthonormal(
    axes: Any, xp: ModuleType, tolerance: float, unless_infinite: bool = False
) -> Rule:
    excess = xp.abs(_gram(axes, xp) - _identity(axes, xp))
    ok = excess <= tolerance
    if unless_infinite:
        ok = ok | ~xp.isfinite(excess)
    return Rule("axes", f"orthonormal in their columns (to {tolerance:.1e})", ok)


def _gram(axes: Any, xp: ModuleType) -> Any:
    """The scalar products of the columns."""
    return xp.sum(axes[..., :, :, None] * axes[..., :, None, :], axis=-3)


def _identity(axes: Any, xp: ModuleType) -> Any:
    return xp.broadcast_to(xp.eye(3, dtype=axes.dtype), axes.shape)


def _first_broken(argument: str, x: np.ndarray, ok: np.ndarray) -> str:
    """The first vector or matrix of the batch `x` whose entries are not all ok."""
    leading = ok.ndim - len(_TAILS.get(argument, (3,)))
    batch = np.unravel_index(np.argmin(ok), ok.shape)[:leading]
    place = f" at batch index {tuple(map(int, batch))}" if batch else ""
    return f"{x[batch].tolist()}{place}"


def is_readable(x: Any) -> bool:
    """Whether the values of an array, of NumPy or JAX, are known and at hand."""
    if isinstance(x, jax.core.Tracer):
        return False
    return not isinstance(x, jax.Array) or x.is_fully_addressable


def _of_one_dtype(
    kind: str, fields: Mapping[str, ArrayLike], xp: ModuleType
) -> dict[str, Any]:
    """The fields as arrays of `xp`, JAX's or plain NumPy."""
    given = {name: xp.asarray(x) for name, x in fields.items() if hasattr(x, "dtype")}
    for name, x in given.items():
        _check_dtype(kind, name, x)
    default = next(iter(given.values())).dtype if given else jnp.zeros(()).dtype
    arrays = {
        name: given[name] if name in given else xp.asarray(x, default)
        for name, x in fields.items()
    }
    _check_one_dtype(kind, arrays)
    return arrays


def _check_dtype(kind: str, name: str, x: jax.Array) -> None:
    if str(x.dtype) not in DTYPES:
        raise TypeError(f"{kind}: {name} must be {' or '.join(DTYPES)}, got {x.dtype}")


def _check_float64(kind: str, name: str, x: jax.Array) -> None:
    """Half of what is computed would be rounded to float32, and not be comparable."""
    is_off = not jax.config.jax_enable_x64  # type: ignore[attr-defined]
    if is_off and isinstance(x, jax.Array) and x.dtype == np.float64:
        raise TypeError(
            f"{kind}: {name} is float64, which is switched off here (jax_enable_x64): "
            "use the body where it was built, or build it of float32"
        )


def _check_one_dtype(kind: str, fields: Mapping[str, jax.Array]) -> None:
    dtypes = {name: str(x.dtype) for name, x in fields.items()}
    if len(set(dtypes.values())) > 1:
        raise TypeError(f"{kind}: its fields must have one dtype, got {dtypes}")
