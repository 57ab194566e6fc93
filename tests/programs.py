"""What a compiled function is made of: its jaxpr and its HLO, read as data."""

from __future__ import annotations

import re
from collections.abc import Iterator

import jax

FORBIDDEN = {
    "cond", "while", "scan", "switch", "pure_callback", "io_callback",
    "debug_callback", "custom_call", "infeed", "outfeed", "sort", "dot_general",
}  # fmt: skip
"""Branches, loops, host calls; and products that could run on TF32 units."""

FORBIDDEN_HLO = (" while(", " conditional(", " custom-call(", " dot(", " sort(")


def primitives(function, *args) -> set[str]:
    """Names of all primitives in the jaxpr, those of inner jaxprs included."""
    return set(_names(jax.make_jaxpr(function)(*args).jaxpr))


def _names(jaxpr) -> Iterator[str]:
    for equation in jaxpr.eqns:
        yield equation.primitive.name
        for value in equation.params.values():
            for inner in value if isinstance(value, tuple | list) else (value,):
                if hasattr(inner, "jaxpr"):
                    yield from _names(inner.jaxpr)
                elif hasattr(inner, "eqns"):
                    yield from _names(inner)


def check_branch_free(function, *args) -> None:
    """No branch, loop, host call or matrix product, traced or compiled."""
    assert not primitives(function, *args) & FORBIDDEN
    text = jax.jit(function).lower(*args).compile().as_text()
    assert not [word for word in FORBIDDEN_HLO if word in text]


def fusions(function, *args) -> int:
    """How many fused loops the compiled program runs."""
    return jax.jit(function).lower(*args).compile().as_text().count(" fusion(")


def bytes_accessed(function, *args) -> float:
    """Bytes that the compiled program reads and writes."""
    analysis = jax.jit(function).lower(*args).compile().cost_analysis()
    return analysis["bytes accessed"]


def largest_expression(function, *args) -> int:
    """Operations in the largest fused loop of the compiled program."""
    text = jax.jit(function).lower(*args).compile().as_text()
    bodies = re.findall(r"^%fused_computation[^\n]*\{\n(.*?)^\}", text, re.S | re.M)
    return max(len(body.splitlines()) for body in bodies)
