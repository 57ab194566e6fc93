"""The report of `benchmarks.extremes`: tables, and what explains the cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from benchmarks import report

CLEAN = 10.0
"""Errors over conditioning up to this are clean."""

FIELDS = (
    "box.center",
    "box.axes",
    "box.half_extents",
    "ellipsoid.center",
    "ellipsoid.axes",
    "ellipsoid.semi_axes",
)
ROTATED = {"box.axes", "ellipsoid.axes", "ellipsoid.semi_axes"}


class Cell(NamedTuple):
    """One row, dtype, aspect ratio and distance: the worst over all sizes.

    Attributes:
        ratio: the largest error over conditioning.
        beyond: pairs above CLEAN.
        lost: answers that are not finite; of `overlap`, wrong verdicts.
        fields: of gradients, the fields of the bodies with a ratio above CLEAN.
        more_steps: the ratio at more steps, where there are steps.
        direction: of gradients, the largest error of the derivatives in the ellipsoid's
            centre, relative to their size.
    """

    row: str
    dtype: str
    aspect: float
    distance: str
    ratio: float
    beyond: int
    lost: int
    fields: tuple[str, ...]
    more_steps: float | None
    direction: float

    @property
    def is_clean(self) -> bool:
        """No loss beyond CLEAN and nothing missing."""
        return self.ratio <= CLEAN and (self.row == "overlap" or not self.lost)


class Reason(NamedTuple):
    """Why cells are not clean: those that meet the rule, and no rule before it."""

    text: str
    holds: Callable[[Cell], bool]


REASONS = (
    Reason(
        "**Stopping early.** With more steps (10 of the margin, 8 of the distance) the "
        "cell is clean: the iteration has not ended, nothing is lost to rounding.",
        lambda c: c.more_steps is not None and c.more_steps <= CLEAN and not c.lost,
    ),
    Reason(
        "**A single derivative, in axes or semi-axes, of the distance.** The direction "
        "is right (the derivatives in the centres are clean); the touching point is "
        "computed from it, along the long axes of the ellipsoid as a_p^2 (v_p.n) / s, "
        "in which v_p.n cancels where rods cross. `margin` and `scaled_distance` take "
        "the point from their kernel instead; the descents of the distance have none.",
        lambda c: (
            c.row == "signed_distance, gradient"
            and not c.lost
            and set(c.fields) <= ROTATED
        ),
    ),
    Reason(
        "**Derivatives in the semi-axes of a thin plate.** The length of n, of which "
        "the scale of the derivative is made, is the plate's stiffness 1/a^2 times a "
        "residual of about a: to eps times the aspect ratio, of which the true answer "
        "knows nothing. The other derivatives are clean.",
        lambda c: (
            c.row == "margin, gradient"
            and not c.lost
            and set(c.fields) <= {"ellipsoid.semi_axes"}
        ),
    ),
    Reason(
        "**Directions to the square root of rounding.** The value is stationary in the "
        "direction: what turns it by sqrt(eps) leaves no trace in the value, and a "
        "search that ends when the value no longer improves cannot tell.",
        lambda c: (
            "gradient" in c.row
            and not c.lost
            and c.direction <= (2.4e-7 if c.dtype == "float64" else 5.5e-3)
        ),
    ),
    Reason(
        "**Residuals below the spacing of floats.** In float32 at aspect ratios from "
        "1e5 on, the nearest point of the box is so near to the plane of a thin plate "
        "that its distance, some a_min, is not a difference of floats of its size: the "
        "margin is right, but its gradient may be that of a neighbouring contact "
        "(vertex, edge), and longer by the aspect ratio.",
        lambda c: (
            c.row == "margin, gradient"
            and c.dtype != "float64"
            and c.aspect >= 1e5
            and not c.lost
        ),
    ),
    Reason(
        "**Bodies thinner than the rounding of the pair.** The depth is searched to 4 "
        "eps of the pair's size, which is what it keeps (see `signed_distance`); of "
        "bodies thinner than about that the inputs say more.",
        lambda c: (
            c.row == "signed_distance"
            and c.dtype != "float64"
            and c.aspect >= 1e5
            and not c.lost
        ),
    ),
)
"""In this order. What meets none is listed as unexplained."""


def maps(entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The entries as cells, worst over sizes, and as a map over sizes."""
    dtypes, aspects, rows = (_distinct(entries, k) for k in ("dtype", "aspect", "row"))
    sizes = sorted(_distinct(entries, "size"))
    at_default = [e for e in entries if "steps" not in e]
    more = {_place(e): e["ratio"] for e in entries if "steps" in e}
    grouped: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for e in at_default:
        grouped.setdefault(_place(e), []).append(e)
    cells = [_cell(same, more.get(place)) for place, same in grouped.items()]
    by_size = {
        dtype: [
            [
                max(
                    e["ratio"]
                    for e in at_default
                    if (e["dtype"], e["aspect"], e["size"]) == (dtype, aspect, size)
                    and "fields" not in e
                )
                for size in sizes
            ]
            for aspect in aspects
        ]
        for dtype in dtypes
    }
    differ = sum(
        len({(e["ratio"], e["lost"]) for e in g}) > 1 for g in grouped.values()
    )
    return {
        "dtypes": dtypes,
        "aspects": aspects,
        "rows": rows,
        "sizes": sizes,
        "cells": [_compact(c) for c in cells],
        "cells_that_differ_by_size": differ,
        "worst_by_size": by_size,
    }


