"""The figure of `benchmarks.extremes`: a heat map for each function and dtype."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.extremes_report import CLEAN, Cell, cells
from benchmarks.extremes_scenes import DISTANCES

INK = "#444444"


def draw(numbers: dict[str, Any], file: Path) -> None:
    """Aspect ratio against distance for each function, against size for the worst."""
    # Here, so that the tables do not need matplotlib.
    from matplotlib.figure import Figure

    rows, dtypes = numbers["rows"], numbers["dtypes"]
    height = 1.75 * (len(rows) + 1) + 1
    figure = Figure(figsize=(4.6 * len(dtypes) + 1, height), layout="constrained")
    panels = figure.subplots(len(rows) + 1, len(dtypes), squeeze=False)
    every = {(c.row, c.dtype, c.aspect, c.distance): c for c in cells(numbers)}
    for line, row in zip(panels, rows, strict=False):
        for axes, dtype in zip(line, dtypes, strict=True):
            image = _draw_row(axes, every, row, dtype, numbers["aspects"])
            axes.set_title(f"{row}, {dtype}", fontsize=8, color=INK)
    for axes, dtype in zip(panels[-1], dtypes, strict=True):
        _draw_sizes(axes, numbers, dtype)
        axes.set_title(
            f"worst verdict or value, {dtype}, by size", fontsize=8, color=INK
        )
    bar = figure.colorbar(image, ax=panels, shrink=0.3, aspect=30, extend="both")
    bar.set_label(f"error / conditioning (clean up to {CLEAN:g})", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    figure.suptitle(
        "Largest error over what rounding the inputs must lose. Numbers: above "
        f"{CLEAN:g}; w: wrong verdicts; NaN: not finite",
        fontsize=9,
        color=INK,
    )
    figure.savefig(file, dpi=110)


def _draw_row(
    axes: Any, every: dict[Any, Cell], row: str, dtype: str, aspects: Sequence[float]
) -> Any:
    distances = list(map(str, DISTANCES))
    table = [[every[row, dtype, a, d] for d in distances] for a in aspects]
    image = _image(axes, [[c.ratio for c in line] for line in table], aspects)
    for y, line in enumerate(table):
        for x, cell in enumerate(line):
            mark = _number(cell.ratio)
            if cell.lost:
                mark = f"{cell.lost} w" if row == "overlap" else "NaN"
            _mark(axes, x, y, mark, cell.ratio)
    names = [_gap(d) for d in distances]
    axes.set_xticks(range(len(names)), names, fontsize=6)
    return image


def _draw_sizes(axes: Any, numbers: dict[str, Any], dtype: str) -> None:
    table = numbers["worst_by_size"][dtype]
    _image(axes, table, numbers["aspects"])
    for y, line in enumerate(table):
        for x, ratio in enumerate(line):
            _mark(axes, x, y, _number(ratio), ratio)
    names = [f"{2.0**m:.0e} m" for m in numbers["sizes"]]
    axes.set_xticks(range(len(names)), names, fontsize=6)


def _image(
    axes: Any, table: Sequence[Sequence[float]], aspects: Sequence[float]
) -> Any:
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    # Clean cells green, the others from yellow to red.
    shades = (0, "#F4FAF4"), (0.25, "#A9D6B4"), (0.251, "#FDE8A8"), (0.5, "#F28E2B")
    colors = LinearSegmentedColormap.from_list("clean", [*shades, (1, "#8B0000")])
    floor = [[max(ratio, 0.1) for ratio in line] for line in table]
    image = axes.imshow(
        floor, norm=LogNorm(0.1, 1e7), cmap=colors, aspect="auto", origin="lower"
    )
    names = [f"{a:.0e}".replace("e+0", "e") for a in aspects]
    axes.set_yticks(range(len(aspects)), names, fontsize=6)
    axes.set_ylabel("aspect ratio", fontsize=6)
    axes.tick_params(length=0)
    return image


def _number(ratio: float) -> str:
    if ratio <= CLEAN:
        return ""
    return f"{ratio:.0f}" if ratio < 1000 else f"{ratio:.0e}".replace("e+0", "e")


def _mark(axes: Any, x: int, y: int, words: str, ratio: float) -> None:
    color = "white" if ratio > 1e4 else "black"
    axes.text(x, y, words, ha="center", va="center", fontsize=5.5, color=color)


def _gap(distance: str) -> str:
    try:
        return f"{float(distance):g}"
    except ValueError:
        return distance
