"""The report of `benchmarks.throughput`: tables, the targets and a figure."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import report, settings
from benchmarks.timing import QUIET_CORES

FLOAT32_PAIR_BYTES = 120


BATCHES = (10_000, 100_000, 1_000_000, 10_000_000)
"""Between these the cost of a pair should be constant."""

TYPICAL = 1_000_000

TEMPORARY_BYTES = 100
"""A float32 pair should need less beside inputs and outputs."""


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

CLOSEST = "overlap, closest_features"

# Okabe and Ito's palette, told apart by every eye.
COLORS = {
    "overlap": "#0072B2",
    "margin": "#E69F00",
    "margin and gradients": "#D55E00",
    "signed_distance": "#009E73",
    "signed_distance and gradients": "#56B4E9",
    "contact": "#CC79A7",
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
Measured beside them: {copies} (bytes read plus written). "Share": of that of \
{measured["yardstick"]}'s copy, 30 numbers read a pair and the results written. \
Layouts: "vmap" over arrays (N, 3) and (N, 3, 3); "components" (3, N) and (3, 3, N), \
turned inside jit. "Wrong": verdicts that differ from a float64 enumeration in numpy. \
"Bytes" (moved, and kept beside inputs and outputs), "operations" and "fusions": what \
XLA says of the compiled program, for one pair.
{_warning(measured["cores_busy_with_others"])}
{_throughput_table(measured["programs"])}

## Growth with the batch (float32, vmap, one call at a time)

{_growth_table(numbers["growth"])}

Other processes kept at most {_growth_load(numbers["growth"]):.2f} cores busy.
{_warning(_growth_load(numbers["growth"]))}
## Targets (float32)

{report.table(("target", "limit", "measured", ""), list(_verdicts(numbers)))}

{report.machine_lines(numbers["machine"])}"""


def _warning(cores: float) -> str:
    """Said plainly if the machine was never quiet: the copy needs one core only."""
    if cores <= QUIET_CORES:
        return ""
    return "\n**Disturbed:** other processes took cores from the tests; run it again.\n"


def _throughput_table(programs: list[dict[str, Any]]) -> str:
    header = (
        *("setting", "dtype", "layout", "M pairs/s", "share", "x naive"),
        *("trace, s", "compile, s", "bytes moved", "kept", "operations", "fusions"),
        "wrong",
    )
    return report.table(header, [_throughput_row(p) for p in programs])


def _throughput_row(p: dict[str, Any]) -> tuple[str, ...]:
    return (
        p["setting"],
        p["dtype"],
        p["layout"],
        f"{p['pairs_per_second'] / 1e6:.1f}",
        f"{p['share_of_copy']:.2f}",
        f"{p['times_naive']:.2g}",
        f"{p['trace_seconds']:.2f}",
        f"{p['compile_seconds']:.2f}",
        f"{p['bytes_accessed_per_pair']:.0f}",
        f"{p['temporary_bytes_per_pair']:.0f}",
        f"{p['operations_per_pair']:.0f}",
        str(p["fusions"]),
        str(p.get("wrong_verdicts", "")),
    )


def _growth_table(points: list[dict[str, Any]]) -> str:
    names = list(dict.fromkeys(p["setting"] for p in points))
    header = (
        "pairs",
        *(f"{name}{unit}" for name in names for unit in ("", ", ns/pair")),
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


def _verdicts(numbers: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    measured = numbers["throughput"]
    for target in TARGETS:
        value = _entry(measured, CLOSEST, "float32", target.layout)[target.quantity]
        statement = f"closest_features {target.statement}"
        met = value >= target.at_least
        yield _verdict(statement, f"at least {target.at_least:g}", f"{value:.2f}", met)
    yield from _memory_verdicts(measured["programs"])
    yield from _growth_verdicts(numbers["growth"])


def _memory_verdicts(programs: list[dict[str, Any]]) -> Iterator[tuple[str, ...]]:
    ours = [p for p in programs if p["dtype"] == "float32" and p["setting"] != "naive"]
    worst = max(ours, key=lambda p: p["temporary_bytes_per_pair"])
    value = worst["temporary_bytes_per_pair"]
    yield _verdict(
        f"bytes a pair beside inputs and outputs, the most ({worst['setting']})",
        f"below {TEMPORARY_BYTES}",
        f"{value:.0f}",
        value < TEMPORARY_BYTES,
    )


def _growth_verdicts(points: list[dict[str, Any]]) -> Iterator[tuple[str, ...]]:
    for name in dict.fromkeys(p["setting"] for p in points):
        costs = {
            p["pairs"]: p["seconds"]["median"] / p["pairs"]
            for p in points
            if p["setting"] == name and p["pairs"] in BATCHES
        }
        if len(costs) < len(BATCHES):
            continue
        change = max(abs(cost / costs[TYPICAL] - 1) for cost in costs.values())
        yield _verdict(
            f"{name}: cost of a pair from 10^4 to 10^7, against that at 10^6",
            "within 20 %",
            f"{100 * change:.0f} %",
            change <= 0.2,
        )


def _verdict(statement: str, limit: str, value: str, met: bool) -> tuple[str, ...]:
    return statement, limit, value, "met" if met else "NOT MET"


def _entry(measured: dict[str, Any], *labels: str) -> dict[str, Any]:
    return next(
        p
        for p in measured["programs"]
        if (p["setting"], p["dtype"], p["layout"]) == labels
    )


def _color(name: str) -> str:
    return COLORS.get(name.partition(",")[0], "#444444")


def draw(numbers: dict[str, Any], file: Path) -> None:
    """Draws both tables side by side."""
    # Here, so that the tables do not need matplotlib.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 6), layout="constrained")
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
    """One bar a default setting and layout, each with the copy's limit."""
    limit = measured["copy_bandwidth"][measured["yardstick"]]
    defaults = {s.name for s in settings.SETTINGS if s.is_default}
    programs = [
        p
        for p in measured["programs"]
        if p["dtype"] == "float32"
        and (p["setting"] in defaults | {"naive"} or p["setting"].startswith("overlap"))
    ]
    for y, p in enumerate(programs):
        _draw_bar(axes, y, p, limit)
    labels = [f"{p['setting']}, {p['layout']}" for p in programs]
    axes.set_yticks(range(len(programs)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.set_xlabel("million float32 pairs a second (share of the copy's bandwidth)")
    axes.set_title(
        f"{measured['pairs']:,} pairs (dotted: moved at the copy's bandwidth)",
        fontsize=10,
    )


def _draw_bar(axes: Any, y: int, p: dict[str, Any], limit: float) -> None:
    rate = p["pairs_per_second"] / 1e6
    axes.barh(y, rate, 0.72, color=_color(p["setting"]))
    pair_bytes = p["read_and_written_per_pair"]
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
    for name in dict.fromkeys(p["setting"] for p in points):
        mine = [p for p in points if p["setting"] == name]
        n = [p["pairs"] for p in mine]
        ns = [p["seconds"]["median"] / p["pairs"] * 1e9 for p in mine]
        axes.loglog(n, ns, "o-", ms=4, color=_color(name), label=name)
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