def _place(e: dict[str, Any]) -> tuple[Any, ...]:
    return e["row"], e["dtype"], e["aspect"], e["distance"]


def _cell(same: Sequence[dict[str, Any]], more_steps: float | None) -> Cell:
    worst = max(same, key=lambda e: e["ratio"])
    fields = zip(FIELDS, worst.get("fields", [0] * 6), strict=True)
    return Cell(
        *_place(worst),
        worst["ratio"],
        worst["beyond"],
        max(e["lost"] for e in same),
        tuple(name for name, ratio in fields if ratio > CLEAN),
        more_steps,
        max(e.get("direction", 0.0) for e in same),
    )


def _compact(cell: Cell) -> str:
    """One line a cell: JSON with a line for each of its numbers would be long."""
    more = "" if cell.more_steps is None else f"{cell.more_steps:g}"
    fields = "+".join(cell.fields)
    return (
        f"{cell.row}|{cell.dtype}|{cell.aspect:g}|{cell.distance}|{cell.ratio:g}|"
        f"{cell.beyond}|{cell.lost}|{fields}|{more}|{cell.direction:g}"
    )


def cells(numbers: dict[str, Any]) -> list[Cell]:
    """The cells of a file."""
    return list(map(_read, numbers["cells"]))


def _read(line: str) -> Cell:
    row, dtype, aspect, distance, ratio, beyond, lost, *rest = line.split("|")
    fields, more, direction = rest
    return Cell(
        row,
        dtype,
        float(aspect),
        distance,
        float(ratio),
        int(beyond),
        int(lost),
        tuple(filter(None, fields.split("+"))),
        float(more) if more else None,
        float(direction),
    )


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    every = cells(numbers)
    unclean = [c for c in every if not c.is_clean]
    exponents = ", ".join(map(str, numbers["sizes"]))
    return f"""\
# The extremes

Largest error over conditioning: by how much the true answer changes when each of \
the 30 numbers given is moved by half a unit of rounding, added up, plus half a unit \
of the answer. {numbers["pairs"]} pairs in each cell of aspect ratio (of both \
bodies, of the ellipsoid, or of the box), distance (coincident centres; deep: growth \
distance 0.01 to 0.9; touching: within a rounding to 0.1 of growth distance 1; gaps \
in the longest length) and size (2^m metres, m = {exponents}). The truth is in \
numpy's extended precision, verdicts in exact arithmetic. Inputs in bfloat16 are \
computed in float32, and judged as float32. Gradients: all 30 derivatives, the worst \
field of the bodies; those of the signed distance of pairs apart. The depth of pairs \
that overlap is judged along the direction found.

"Clean": at most {CLEAN:g}. {len(every) - len(unclean):,} of {len(every):,} cells are; \
{numbers["cells_that_differ_by_size"]} of {len(every):,} depend on the size at all.

{_summary(every)}

## Wrong verdicts

{_verdicts(every)}

## Cells that are not clean

"In the centres": the largest error of the derivatives in the ellipsoid's centre, \
relative to their size.

{_explanations(unclean)}

{_worst(unclean)}

{report.machine_lines(numbers["machine"])}"""


