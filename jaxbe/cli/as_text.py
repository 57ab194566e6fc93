"""The report as tables and lines, for people."""

from __future__ import annotations

import io
import sys
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import jaxbe
from jaxbe.cli.agreement import Agreement, Conflict
from jaxbe.cli.arguments import Options
from jaxbe.cli.as_object import device, method_object, verdicts, versions
from jaxbe.cli.crosscheck import Crosscheck, Disagreement
from jaxbe.cli.report import Report
from jaxbe.cli.shown import shown
from jaxbe.viz.picture import Picture

LISTED = 10
"""How many disagreements are printed; `--json` has all."""


def sweep_text(report: Report, options: Options) -> str:
    """What the tests found, as far as they got."""
    return _rendered(
        *_heading(report, options),
        _pair_table(report, options.rows),
        *_pair_summary(report, options.rows),
        *_deepest(report),
        "",
        _method_table(report),
        *_times(report),
        *_agreement(report),
    )


def crosscheck_text(report: Report) -> str:
    """What MuJoCo C says to that."""
    assert report.crosscheck is not None
    return _rendered(*_crosscheck(report, report.crosscheck))


def picture_text(drawn: Picture) -> str:
    """What was drawn, and by what."""
    why = f" ({drawn.why})" if drawn.why else ""
    return _rendered(shown(f"drawn by {drawn.drawn_by}{why}: {drawn.path}"))


def _rendered(*parts: str | Table) -> str:
    text = _ForStandardOutput()
    console = Console(file=text, highlight=False, markup=False, emoji=False)
    for part in parts:
        console.print(part, soft_wrap=isinstance(part, str))
    return text.getvalue()


class _ForStandardOutput(io.StringIO):
    """Collects text as wide and colourful as standard output is.

    By itself rich ends the process, with status 1, where nobody reads.
    """

    def isatty(self) -> bool:
        return sys.stdout is not None and sys.stdout.isatty()


def _heading(report: Report, options: Options) -> list[str]:
    totals = report.sweep.totals
    source = shown(options.qpos or f"random, seed {options.seed}")
    done = f"{totals.states:,}"
    if totals.states < report.states:
        done += f" of {report.states:,}"
    libraries = ", ".join(f"{name} {version}" for name, version in versions().items())
    return [
        shown(options.scene),
        f"{len(report.sweep.pairs.geom)} box-ellipsoid pairs that may collide, "
        f"{done} states ({source})",
        f"{options.dtype} on {device()}; {libraries}",
        "",
    ]


