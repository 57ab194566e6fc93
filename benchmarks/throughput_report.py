"""The report of `benchmarks.throughput`: two tables, the targets and a figure."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import report
from benchmarks.timing import QUIET_CORES

FLOAT32_PAIR_BYTES = 120


class Target(NamedTuple):
    """A lower limit for one number of Closest-Features in float32."""

    statement: str
    layout: str
    quantity: str
    at_least: float


TARGETS = (
    Target("under vmap, times the naive enumeration", "vmap", "times_naive", 4),
    Target("under vmap, share of the copy's bandwidth", "vmap", "share_of_copy", 0.25),
    Target(
        "components, share of the copy's bandwidth", "components", "share_of_copy", 0.5
    ),
)

# Okabe and Ito's palette, told apart by every eye.
COLORS = {
    "closest_features": "#0072B2",
    "all_features": "#E69F00",
    "minkowski": "#009E73",
    "naive": "#999999",
}
INK = "#444444"


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    measured = numbers["throughput"]
    copies = " and ".join(
        f"{name}'s copy {rate / 1e9:.1f} GB/s"
        for name, rate in measured["copy_bandwidth"].items()
    )
    return f"""\
# Throughput

{measured["pairs"]:,} pairs, medians of {measured["repeats"]} interleaved runs (the \
quietest of {measured["rounds"]}; other processes kept at most \
{measured["cores_busy_with_others"]:.2f} cores busy). \
Measured beside them: {copies} (bytes read plus written). "Share" is the bandwidth \
of reading 30 numbers a pair over that of {measured["yardstick"]}'s copy. Layouts: \
"vmap" over arrays (N, 3) and (N, 3, 3); "components" (3, N) and (3, 3, N), turned \
inside jit. "Wrong": verdicts that differ from a float64 enumeration in numpy. \
"Bytes" and "fusions": what XLA says of the compiled program.
{_warning(measured["cores_busy_with_others"])}
{_throughput_table(measured["programs"])}

## Growth with the batch (float32, vmap, one call at a time)

{_growth_table(numbers["growth"])}

Other processes kept at most {_growth_load(numbers["growth"]):.2f} cores busy.
{_warning(_growth_load(numbers["growth"]))}
## Targets (closest_features, float32)

{report.table(("target", "at least", "measured", ""), list(_verdicts(measured)))}

