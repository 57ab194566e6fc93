"""What a pair costs by the size of the batch, on one core.

Run from the repository root:

    python -m benchmarks growth

Once with the allocator as it comes, which maps fresh memory for every large result so
that the kernel's page faults count, and once with freed memory kept for the next call.
Batches on all cores are in `benchmarks.throughput`, where small ones show what it takes
to start the threads.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import jax

from benchmarks import machine, one_core, report, throughput
from benchmarks.against_c import AS_IT_COMES, KEPT
from benchmarks.margin_speed import keep_freed_memory

SIZES = (10**4, 10**5, 10**6, 10**7)
WITHIN = 0.2
"""Of the cost at 10^6."""


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    parts = ["# The cost of a pair by the batch, on one core (float32)"]
    for name, points in numbers["passes"].items():
        parts += [f"## {name.capitalize()}", report.table(HEADER, _rows(points))]
    parts.append(
        "Change: the furthest from the cost at 10^6. Other processes kept at most "
        f"{max(p['cores_busy_with_others'] for p in _all(numbers)):.2f} cores busy."
    )
    parts.append(report.machine_lines(numbers["machine"]))
    return "\n\n".join(parts)


HEADER = ("setting", *(f"{n:,}, ns/pair" for n in SIZES), "change", "within 20 %")


def _all(numbers: dict[str, Any]) -> list[dict[str, Any]]:
    return [point for points in numbers["passes"].values() for point in points]


def _rows(points: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    return [_row(name, points) for name in dict.fromkeys(p["setting"] for p in points)]


def _row(name: str, points: list[dict[str, Any]]) -> tuple[str, ...]:
    costs = costs_of(name, points)
    change = furthest(costs)
    cells = (f"{costs[n]:,.1f}" if n in costs else "" for n in SIZES)
    return (name, *cells, f"{100 * change:.0f} %", "yes" if change <= WITHIN else "no")


def costs_of(name: str, points: list[dict[str, Any]]) -> dict[int, float]:
    """Nanoseconds a pair, by the batch."""
    mine = (p for p in points if p["setting"] == name)
    return {p["pairs"]: p["seconds"]["median"] / p["pairs"] * 1e9 for p in mine}


def furthest(costs: dict[int, float]) -> float:
    """The largest change against the cost at 10^6, or at the largest batch."""
    typical = costs.get(10**6, costs[max(costs)])
    return max(abs(cost / typical - 1) for cost in costs.values())


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="to 100,000 pairs: a look")
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    options.sizes = SIZES[:2] if options.quick else SIZES
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    if one_core.done_by_child("benchmarks.growth", arguments):
        return
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {"machine": machine.describe(), "passes": {}}
    with report.progress_bar() as progress:
        bar = progress.add_task("growth", total=2 * len(options.sizes))
        for name in (AS_IT_COMES, KEPT):
            if name == KEPT and not keep_freed_memory():
                continue
            numbers["passes"][name] = throughput.measure_growth(
                options.sizes, options.repeats, lambda: progress.advance(bar)
            )
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
