"""The report: a table for people, an object for machines."""

from __future__ import annotations

import dataclasses
import json
import math
import platform
from typing import Any

import jax
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

import jaxbe
from jaxbe.cli.agreement import Agreement, Conflict
from jaxbe.cli.arguments import Options
from jaxbe.cli.crosscheck import Crosscheck, Disagreement
from jaxbe.cli.sweep import Sweep
from jaxbe.viz.picture import Picture

LISTED = 10
"""How many disagreements are printed; `--json` has all."""


@dataclasses.dataclass
class Report:
    """All that is reported.

    Attributes:
        labels: a name for every geom.
        sweep: the tests on all states.
        crosscheck: the comparison with MuJoCo C.
        seconds: wall time of both.
        picture: what was drawn, if anything.
    """

    labels: list[str]
    sweep: Sweep
    crosscheck: Crosscheck
    seconds: float
    picture: Picture | None = None

    def agree(self) -> bool:
        """Whether nothing differs beyond the tolerances."""
        totals = self.sweep.totals
        within = totals.methods, totals.certificates, totals.signs
        conflicting = any(agreement.conflicting for agreement in within)
        return not (conflicting or self.crosscheck.disagreements)

    def compared(self) -> int:
        """How many pairs in states each test answered."""
        return self.sweep.totals.states * len(self.sweep.pairs.geom)

    def names(self, pair: int) -> tuple[str, str]:
        """The labels of a pair's ellipsoid and box."""
        ellipsoid, box = self.sweep.pairs.geom[pair]
        return self.labels[ellipsoid], self.labels[box]


def show(report: Report, options: Options) -> None:
    """Prints the report to standard output."""
    if options.json:
        print(json.dumps(_finite(as_object(report, options)), allow_nan=False))
        return
    console = Console(highlight=False, markup=False)
    for part in (
        *_heading(report, options),
        _pair_table(report, options.rows),
        *_pair_summary(report, options.rows),
        _method_table(report),
        *_times(report),
        *_agreement(report),
        *_deepest(report),
    ):
        console.print(part, soft_wrap=isinstance(part, str))


def as_object(report: Report, options: Options) -> dict[str, Any]:
    """The report as JSON's types."""
    totals, check = report.sweep.totals, report.crosscheck
    return {
        "versions": versions(),
        "device": device(),
        "dtype": options.dtype,
        "scene": str(options.scene),
        "qpos": None if options.qpos is None else str(options.qpos),
        "seed": options.seed,
        "states": totals.states,
        "states_overlapping": totals.states_overlapping,
        "pairs": [_pair_object(report, i) for i in range(len(report.sweep.pairs.geom))],
        "methods": {m: _method_object(report, m) for m in jaxbe.METHODS},
        "seconds": _besides(totals.seconds) | {"total": report.seconds},
        "compile_seconds": _besides(report.sweep.tests.compile_seconds),
        "between_methods": totals.methods.as_object(),
        "certificates": _verdicts(report) | totals.certificates.as_object(),
        "distance_signs": totals.signs.as_object(),
        "mujoco": check._asdict()
        | {"disagreements": [d._asdict() for d in check.disagreements]},
        "deepest": _deepest_object(report),
        "picture": None if report.picture is None else report.picture._asdict(),
        "agree": report.agree(),
    }


