"""The report of `benchmarks.frontier`: the fronts as a table and as figures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks import report, settings

FLOOR = {"verdict": 1e-6}
"""Where the figures draw a zero."""

LOWEST = 1e-17

PANELS = {
    settings.VERDICT: "share of wrong verdicts (at the bottom: none)",
    settings.MARGIN: "error of the margin",
    settings.MARGIN_GRADIENT: "error of the margin's gradient",
    settings.DEPTH: "error of the depth, overlapping",
    settings.DISTANCE: "error of the distance, apart",
    settings.DISTANCE_GRADIENT: "error of the distance's gradient, apart",
}
"""Panels of a figure, and what their upright axes say."""

# Okabe and Ito's palette, told apart by every eye.
COLORS = {
    "overlap": "#0072B2",
    "certify": "#000000",
    "margin": "#E69F00",
    "signed_distance": "#009E73",
    "lower_bound": "#CC79A7",
}
INK = "#444444"


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    kinds = list(dict.fromkeys(p["scene"] for p in numbers["points"]))
    tables = "\n\n".join(_section(numbers["points"], kind) for kind in kinds)
    return f"""\
# The frontier: speed against error

For each kind of scene and each answer the settings that no other one beats in both \
speed (`benchmarks.throughput`, under vmap) and error at the 99.9th percentile of \
{numbers["pairs"]:,} pairs (`benchmarks.accuracy`; of verdicts the share of wrong \
ones: false overlaps unless the setting is an exact test).

{tables}

{report.machine_lines(numbers["machine"])}"""


def _section(points: list[dict[str, Any]], kind: str) -> str:
    rows = [
        (
            p["answer"],
            p["setting"],
            p["dtype"],
            f"{p['rate'] / 1e6:.1f}",
            f"{p['error']:.1e}" if p["error"] else "0",
        )
        for p in _by_answer(points, kind)
        if p["on_front"]
    ]
    header = ("answer", "setting", "dtype", "M pairs/s", "error")
    return f"## {kind.capitalize()}\n\n{report.table(header, rows)}"


def _by_answer(points: list[dict[str, Any]], kind: str) -> Iterator[dict[str, Any]]:
    """By answer, the fastest first."""
    mine = [p for p in points if p["scene"] == kind]
    order = {answer: i for i, answer in enumerate(settings.ANSWERS)}
    yield from sorted(mine, key=lambda p: (order[p["answer"]], -p["rate"]))


def draw(numbers: dict[str, Any], prefix: Path) -> list[Path]:
    """One figure for each kind of scene: PREFIX-KIND.png."""
    kinds = dict.fromkeys(p["scene"] for p in numbers["points"])
    return [_draw_kind(numbers, kind, prefix) for kind in kinds]


def _draw_kind(numbers: dict[str, Any], kind: str, prefix: Path) -> Path:
    # Here, so that the tables do not need matplotlib.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 9), layout="constrained")
    points = [p for p in numbers["points"] if p["scene"] == kind]
    panels = figure.subplots(2, 3).ravel()
    for axes, (answer, label) in zip(panels, PANELS.items(), strict=True):
        _draw_panel(axes, [p for p in points if p["answer"] == answer], label)
    _draw_legend(figure)
    machine = numbers["machine"]
    figure.suptitle(
        f"Speed against error: {kind}, {numbers['pairs']:,} pairs; "
        f"{machine['processor']}, {machine['cores']} cores, jax {machine['jax']}",
        fontsize=11,
        color=INK,
    )
    name = kind.replace(" ", "-").replace("^", "")
    file = prefix.with_name(f"{prefix.name}-{name}.png")
    figure.savefig(file, dpi=130)
    return file


def _draw_panel(axes: Any, points: list[dict[str, Any]], label: str) -> None:
    for p in points:
        _draw_point(axes, p)
    _draw_front(axes, points)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("million pairs a second")
    axes.set_ylabel(f"{label}, 99.9 %" if "wrong" not in label else label)
    axes.grid(color="#e4e4e4", lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _position(p: dict[str, Any]) -> tuple[float, float]:
    return p["rate"] / 1e6, max(p["error"], FLOOR.get(p["answer"], LOWEST))


def _draw_point(axes: Any, p: dict[str, Any]) -> None:
    color = COLORS[_function(p)]
    face = color if p["dtype"] == "float32" else "white"
    size = 6.5 if p["on_front"] else 4
    axes.plot(*_position(p), "o", ms=size, mec=color, mfc=face, zorder=3)
    axes.annotate(
        _short(p),
        _position(p),
        (4, 4),
        textcoords="offset points",
        fontsize=7,
        color=INK,
        alpha=1 if p["on_front"] else 0.6,
    )


def _draw_front(axes: Any, points: list[dict[str, Any]]) -> None:
    """Stairs: what can be had at least as accurately."""
    front = sorted(_position(p) for p in points if p["on_front"])
    axes.step(*zip(*front, strict=True), where="pre", color=INK, lw=1, alpha=0.5)


def _function(p: dict[str, Any]) -> str:
    return str(p["setting"].partition(",")[0].removesuffix(" and gradients"))


def _short(p: dict[str, Any]) -> str:
    """The count of steps, or a method; "" for a function that has neither."""
    option = str(p["setting"].partition(", ")[2])
    return option.partition(" ")[0].removesuffix("_features")


def _draw_legend(figure: Any) -> None:
    """Functions by colour, float types by filling."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], marker="o", ls="", color=color, label=name)
        for name, color in COLORS.items()
    ]
    handles += [
        Line2D([], [], marker="o", ls="", mec=INK, mfc=face, label=name)
        for name, face in (("float32", INK), ("float64", "white"))
    ]
    handles.append(Line2D([], [], color=INK, lw=1, label="nothing is better"))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=len(handles),
        frameon=False,
        fontsize=9,
    )
