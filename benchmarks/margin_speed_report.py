"""The report of `benchmarks.margin_speed`: tables and targets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import report
from benchmarks.timing import QUIET_CORES

COMPILE_LIMITS = {"value": 3, "gradients": 5, "hessian": 15}
"""Seconds."""

TIMES_COAL = 17
OR_AT_LEAST = 8 * 0.49e6
"""Pairs a second: 8 times the C++ growth-distance library (see issue 3)."""


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    measured = numbers["float32"]
    return f"""\
# The margin's speed

Float32, {measured["pairs"]:,} pairs under vmap on arrays (N, 3) and (N, 3, 3); \
medians of {measured["repeats"]} interleaved rounds; {numbers["default_steps"]} steps \
unless said. "Gradients": in all 30 numbers. "27 candidates": plain autodiff of the \
smallest value of a competent enumeration (`benchmarks.naive`).

{_programs_table(measured)}

{_passes(measured)}

## Float64 on one core

{_one_core(numbers["one_core"])}

## Targets

{report.table(("target", "limit", "measured", ""), list(_verdicts(numbers)))}

{report.machine_lines(numbers["machine"])}"""


def _programs_table(measured: dict[str, Any]) -> str:
    rows = [
        (
            name,
            f"{facts['pairs']:,}",
            f"{facts['compile_seconds']:.2f}",
            str(facts["fusions"]),
            f"{facts['bytes_accessed_per_pair']:.0f}",
            *(_rate(p["pairs_per_second"][name]) for p in measured["passes"].values()),
        )
        for name, facts in measured["programs"].items()
    ]
    rates = (f"M pairs/s, {name}" for name in measured["passes"])
    header = ("program", "pairs", "compile, s", "fusions", "bytes/pair", *rates)
    return report.table(header, rows)


def _rate(pairs_per_second: float) -> str:
    return f"{pairs_per_second / 1e6:.3g}"


def _passes(measured: dict[str, Any]) -> str:
    """How quiet the machine was."""
    return " ".join(
        f"With {name}: other processes kept at most "
        f"{p['cores_busy_with_others']:.2f} cores busy{_warning(p)}."
        for name, p in measured["passes"].items()
    )


def _warning(measured: dict[str, Any]) -> str:
    busy = measured["cores_busy_with_others"] > QUIET_CORES
    return " (**disturbed**, run it again)" if busy else ""


def _one_core(measured: dict[str, Any]) -> str:
    rates = measured["pairs_per_second"]
    rows = [(name, _rate(rate)) for name, rate in rates.items()]
    missing = "" if "coal" in rates else "\n\ncoal is not installed: pip install coal."
    return f"""\
{measured["steps"]} steps, the fewest with all {measured["pairs"]:,} errors up to 1e-8 \
(largest: {measured["largest_error"]:.1e}), aspect ratios to 40. "coal, spheres" is \
the same Python loop over two spheres: about what the binding costs. Others kept at \
most {measured["cores_busy_with_others"]:.2f} cores busy.

{report.table(("program", "M pairs/s"), rows)}{missing}"""


def _verdicts(numbers: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for name, limit in COMPILE_LIMITS.items():
        seconds = numbers["compile_seconds"][name]
        yield _at_most(f"compile time of the {name}, s", limit, seconds)
    few = f"margin, {numbers['few_steps']} steps"
    for label, measured in numbers["float32"]["passes"].items():
        rates = measured["pairs_per_second"]
        overlap, gradients = rates["overlap"], rates["margin and gradients"]
        plain = rates["27 candidates and gradients"]
        yield _at_least(
            f"margin, times overlap ({label})", 0.2, rates["margin"] / overlap
        )
        yield _at_least(f"{few}, times overlap ({label})", 0.4, rates[few] / overlap)
        relative = rates["margin"] / gradients
        yield _at_most(f"value and gradients, times the value ({label})", 2.5, relative)
        yield _at_least(
            f"gradients, times plain autodiff ({label})", 50, gradients / plain
        )
    yield from _one_core_verdicts(numbers["one_core"]["pairs_per_second"])


def _one_core_verdicts(rates: dict[str, float]) -> Iterator[tuple[str, ...]]:
    statement = "float64, one core, M pairs/s"
    yield _at_least(statement, OR_AT_LEAST / 1e6, rates["margin"] / 1e6)
    if "coal" in rates:
        times = rates["margin"] / rates["coal"]
        yield _at_least("float64, one core, times coal", TIMES_COAL, times)


def _at_least(statement: str, limit: float, value: float) -> tuple[str, ...]:
    return _verdict(statement, f"at least {limit:g}", value, value >= limit)


def _at_most(statement: str, limit: float, value: float) -> tuple[str, ...]:
    return _verdict(statement, f"at most {limit:g}", value, value <= limit)


def _verdict(statement: str, limit: str, value: float, met: bool) -> tuple[str, ...]:
    return statement, limit, f"{value:.2f}", "met" if met else "NOT MET"
