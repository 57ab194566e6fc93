"""The table of `benchmarks.programs`: needs of a program, limits, roofline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks import report
from benchmarks.absent_device import DEVICES
from benchmarks.program_list import LIMITS, TPU_COMPILE_SECONDS

BANDWIDTH = 3.35e12
"""Bytes a second of an H100 (SXM)."""

ISSUED = {"float32": 132 * 128 * 1.755e9, "float64": 132 * 64 * 1.755e9}
"""Instructions a second: cores, lanes of the dtype in each, cycles under load."""

GPU = {
    "kernels": ("launched", ""),
    "device functions": ("functions", ","),
    "instructions/pair": ("instructions", ",.0f"),
    "registers": ("registers", ""),
    "spilled B": ("spilled", ","),
    "temporary B/pair": ("temporary", ",.0f"),
    "moved B/pair": ("moved", ",.0f"),
    "compile s": ("compile_seconds", ".1f"),
    "roofline ns/pair": ("nanoseconds", ".3f"),
    "bound by": ("bound", ""),
    "over its limit": ("over", ""),
}
"""Columns: what they show of `facts`, and how."""

TPU = {
    "fusions": ("fusions", ""),
    "temporary B/pair": ("temporary", ",.0f"),
    "operations/pair": ("operations", ",.0f"),
    "accessed B/pair": ("moved", ",.0f"),
    "compile s": ("compile_seconds", ".1f"),
    "over its limit": ("over", ""),
}

NOTES = """\
Nothing of this was run. Instructions are of PTX, each of a kernel and of the device
functions that it calls counted once, times the threads launched, by the pairs.
Registers and spilled bytes (those stored) are of the kernel that has most, as NVIDIA's
assembler says. Moved are the operands and results of every kernel in the program as
XLA optimised it, each array once and whole, as if no cache kept anything from one
kernel to the next. The roofline is the sum over kernels of the larger of moved bytes
at 3.35 TB/s and instructions at 29.7e12 a second (float64: half as many); bound by is
what takes the larger part of it. "+ N" are copies and calls of libraries, of which
nothing more is known: the other columns lack them. For a TPU operations and bytes are
XLA's own estimate. The limits are of float32; those of compile seconds of two quiet
cores and jax to 0.10, later twice as many."""


def facts(row: Mapping[str, Any], dtype: str = "float32") -> dict[str, Any]:
    """What the table shows of a program, most of it a pair."""
    pairs = row["pairs"]
    common = {
        "temporary": row["temporary_bytes"] / pairs,
        "compile_seconds": row["compile_seconds"],
    }
    if "kernels" in row:
        return common | _of_kernels(row, dtype)
    done = {"operations": row["flops"] / pairs, "moved": row["bytes"] / pairs}
    return common | done | {"fusions": row["fusions"]}


def _of_kernels(row: Mapping[str, Any], dtype: str) -> dict[str, Any]:
    kernels = [k for k in row["kernels"] if None not in k.values()]
    others = len(row["others"]) + len(row["kernels"]) - len(kernels)
    moved = [k["bytes"] for k in kernels]
    issued = [k["instructions"] * k["threads"] for k in kernels]
    seconds = [
        (b / BANDWIDTH, n / ISSUED[dtype]) for b, n in zip(moved, issued, strict=True)
    ]
    bound = sum(map(max, seconds))
    by_memory = sum(memory for memory, other in seconds if memory >= other)
    return {
        "launched": f"{len(kernels)}" + f" + {others}" * bool(others),
        "functions": row["device_functions"],
        "instructions": sum(issued) / row["pairs"],
        "registers": max((k["registers"] for k in kernels), default=0),
        "spilled": max((k["spilled"] for k in kernels), default=0),
        "moved": sum(moved) / row["pairs"],
        "nanoseconds": bound * 1e9 / row["pairs"],
        "bound": "memory" if by_memory > bound / 2 else "instructions",
    }


def exceeded(row: Mapping[str, Any], jax: str = "0.10") -> list[str]:
    """The limits that a program in float32 is over, each with what it needs instead."""
    if "kernels" not in row:
        limits = {"compile_seconds": TPU_COMPILE_SECONDS}
    elif row["program"] in LIMITS:
        limits = LIMITS[row["program"]]._asdict()
        is_late = tuple(map(int, jax.split(".")[:2])) > (0, 10)
        limits["compile_seconds"] *= 1 + is_late
    else:
        limits = {}
    found = facts(row)
    # Some bytes of the temporaries are not the pairs'.
    over = [name for name, most in limits.items() if round(found[name]) > most]
    return [f"{name.replace('_', ' ')} {found[name]:,.0f}" for name in over]


def cells(row: Mapping[str, Any], one: Mapping[str, Any]) -> dict[str, str]:
    """A program's row of a set, by column."""
    columns = columns_of(one)
    if "error" in row:
        return dict.fromkeys(columns, "") | {"over its limit": row["error"]}
    over = exceeded(row, one["jax"]) if one["dtype"] == "float32" else []
    shown = facts(row, one["dtype"]) | {"over": "; ".join(over)}
    return {name: format(shown[key], how) for name, (key, how) in columns.items()}


def columns_of(one: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Those of a set."""
    return TPU if one["device"] == "v5e" else GPU


def text(sets: Sequence[Mapping[str, Any]], receipt: str) -> str:
    """The report in Markdown.

    Args:
        sets: as `benchmarks.programs` keeps them.
        receipt: of the code as it is.
    """
    parts = ["# Programs for accelerators, compiled without them", NOTES]
    for one in sets:
        name = f"{DEVICES[one['device']]}, jax {one['jax']}, {one['dtype']}"
        rows = [(r["program"], *cells(r, one).values()) for r in one["rows"]]
        parts += [
            f"## {name}, {one['pairs']:,} pairs",
            report.table(("program", *columns_of(one)), rows),
            _about(one, receipt),
        ]
    return "\n\n".join(parts)


def _about(one: Mapping[str, Any], receipt: str) -> str:
    versions = ", ".join(f"{name} {value}" for name, value in one["versions"].items())
    others = max((r.get("cores_busy_with_others", 0) for r in one["rows"]), default=0)
    code = "the last code measured" if one["receipt"] == receipt else "an earlier code"
    return (
        f"{one['date']}, {versions}; {one['cores']} cores, at most {others:.2f} busy "
        f"with other processes; of {code} (`jaxbe/` {one['receipt']})."
    )
