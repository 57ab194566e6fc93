"""Jaxprs evaluated in NumPy as an accelerator may: roots and quotients a bit wrong.

XLA for GPUs and TPUs divides and takes roots by approximations, a few units in the last
place off, contracts a * b + c to one rounding, and may take subnormal numbers for zero.
Everything else is IEEE's. Here each of these is chosen, and no accelerator is needed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbe import _xla

MOST_UNITS = 3
"""By so many units in the last place a quotient or a root may be off."""

Move = Callable[[int, np.ndarray], Any]
"""How far the result of quotient or root number i is off: units, away from zero."""


class Value(NamedTuple):
    """An array, and if it is a product, of what: that may be contracted."""

    array: np.ndarray
    factors: tuple[np.ndarray, np.ndarray] | None = None


Rule = Callable[..., Sequence[Value]]
"""What a primitive does: the results, of its operands and (by name) its parameters."""


def identity(*operands: Value, **_: Any) -> Sequence[Value]:
    """All operands."""
    return operands


def all_but_last(*operands: Value, **_: Any) -> Sequence[Value]:
    """The last one, the witness, is for the compiler's eyes only."""
    return operands[:-1]


def second_half(*operands: Value, **_: Any) -> Sequence[Value]:
    """What is known already, not what would be computed anew; without the witness."""
    return operands[len(operands) // 2 : -1]


COMPILER_PRIMITIVES: dict[str, Rule] = {
    "jaxbe_materialise": all_but_last,
    "jaxbe_cut": all_but_last,
    "jaxbe_hand_over": all_but_last,
    "jaxbe_between_steps": identity,
    "jaxbe_stay_fused": identity,
    "jaxbe_recompute": all_but_last,
    "jaxbe_unit": identity,
    "jaxbe_recomputed": second_half,
    "jaxbe_reread": all_but_last,
}
"""What the primitives by which jaxbe speaks to the compiler do on an accelerator."""


COMPILER_FUNCTIONS = {_xla._direction.primitive.name: _xla._direction.value}
"""Those that compute something there: its quotients are moved, too."""


class Arithmetic(NamedTuple):
    """How an accelerator computes.

    Attributes:
        move: how far quotients and roots are off; see `MOVES`.
        contracts: the fraction of the products that are added to something without
            having been rounded before: 0, 1, or a chance.
        flushes: whether subnormal operands and results are zero.
        seed: of the chance.
    """

    move: Move = lambda site, value: 0
    contracts: float = 0
    flushes: bool = False
    seed: int = 0


def _away(site: int, value: np.ndarray) -> Any:
    return MOST_UNITS


def _toward(site: int, value: np.ndarray) -> Any:
    return -MOST_UNITS


def _up(site: int, value: np.ndarray) -> Any:
    return np.where(value < 0, -MOST_UNITS, MOST_UNITS)


def _down(site: int, value: np.ndarray) -> Any:
    return -_up(site, value)


def _random(site: int, value: np.ndarray) -> Any:
    rng = np.random.default_rng(site)
    return rng.integers(-MOST_UNITS, MOST_UNITS + 1, value.shape)


def _corners(site: int, value: np.ndarray) -> Any:
    rng = np.random.default_rng(site)
    return rng.choice([-MOST_UNITS, MOST_UNITS], value.shape)


MOVES: dict[str, Move] = {
    "exact": lambda site, value: 0,
    "random": _random,
    "corners": _corners,
    "away from zero": _away,
    "toward zero": _toward,
    "up": _up,
    "down": _down,
}
"""Corners: as far as can be, to a random side for every pair and operation."""


def wrong_sides(
    score: Callable[[Arithmetic], np.ndarray], sites: int, arithmetic: Arithmetic
) -> Arithmetic:
    """The arithmetic with each result moved to the side that raises the score.

    Args:
        score: (n,) what an evaluation gives; the higher, the nearer to a false claim.
        sites: how many results can be moved.
        arithmetic: what else is done.
    """
    sides = [_rises(score, site, arithmetic) for site in range(sites)]
    return arithmetic._replace(
        move=lambda site, value: MOST_UNITS * sides[site].reshape(value.shape)
    )


def _rises(
    score: Callable[[Arithmetic], np.ndarray], moved: int, arithmetic: Arithmetic
) -> np.ndarray:
    """1 where the score rises with the result of a site, -1 where it falls."""

    def at(units: int) -> np.ndarray:
        move = lambda site, value: units if site == moved else 0  # noqa: E731
        return score(arithmetic._replace(move=move))

    return np.where(at(MOST_UNITS) >= at(-MOST_UNITS), 1, -1)


class Evaluated(NamedTuple):
    """The results, and how many quotients and roots there were to be moved."""

    results: list[np.ndarray]
    sites: int


def evaluate(
    closed: Any, arguments: Sequence[Any], arithmetic: Arithmetic
) -> Evaluated:
    """Evaluates a jaxpr (`jax.make_jaxpr`) on arrays.

    Raises:
        NotImplementedError: a primitive that this file does not know.
    """
    run = _Run(arithmetic)
    leaves = [Value(np.asarray(x)) for x in jax.tree.leaves(arguments)]
    with np.errstate(all="ignore"):
        results = run.closed(closed, leaves)
    return Evaluated([x.array for x in results], run.sites)


class _Run:
    """One evaluation."""

    def __init__(self, arithmetic: Arithmetic) -> None:
        self.arithmetic = arithmetic
        self.rng = np.random.default_rng(arithmetic.seed)
        self.sites = 0

    def closed(self, closed: Any, operands: Sequence[Value]) -> Sequence[Value]:
        return self.jaxpr(getattr(closed, "jaxpr", closed), closed, operands)

    def jaxpr(self, jaxpr: Any, closed: Any, operands: Sequence[Value]) -> list[Value]:
        constants = [Value(np.asarray(x)) for x in getattr(closed, "consts", ())]
        names = dict(zip(jaxpr.constvars, constants, strict=True))
        names.update(zip(jaxpr.invars, operands, strict=True))

        def read(x: Any) -> Value:
            if hasattr(x, "val"):
                return Value(np.asarray(x.val, x.aval.dtype))
            return names[x]

        for equation in jaxpr.eqns:
            results = self.equation(equation, [read(x) for x in equation.invars])
            names.update(zip(equation.outvars, results, strict=True))
        return [read(x) for x in jaxpr.outvars]

    def equation(self, equation: Any, operands: list[Value]) -> Sequence[Value]:
        name, params = equation.primitive.name, equation.params
        if name in COMPILER_PRIMITIVES:
            return COMPILER_PRIMITIVES[name](*operands, **params)
        if name in COMPILER_FUNCTIONS:
            arrays = [x.array for x in operands]
            inner = jax.make_jaxpr(COMPILER_FUNCTIONS[name])(*arrays)
            return self.closed(inner, operands)
        if name in CALLS:
            inner = params["call_jaxpr" if "call_jaxpr" in params else "jaxpr"]
            return self.closed(inner, operands)
        if name in SAME:
            return operands
        if name in MOVEMENTS:
            arrays = [x.array for x in operands]
            return [Value(MOVEMENTS[name](equation, *arrays))]
        if operands[0].array.dtype.kind == "f":
            return [self.floats(name, params, operands)]
        if name in OPERATIONS:
            return [Value(OPERATIONS[name](*(x.array for x in operands)))]
        raise NotImplementedError(f"the primitive {name}, of which nothing is known")

    def floats(self, name: str, params: Any, operands: list[Value]) -> Value:
        """An operation on floating-point numbers."""
        operands = [Value(self.flushed(x.array), x.factors) for x in operands]
        arrays = [x.array for x in operands]
        if name in ("add", "sub"):
            return Value(self.flushed(self.sum(name, *operands)))
        if name in ("mul", "square"):
            return self.product(arrays[0], arrays[-1])
        if name == "neg":
            factors = operands[0].factors
            return Value(-arrays[0], factors and (-factors[0], factors[1]))
        if name == "integer_pow":
            return self.power(arrays[0], params["y"])
        if name in INEXACT:
            return self.moved(INEXACT[name](*arrays))
        if name in OPERATIONS:
            return Value(self.flushed(OPERATIONS[name](*arrays)))
        raise NotImplementedError(f"the primitive {name}, of which nothing is known")

    def product(self, x: np.ndarray, y: np.ndarray) -> Value:
        return Value(self.flushed(np.multiply(x, y)), (x, y))

    def power(self, x: np.ndarray, y: int) -> Value:
        """A whole power, by repeated products."""
        ones = Value(np.ones_like(x))
        result = functools.reduce(
            lambda product, _: self.product(x, product.array), range(abs(y)), ones
        )
        return self.moved(1 / result.array) if y < 0 else result

    def sum(self, name: str, x: Value, y: Value) -> np.ndarray:
        """The sum or difference, of one rounding if it is contracted."""
        sign = -1 if name == "sub" else 1
        if x.factors and self.contracts():
            return fused_multiply_add(*x.factors, sign * y.array)
        if y.factors and self.contracts():
            return fused_multiply_add(sign * y.factors[0], y.factors[1], x.array)
        return OPERATIONS[name](x.array, y.array)

    def contracts(self) -> bool:
        """Whether the next product is, the same for all pairs."""
        fraction = self.arithmetic.contracts
        return fraction >= 1 or (fraction > 0 and self.rng.random() < fraction)

    def moved(self, x: np.ndarray) -> Value:
        """A quotient or root, off by what is chosen for this one."""
        units = self.arithmetic.move(self.sites, x)
        self.sites += 1
        return Value(self.flushed(moved(x, units)))

    def flushed(self, x: np.ndarray) -> np.ndarray:
        if not self.arithmetic.flushes or x.dtype.kind != "f":
            return x
        return x * (np.abs(x) >= np.finfo(x.dtype).tiny)


def moved(x: np.ndarray, units: Any) -> np.ndarray:
    """Floats moved away from zero by whole units in the last place.

    Zero, infinity and NaN stay; no sign changes, and nothing finite becomes infinite.
    """
    info = np.finfo(x.dtype)
    integers = x.view(f"int{info.bits}")
    largest = np.asarray(info.max).view(integers.dtype)
    sign = np.asarray(-0.0, x.dtype).view(integers.dtype)
    size = integers & ~sign
    there = np.clip(size + np.asarray(units, integers.dtype), 0, largest)
    usable = (x != 0) & np.isfinite(x)
    return np.where(usable, (there | (integers & sign)).view(x.dtype), x)


def fused_multiply_add(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """a * b + c with one rounding, or two of which the first is far finer."""
    if a.dtype == np.float32:
        return (a.astype(np.float64) * b + c).astype(np.float32)
    product, lost = _two_product(a, b)
    total = product + c
    part = total - product
    rest = (product - (total - part)) + (c - part)
    fused = total + (rest + lost)
    return np.where(np.isfinite(fused), fused, total)


def _two_product(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The float64 product, and what its rounding lost (Dekker's)."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    lost = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + (
        a_low * b_low
    )
    return product, lost


def _halves(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    high = x * (2.0**27 + 1)
    high = high - (high - x)
    return high, x - high


CALLS = {"jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "checkpoint"}
"""Primitives that evaluate a jaxpr of their own."""

SAME = {"stop_gradient", "copy", "copy_p", "optimization_barrier"}
"""Those whose results are their operands."""

INEXACT = {
    "div": np.divide,
    "sqrt": np.sqrt,
    "rsqrt": lambda x: 1 / np.sqrt(x),
}
"""What accelerators approximate, of floating-point numbers."""

OPERATIONS = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative,
    "abs": np.abs, "sign": np.sign, "floor": np.floor,
    "max": np.maximum, "min": np.minimum,
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
    "eq": np.equal, "ne": np.not_equal,
    "and": np.bitwise_and, "or": np.bitwise_or, "not": np.invert,
}  # fmt: skip


def _broadcast(equation: Any, x: np.ndarray) -> np.ndarray:
    params = equation.params
    shape = np.ones(len(params["shape"]), int)
    shape[list(params["broadcast_dimensions"])] = x.shape
    return np.broadcast_to(x.reshape(tuple(shape)), params["shape"])


def _slice(equation: Any, x: np.ndarray) -> np.ndarray:
    params = equation.params
    steps = params["strides"] or [1] * x.ndim
    bounds = zip(params["start_indices"], params["limit_indices"], steps, strict=True)
    return x[tuple(slice(*bound) for bound in bounds)]


def _select(equation: Any, which: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    if len(cases) != 2 or which.dtype != bool:
        raise NotImplementedError("a choice among more than two")
    return np.where(which, cases[1], cases[0])


def _shaped(equation: Any, x: np.ndarray) -> np.ndarray:
    return x.reshape(equation.outvars[0].aval.shape)


MOVEMENTS = {
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "select_n": _select,
    "squeeze": _shaped,
    "reshape": _shaped,
    "stack": lambda q, *x: np.stack(x, axis=q.params["axis"]),
    "expand_dims": _shaped,
    "concatenate": lambda q, *x: np.concatenate(x, axis=q.params["dimension"]),
    "bitcast_convert_type": lambda q, x: x.view(q.params["new_dtype"]),
    "convert_element_type": lambda q, x: x.astype(q.params["new_dtype"]),
}
"""What moves numbers and does not compute."""