def _pair_table(report: Report, rows: int) -> Table:
    results, states = report.sweep.pairs, report.sweep.totals.states
    table = Table(box=None)
    for heading in ("ellipsoid", "box"):
        table.add_column(heading, overflow="fold")
    for heading in (
        "states\noverlapping",
        "certified\n+/-/?",
        "smallest\ndistance (m)",
        "smallest\nmargin",
        "mean\nmargin",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for pair in _most_overlapping(report)[:rows]:
        count = results.overlapping[pair]
        table.add_row(
            *map(shown, report.names(pair)),
            f"{count:,} ({count / states:.1%})",
            f"{results.proved_overlapping[pair]}/{results.proved_separated[pair]}/"
            f"{results.undecided[pair]}",
            f"{results.smallest_distance[pair]:.3g}",
            f"{results.smallest_margin[pair]:.3f}",
            f"{results.mean_margin()[pair]:.3f}",
        )
    return table


def _most_overlapping(report: Report) -> list[int]:
    results = report.sweep.pairs
    order = np.lexsort((results.smallest_margin, -results.overlapping))
    return [int(pair) for pair in order]


def _pair_summary(report: Report, rows: int) -> list[str]:
    hidden = _most_overlapping(report)[rows:]
    totals = report.sweep.totals
    lines = []
    if hidden:
        n = np.count_nonzero(report.sweep.pairs.overlapping[hidden])
        lines = [f"and {len(hidden)} more pairs, {n} of which overlap (see --rows)"]
    share = totals.states_overlapping / totals.states
    return [
        *lines,
        f"{totals.states_overlapping:,} of {totals.states:,} states ({share:.1%}) have "
        "a pair that overlaps",
    ]


def _method_table(report: Report) -> Table:
    table = Table("test", box=None)
    for heading in ("overlapping", "compile (s)", "run (s)", "pairs/s"):
        table.add_column(heading, justify="right")
    for method in jaxbe.METHODS:
        numbers = method_object(report, method)
        table.add_row(
            method,
            f"{numbers['overlapping']:,}",
            f"{numbers['compile_seconds']:.2f}",
            f"{numbers['run_seconds']:.3g}",
            f"{numbers['pairs_per_second'] / 1e6:.1f} M",
        )
    return table


def _times(report: Report) -> list[str]:
    totals, compiled = report.sweep.totals, report.sweep.tests.compile_seconds
    seconds = {name: f"{x:.2f} s" for name, x in totals.seconds.items()}
    return [
        f"besides: forward kinematics in C {seconds['kinematics']}, gathering "
        f"{seconds['gather']}, distances {seconds['contact']} "
        f"(compile {compiled['contact']:.1f} s), certificates {seconds['certify']} "
        f"(compile {compiled['certify']:.1f} s); {report.seconds:.1f} s so far",
        "",
    ]


def _agreement(report: Report) -> list[str]:
    totals, proved = report.sweep.totals, verdicts(report)
    return [
        f"certified: {proved['overlapping']:,} overlapping (+), "
        f"{proved['separated']:,} separated (-), {proved['undecided']:,} undecided "
        "(?) pairs in states",
        *_agreement_lines(report, "between the three tests", totals.methods),
        *_agreement_lines(report, "certificates with the tests", totals.certificates),
        *_agreement_lines(report, "distance's sign with the tests", totals.signs),
    ]


def _crosscheck(report: Report, check: Crosscheck) -> list[str]:
    return [
        f"with MuJoCo C: {len(check.disagreements)} disagreements on a sample of "
        f"{check.checked:,}, {check.overlapping:,} of them overlapping"
        + _within(check.differing - len(check.disagreements), "tolerance"),
        "  counted where further from touching than ccd_tolerance "
        f"({check.ccd_tolerance:.1e} m) and rounding (here at most "
        f"{check.largest_rounding:.1e} m)",
        *(_disagreement_line(report, d) for d in check.disagreements[:LISTED]),
    ]


def _agreement_lines(report: Report, what: str, agreement: Agreement) -> list[str]:
    return [
        f"{what}: {agreement.conflicting} disagreements on "
        f"{agreement.compared:,} pairs in states"
        + _within(agreement.differing - agreement.conflicting, "rounding"),
        *(_conflict_line(report, c) for c in agreement.conflicts[:LISTED]),
    ]


def _within(count: int, tolerance: str) -> str:
    return f" ({count:,} differ within {tolerance})" if count else ""


def _conflict_line(report: Report, conflict: Conflict) -> str:
    return (
        f"  state {conflict.state}, {_between(report, conflict.pair)}: "
        f"scaled distance {conflict.scaled_distance:.9g}, {conflict.answers}"
    )


def _disagreement_line(report: Report, item: Disagreement) -> str:
    return (
        f"  state {item.state}, {_between(report, item.pair)}: scaled distance "
        f"{item.scaled_distance:.9g} (float64 {item.scaled_distance_float64:.15g}), "
        f"MuJoCo {item.mujoco_distance:+.3e} m, tolerance {item.tolerance:.1e} m"
    )


def _between(report: Report, pair: int) -> str:
    ellipsoid, box = map(shown, report.names(pair))
    return f"{ellipsoid} and {box}"


def _deepest(report: Report) -> list[str]:
    """The state of the smallest margin, and the smallest distance if that is another.

    The margin goes by the size of the bodies: a small pair may be nearly concentric
    where a large one is deeper in metres.
    """
    deepest, distances = report.sweep.deepest, report.sweep.pairs.smallest_distance
    overlaps, own = deepest.overlapping.any(), deepest.contact.distance
    what = "deepest overlap" if overlaps else "nothing overlaps; nearest"
    lines = [
        f"{what} by margin: state {deepest.state}, {_between(report, deepest.pair)}, "
        f"distance {_millimetres(own)}, "
        f"margin {deepest.margin:.3f} (0 touches, -1 is the deepest)"
    ]
    least = int(np.argmin(distances))
    if distances[least] < own and _millimetres(distances[least]) != _millimetres(own):
        lines.append(
            f"{what} by distance: {_between(report, least)}, "
            f"distance {_millimetres(distances[least])}"
        )
    return lines


def _millimetres(distance: Any) -> str:
    return f"{1000 * float(distance):.3g} mm"