def _finite(value: Any) -> Any:
    """The same with null for NaN and infinity, which JSON has not."""
    if isinstance(value, dict):
        return {key: _finite(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(x) for x in value]
    is_bad = isinstance(value, float) and not math.isfinite(value)
    return None if is_bad else value


def versions() -> dict[str, str]:
    """What took part."""
    return {
        "jaxbe": jaxbe.__version__,
        "jax": jax.__version__,
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def device() -> str:
    """Where the tests ran."""
    first = jax.devices()[0]
    kind = first.device_kind
    return first.platform if kind == first.platform else f"{first.platform} ({kind})"


def _pair_object(report: Report, pair: int) -> dict[str, Any]:
    results = report.sweep.pairs
    ellipsoid, box = report.names(pair)
    return {
        "ellipsoid": ellipsoid,
        "box": box,
        "geom": results.geom[pair].tolist(),
        "overlapping": int(results.overlapping[pair]),
        "proved_overlapping": int(results.proved_overlapping[pair]),
        "proved_separated": int(results.proved_separated[pair]),
        "undecided": int(results.undecided[pair]),
        "smallest_distance": float(results.smallest_distance[pair]),
        "smallest_scaled_distance": float(results.smallest_scaled_distance[pair]),
        "smallest_margin": float(results.smallest_margin[pair]),
        "mean_margin": float(results.mean_margin()[pair]),
    }


def _verdicts(report: Report) -> dict[str, int]:
    """How many pairs in states have each certified verdict."""
    results = report.sweep.pairs
    return {
        "overlapping": int(results.proved_overlapping.sum()),
        "separated": int(results.proved_separated.sum()),
        "undecided": int(results.undecided.sum()),
    }


def _method_object(report: Report, method: str) -> dict[str, Any]:
    seconds = report.sweep.totals.seconds[method]
    return {
        "overlapping": report.sweep.totals.overlapping[method],
        "compile_seconds": report.sweep.tests.compile_seconds[method],
        "run_seconds": seconds,
        "pairs_per_second": report.compared() / seconds,
    }


def _besides(seconds: dict[str, float]) -> dict[str, float]:
    """Those that are not of a method."""
    return {name: x for name, x in seconds.items() if name not in jaxbe.METHODS}


def _deepest_object(report: Report) -> dict[str, Any]:
    deepest = report.sweep.deepest
    contact = {name: x.tolist() for name, x in deepest.contact._asdict().items()}
    return deepest._asdict() | {
        "qpos": deepest.qpos.tolist(),
        "contact": contact,
        "overlapping": np.flatnonzero(deepest.overlapping).tolist(),
    }


def _heading(report: Report, options: Options) -> list[str]:
    totals = report.sweep.totals
    source = options.qpos or f"random, seed {options.seed}"
    libraries = ", ".join(f"{name} {version}" for name, version in versions().items())
    return [
        f"{options.scene}",
        f"{len(report.sweep.pairs.geom)} box-ellipsoid pairs that may collide, "
        f"{totals.states:,} states ({source})",
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
            *report.names(pair),
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
        "",
    ]


def _method_table(report: Report) -> Table:
    table = Table("test", box=None)
    for heading in ("overlapping", "compile (s)", "run (s)", "pairs/s"):
        table.add_column(heading, justify="right")
    for method in jaxbe.METHODS:
        numbers = _method_object(report, method)
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
        f"(compile {compiled['certify']:.1f} s); {report.seconds:.1f} s in all",
        "",
    ]


def _agreement(report: Report) -> list[str]:
    totals, check = report.sweep.totals, report.crosscheck
    verdicts = _verdicts(report)
    return [
        f"certified: {verdicts['overlapping']:,} overlapping (+), "
        f"{verdicts['separated']:,} separated (-), {verdicts['undecided']:,} undecided "
        "(?) pairs in states",
        *_agreement_lines(report, "between the three tests", totals.methods),
        *_agreement_lines(report, "certificates with the tests", totals.certificates),
        *_agreement_lines(report, "distance's sign with the tests", totals.signs),
        f"with MuJoCo C: {len(check.disagreements)} disagreements on a sample of "
        f"{check.checked:,}, {check.overlapping:,} of them overlapping"
        + _within(check.differing - len(check.disagreements), "tolerance"),
        "  counted where further from touching than ccd_tolerance "
        f"({check.ccd_tolerance:.1e} m) and rounding (here at most "
        f"{check.largest_rounding:.1e} m)",
        *(_disagreement_line(report, d) for d in check.disagreements[:LISTED]),
        "",
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
    ellipsoid, box = report.names(pair)
    return f"{ellipsoid} and {box}"


def _deepest(report: Report) -> list[str]:
    deepest = report.sweep.deepest
    what = (
        "deepest overlap" if deepest.overlapping.any() else "nothing overlaps; nearest"
    )
    lines = [
        f"{what}: state {deepest.state}, {_between(report, deepest.pair)}, "
        f"distance {1000 * deepest.contact.distance:.3g} mm, "
        f"margin {deepest.margin:.3f} (0 touches, -1 is the deepest)"
    ]
    if report.picture is not None:
        why = f" ({report.picture.why})" if report.picture.why else ""
        lines += [f"drawn by {report.picture.drawn_by}{why}: {report.picture.path}"]
    return lines