{report.machine_lines(numbers["machine"])}"""


def _warning(cores: float) -> str:
    """Said plainly if the machine was never quiet: the copy needs one core only."""
    if cores <= QUIET_CORES:
        return ""
    return "\n**Disturbed:** other processes took cores from the tests; run it again.\n"


def _throughput_table(programs: list[dict[str, Any]]) -> str:
    header = (
        *("test", "dtype", "layout", "M pairs/s", "share", "x naive", "compile, s"),
        *("bytes/pair", "fusions", "wrong"),
    )
    return report.table(header, [_throughput_row(p) for p in programs])


def _throughput_row(p: dict[str, Any]) -> tuple[str, ...]:
    return (
        p["test"],
        p["dtype"],
        p["layout"],
        f"{p['pairs_per_second'] / 1e6:.1f}",
        f"{p['share_of_copy']:.2f}",
        f"{p['times_naive']:.1f}",
        f"{p['compile_seconds']:.2f}",
        f"{p['bytes_accessed_per_pair']:.0f}",
        str(p["fusions"]),
        str(p["wrong_verdicts"]),
    )


def _growth_table(points: list[dict[str, Any]]) -> str:
    tests = list(dict.fromkeys(p["test"] for p in points))
    header = (
        "pairs",
        *(f"{test}{unit}" for test in tests for unit in ("", ", ns/pair")),
    )
    rows = []
    for n in dict.fromkeys(p["pairs"] for p in points):
        times = [p["seconds"]["median"] for p in points if p["pairs"] == n]
        cells = [(_duration(t), f"{t / n * 1e9:,.1f}") for t in times]
        rows.append((f"{n:,}", *(cell for pair in cells for cell in pair)))
    return report.table(header, rows)


def _growth_load(points: list[dict[str, Any]]) -> float:
    return max(p["cores_busy_with_others"] for p in points)


def _duration(seconds: float) -> str:
    if seconds < 1e-3:
        return f"{seconds * 1e6:.0f} us"
    return f"{seconds * 1e3:.{0 if seconds >= 0.1 else 1}f} ms"


def _verdicts(measured: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for target in TARGETS:
        entry = _entry(measured, "closest_features", "float32", target.layout)
        value = entry[target.quantity]
        verdict = "met" if value >= target.at_least else "NOT MET"
        yield target.statement, f"{target.at_least:g}", f"{value:.2f}", verdict


def _entry(measured: dict[str, Any], *labels: str) -> dict[str, Any]:
    return next(
        p
        for p in measured["programs"]
        if (p["test"], p["dtype"], p["layout"]) == labels
    )


def draw(numbers: dict[str, Any], file: Path) -> None:
    """Draws both tables side by side."""
    # Here, so that the tables do not need matplotlib.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    _draw_throughput(left, numbers["throughput"])
    _draw_growth(right, numbers)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    machine = numbers["machine"]
    figure.supxlabel(
        f"{machine['device']} ({machine['processor']}, {machine['cores']} cores), "
        f"jax {machine['jax']}",
        fontsize=8,
        color=INK,
    )
    figure.savefig(file, dpi=160)


def _draw_throughput(axes: Any, measured: dict[str, Any]) -> None:
    """One bar a program, each with the copy's limit for its dtype."""
    limit = measured["copy_bandwidth"][measured["yardstick"]]
    programs = measured["programs"]
    for y, p in enumerate(programs):
        _draw_bar(axes, y, p, limit)
    labels = [f"{p['test']}, {p['dtype']}, {p['layout']}" for p in programs]
    axes.set_yticks(range(len(programs)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.set_xlabel("million pairs a second (share of the copy's bandwidth)")
    axes.set_title(
        f"{measured['pairs']:,} pairs (dotted: read at the copy's bandwidth)",
        fontsize=10,
    )


def _draw_bar(axes: Any, y: int, p: dict[str, Any], limit: float) -> None:
    rate = p["pairs_per_second"] / 1e6
    axes.barh(y, rate, 0.72, color=COLORS[p["test"]])
    pair_bytes = FLOAT32_PAIR_BYTES * (2 if p["dtype"] == "float64" else 1)
    axes.plot([limit / pair_bytes / 1e6] * 2, [y - 0.5, y + 0.5], "k:", lw=1.2)
    axes.annotate(
        f"{rate:.0f}  ({p['share_of_copy']:.0%})",
        (rate, y),
        (4, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
        color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        zorder=5,
    )


def _draw_growth(axes: Any, numbers: dict[str, Any]) -> None:
    """Nanoseconds a pair over the batch, down to the copy's limit."""
    points = numbers["growth"]
    for test in dict.fromkeys(p["test"] for p in points):
        mine = [p for p in points if p["test"] == test]
        n = [p["pairs"] for p in mine]
        ns = [p["seconds"]["median"] / p["pairs"] * 1e9 for p in mine]
        axes.loglog(n, ns, "o-", ms=4, color=COLORS[test], label=test)
    measured = numbers["throughput"]
    limit = measured["copy_bandwidth"][measured["yardstick"]]
    axes.axhline(
        FLOAT32_PAIR_BYTES / limit * 1e9,
        color="black",
        lw=1.2,
        ls=":",
        label="reading 120 bytes a pair at the copy's bandwidth",
    )
    axes.set_ylim(bottom=FLOAT32_PAIR_BYTES / limit * 1e9 / 2)
    axes.set_xlabel("pairs in the batch")
    axes.set_ylabel("nanoseconds a pair")
    axes.set_title("one call under vmap, float32", fontsize=10)
    axes.grid(color="#dddddd", lw=0.6)
    axes.legend(frameon=False, fontsize=8)
