"""The report of `benchmarks.placement` in Markdown, and its figure."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.placement_methods import AT_ONCE, OURS

STYLES = {
    OURS: ("#0072B2", "-"),
    f"{OURS}, {AT_ONCE} starts at once": ("#56B4E9", "-"),
    "sqrt(q) - 1, Adam": ("#CC79A7", "--"),
    "jaxbe, L-BFGS-B": ("#009E73", "-"),
    "MuJoCo, differences, L-BFGS-B": ("#D55E00", "-"),
    "MuJoCo, SciPy's differences, L-BFGS-B": ("#D55E00", ":"),
    "MuJoCo, differences, Adam": ("#E69F00", "-"),
    "MuJoCo, CMA-ES": ("#000000", "-"),
}
"""Color and line of each method."""

Runs = Sequence[Mapping[str, Any]]


def text(numbers: Mapping[str, Any]) -> str:
    """The whole report."""
    budget = numbers["budget"]
    versions = ", ".join(f"{n} {v}" for n, v in numbers["versions"].items())
    parts = [
        "# Placement by gradient beside what else there is",
        f"Same instances, same random starts in the same order, same proof of success, "
        f"{budget:g} s an instance, one core; others kept "
        f"{numbers['cores_busy_with_others']:.2f} cores busy. Versions: {versions}.",
        *(f"Left out: {name}: {why}" for name, why in numbers["failures"].items()),
        EXPLANATION,
    ]
    for name, task in numbers["tasks"].items():
        parts += [f"## {name}", setting(task), table(task, budget)]
    deep = numbers["tasks"]["shelf"]["deep"]
    parts += ["## Shelf, from the first start alone", RATES, rates(numbers, deep)]
    return "\n\n".join([*parts, report.machine_lines(numbers["machine"])])


EXPLANATION = (
    "Solved: instances proved within the time, of those run; from the first start: "
    "without going on from another random pose (or another batch of them), in brackets "
    "those with an ellipsoid's centre in a box. Clearance: the smallest signed "
    "distance at the end, by MuJoCo, median and least. Time to success: median of all "
    "instances, the proofs included, and the slowest; times: how many times that of "
    "the margin's gradient from one start, by the medians on the same instances. "
    "Prepared in: compilation by XLA, once for all instances of a size, or building "
    "MuJoCo's model, once an instance. First success: both together, as for one "
    "instance alone. The test of success is compiled before all. Differences: one call "
    "of MuJoCo moves all numbers in turn, and measures again only the ellipsoid that "
    "moves; SciPy's: it calls a loss for each number, as one does without more work."
)

RATES = (
    "Instances that Adam solves by its rate: in all, and those with the melon's centre "
    "in a box. There the gradient of sqrt(q) - 1 vanishes: what moves the melon is its "
    "neighbours, and fast steps carry it on."
)


def rates(numbers: Mapping[str, Any], deep: Sequence[bool]) -> str:
    """A row a rate."""
    names = [name for name in numbers["rates"][0] if name != "rate"]
    rows = []
    for measured in numbers["rates"]:
        cells = [f"{measured['rate']:g}"]
        for name in names:
            among = [
                ok for ok, is_deep in zip(measured[name], deep, strict=True) if is_deep
            ]
            cells += [f"{sum(measured[name])} of {len(deep)}"]
            cells += [f"{sum(among)} of {len(among)}"]
        rows.append(cells)
    columns = [f"{name}{more}" for name in names for more in ("", ", centre in a box")]
    return report.table(["rate", *columns], rows)


def setting(task: Mapping[str, Any]) -> str:
    """What the task is."""
    call = task["seconds_of_mujoco"]
    return (
        f"{task['instances']} instances, {sum(task['deep'])} with an ellipsoid's "
        f"centre in a box at first; {6 * task['ellipsoids']} variables; wanted: "
        f"margins of {task['wanted_margin']:g}, distances of "
        f"{1000 * task['wanted_clearance']:.1f} mm. All distances of the first "
        f"start by `mj_collision`: {1e6 * call['mj_collision']:.0f} us, by "
        f"`mj_geomDistance` a pair: {1e6 * call['mj_geomDistance']:.0f} us."
    )


def table(task: Mapping[str, Any], budget: float) -> str:
    """A row a method."""
    header = ["method", "solved", "from the first start", "clearance, mm"]
    header += ["time to success", "slowest", "times", "prepared in", "first success"]
    ours = task["runs"][OURS]
    rows = [
        [name, *row(runs, task["deep"], ours[: len(runs)], budget)]
        for name, runs in task["runs"].items()
    ]
    return report.table(header, rows)


def row(runs: Runs, deep: Sequence[bool], ours: Runs, budget: float) -> list[str]:
    """The cells of a method, beside the same instances by ours."""
    times = [run["solved_after"] for run in runs]
    found = [t for t in times if t is not None]
    clearance = [1000 * run["clearance"] for run in runs]
    prepared = max(run["prepared_in"] for run in runs)
    median = median_time(runs)
    whole = None if median is None else median + prepared
    return [
        f"{len(found)} of {len(times)}",
        first_starts(runs, deep),
        f"{statistics.median(clearance):.1f}, {min(clearance):.1f}",
        duration(median, budget),
        duration(max(found) if len(found) == len(times) else None, budget),
        ratio(median, median_time(ours), budget),
        duration(prepared, budget),
        duration(whole, budget),
    ]


def median_time(runs: Runs) -> float | None:
    """Seconds to success; None if fewer than half of the instances are solved."""
    times = [run["solved_after"] for run in runs]
    median = statistics.median(np.inf if t is None else t for t in times)
    return float(median) if np.isfinite(median) else None


def first_starts(runs: Runs, deep: Sequence[bool]) -> str:
    """How many need no other start; of the deep ones."""
    first = [run["from_first_start"] for run in runs]
    among = [ok for ok, is_deep in zip(first, deep, strict=False) if is_deep]
    return f"{sum(first)} of {len(first)} ({sum(among)} of {len(among)})"


def duration(seconds: float | None, budget: float) -> str:
    """With a unit."""
    if seconds is None:
        return f"none in {budget:g} s"
    return f"{seconds:.1f} s" if seconds >= 0.9995 else f"{1000 * seconds:.3g} ms"


def ratio(median: float | None, ours: float | None, budget: float) -> str:
    """How many times as long; a bound where there is no success."""
    if ours is None:
        return ""
    times = (budget if median is None else median) / ours
    digits = f"{times:.1f}" if times < 9.95 else f"{times:,.0f}"
    return f"> {digits}" if median is None else digits


def draw(numbers: Mapping[str, Any], file: Path) -> None:
    """The share of instances solved against time."""
    from matplotlib.figure import Figure

    tasks = numbers["tasks"]
    figure = Figure(figsize=(4 * len(tasks), 4.2), dpi=100, layout="constrained")
    panels = figure.subplots(1, len(tasks), sharey=True, squeeze=False)[0]
    for axes, (name, task) in zip(panels, tasks.items(), strict=True):
        for method, runs in task["runs"].items():
            color, line = STYLES[method]
            axes.step(
                *shares(runs, numbers["budget"]),
                where="post",
                label=method,
                color=color,
                ls=line,
                lw=1.8,
            )
        axes.set(xscale="log", xlabel="seconds, prepared before", title=name)
        axes.set(ylim=(0, 1.03), xlim=(None, numbers["budget"]))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("share of instances solved")
    labels = panels[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(file)


def shares(runs: Runs, budget: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and how many are solved by then."""
    found = np.sort([r["solved_after"] for r in runs if r["solved_after"] is not None])
    count = np.arange(len(found) + 1) / len(runs)
    # A step begins on the axis; a log axis has no zero.
    first = found[:1] if len(found) else np.array([budget])
    times = np.concatenate([first, found, [budget]])
    return times, np.append(count, count[-1])
