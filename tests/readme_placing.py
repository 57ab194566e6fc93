"""The README's table of placement, and how its results file gives it.

As `tests.readme_claims`; `python -m tests.readme_figures` compares.
"""

from __future__ import annotations

from typing import Any

from benchmarks import placement_report
from tests.readme_figures import Claims, of

PLACED_BY = (
    "jaxbe, Adam",
    "sqrt(q) - 1, Adam",
    "MuJoCo, differences, L-BFGS-B",
    "MuJoCo, SciPy's differences, L-BFGS-B",
    "MuJoCo, CMA-ES",
)


@of("placement")
def placement(results: dict[str, Any]) -> Claims:
    tasks, budget = results["tasks"], results["budget"]
    for name in PLACED_BY:
        rows = [
            placement_report.row(
                task["runs"][name], task["deep"], task["runs"][PLACED_BY[0]], budget
            )
            for task in tasks.values()
        ]
        cells = [row[i] for row in rows for i in (0, 2, 3)]
        yield f"| {name} | " + " | ".join(["{}"] * len(cells)) + " |", *cells
    compiled = [
        run["prepared_in"]
        for task in tasks.values()
        for name in task["runs"]
        if name.startswith(("jaxbe", "sqrt"))
        for run in task["runs"][name]
        if run["prepared_in"] > 1
    ]
    yield (
        "(XLA compiles for {} to {} s, once a size)",
        f"{min(compiled):.0f}",
        f"{max(compiled):.0f}",
    )
    times = {
        name: [_times_slower(tasks[kind], name) for kind in ("20 fruit", "60 fruit")]
        for name in PLACED_BY
    }
    _, _, differences, *black_boxes = times.values()
    by_black_box = [x for found in black_boxes for x in found]
    yield (
        "by the margin's gradient is {} to {} times as fast as by a black box",
        f"{min(by_black_box):.0f}",
        f"{max(by_black_box):.0f}",
    )
    yield (
        "and {} to {} times as fast as by differences that measure again",
        f"{min(differences):.0f}",
        f"{max(differences):.0f}",
    )
    slow = results["rates"][0]
    deep = tasks["shelf"]["deep"]
    freed = [
        str(sum(ok and inside for ok, inside in zip(slow[room], deep, strict=True)))
        for room in ("sqrt(q) - 1", "margin")
    ]
    yield (
        "at a rate of {} it frees {} of {} melons from their first start, the margin "
        "{}.",
        f"{slow['rate']:g}",
        freed[0],
        str(sum(deep)),
        freed[1],
    )


def _times_slower(task: dict[str, Any], name: str) -> float:
    """Than by the margin's gradient, on the instances that both had."""
    runs = task["runs"][name]
    ours = task["runs"][PLACED_BY[0]][: len(runs)]
    return placement_report.median_time(runs) / placement_report.median_time(ours)