def _summary(every: Sequence[Cell]) -> str:
    header = ("function", "dtype", "cells", "not clean", "pairs", "worst", "median")
    keys = list(dict.fromkeys((c.row, c.dtype) for c in every))
    lines = []
    for key in keys:
        of = [c for c in every if (c.row, c.dtype) == key]
        ratios = sorted(c.ratio for c in of)
        lines.append(
            (
                *key,
                str(len(of)),
                str(sum(not c.is_clean for c in of)),
                str(sum(c.beyond for c in of)),
                f"{ratios[-1]:.2g}",
                f"{ratios[len(ratios) // 2]:.2g}",
            )
        )
    note = (
        '"Pairs": those above the limit, in all cells; "worst" and "median": of the '
        "cells' largest ratios. No answer and no derivative is NaN or infinite"
    )
    lost = sum(c.lost for c in every if c.row != "overlap")
    note += "." if not lost else f" but for {lost}."
    return f"{report.table(header, lines)}\n\n{note}"


def _verdicts(every: Sequence[Cell]) -> str:
    wrong = [c for c in every if c.row == "overlap" and c.lost]
    if not wrong:
        return "None, by any of the three methods."
    worst = max(c.ratio for c in wrong)
    places = ", ".join(f"{c.dtype} {c.aspect:g} {c.distance} ({c.lost})" for c in wrong)
    return (
        "Largest |sqrt(q) - 1| of a wrong verdict over the conditioning of sqrt(q), "
        f"by any of the three methods: {worst:.2g}. Up to 1 the rounding of the inputs "
        f"decides. In the cells: {places}."
    )


def explained(unclean: Sequence[Cell]) -> Iterator[tuple[str, list[Cell]]]:
    """The cells of each reason; those of none last."""
    rest = list(unclean)
    for reason in REASONS:
        met = [c for c in rest if reason.holds(c)]
        rest = [c for c in rest if not reason.holds(c)]
        yield reason.text, met
    yield "**Isolated pairs, not explained.**", rest


def _explanations(unclean: Sequence[Cell]) -> str:
    parts = []
    for words, met in explained(unclean):
        if met:
            rows = ", ".join(dict.fromkeys(c.row for c in met))
            worst = max(c.ratio for c in met)
            pairs = sum(c.beyond for c in met)
            part = (
                f"- {words} {len(met)} cells ({rows}), {pairs} pairs, aspect ratios "
                f"from {min(c.aspect for c in met):g}, worst {worst:.2g}."
            )
            if "gradient" in rows:
                part += f" In the centres: {_directions(met)}."
            parts.append(part)
    return "\n".join(parts) or "None."


def _directions(met: Sequence[Cell]) -> str:
    """The largest relative errors of the derivatives in the centres, by dtype."""
    dtypes = dict.fromkeys(c.dtype for c in met)
    return ", ".join(
        f"{dtype} {max(c.direction for c in met if c.dtype == dtype):.1g}"
        for dtype in dtypes
    )


def _worst(unclean: Sequence[Cell]) -> str:
    """The ten worst cells of each function and dtype."""
    header = ("function", "dtype", "aspect", "distance", "ratio", "pairs", "in", "more")
    chosen: dict[tuple[str, str], list[Cell]] = {}
    for c in sorted(unclean, key=lambda c: -c.ratio):
        of = chosen.setdefault((c.row, c.dtype), [])
        if len(of) < 4:
            of.append(c)
    lines = [
        (
            c.row,
            c.dtype,
            f"{c.aspect:g}",
            c.distance,
            f"{c.ratio:.2g}",
            str(c.beyond),
            "all" if len(c.fields) == 6 else ", ".join(c.fields) or "value",
            "" if c.more_steps is None else f"{c.more_steps:.2g}",
        )
        for of in chosen.values()
        for c in of
    ]
    if not lines:
        return ""
    table = report.table(header, lines)
    return f"The four worst cells of each; `more`: at more steps.\n\n{table}"


def _distinct(entries: Sequence[dict[str, Any]], key: str) -> list[Any]:
    return list(dict.fromkeys(e[key] for e in entries))
