"""Speed against error: every setting a point, and those that nothing beats.

Run from the repository root, after `benchmarks.throughput` and `benchmarks.accuracy`:

    python -m benchmarks.frontier --throughput results/throughput-cpu.json \
        --accuracy results/accuracy-cpu.json --table jaxbe/frontier.json

A setting is on the front of a kind of scene and an answer if no other one is both
faster and more accurate. The table is what `jaxbe.plan` chooses from.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import frontier_report, machine, report, settings
from benchmarks.settings import Setting

SHARES = ("99", "99.9", "max")
"""The percentiles that `jaxbe.plan` knows."""

SPHERES = "spheres"
"""A kind of its own in the table: ellipsoids with equal semi-axes."""


LEFT_OUT = ("near touching",)
"""Kinds that are no scene as a whole; their errors are those of random ones."""


class Point(NamedTuple):
    """A setting on one kind of scene, for one answer.

    Attributes:
        scene: the kind.
        answer: what is judged.
        setting: its name.
        dtype: of the inputs.
        rate: pairs a second.
        error: at the 99.9th percentile; of verdicts the share of wrong ones.
        on_front: whether no other point is faster and at least as accurate.
    """

    scene: str
    answer: str
    setting: str
    dtype: str
    rate: float
    error: float
    on_front: bool = False


def points(throughput: dict[str, Any], accuracy: dict[str, Any]) -> list[Point]:
    """All settings on all kinds of scenes, with their fronts."""
    rates = rates_by_setting(throughput)
    every = [
        Point(
            e["scene"],
            e["answer"],
            e["setting"],
            e["dtype"],
            rates[e["setting"], e["dtype"]],
            error_of(e),
        )
        for e in accuracy["errors"]
    ]
    return [p._replace(on_front=not _is_beaten(p, every)) for p in every]


def rates_by_setting(throughput: dict[str, Any]) -> dict[tuple[str, str], float]:
    """Pairs a second under vmap, by setting and dtype."""
    return {
        (p["setting"], p["dtype"]): p["pairs_per_second"]
        for p in throughput["throughput"]["programs"]
        if p["layout"] == "vmap"
    }


def error_of(entry: dict[str, Any]) -> float:
    """One number for an entry of `benchmarks.accuracy`."""
    return entry["error"]["99.9"] if "error" in entry else entry["wrong_share"]


def _is_beaten(point: Point, every: Sequence[Point]) -> bool:
    rivals = (p for p in every if (p.scene, p.answer) == (point.scene, point.answer))
    return any(
        (p.rate > point.rate and p.error <= point.error)
        or (p.rate >= point.rate and p.error < point.error)
        for p in rivals
    )


def table(throughput: dict[str, Any], accuracy: dict[str, Any]) -> dict[str, Any]:
    """What `jaxbe.plan` needs: cost and errors of each setting by spread."""
    rates, judged = rates_by_setting(throughput), settings.named(settings.JUDGED)
    entries = [e for e in accuracy["errors"] if e["scene"] not in LEFT_OUT]
    rows = [
        _row(judged[name], dtype, rates[name, dtype], entries)
        for name in judged
        for dtype in settings.DTYPES
    ]
    spreads = sorted({e["spread"] for e in entries if _is_of_spread(e)})
    return {
        "command": "python -m benchmarks (see benchmarks/frontier.py)",
        "machine": machine.summary(throughput["machine"]),
        "pairs": accuracy["pairs"],
        "shares": list(SHARES),
        "spreads": spreads,
        "settings": rows,
    }


def _is_of_spread(entry: dict[str, Any]) -> bool:
    return bool(entry["scene"] != SPHERES)


def _row(
    setting: Setting, dtype: str, rate: float, errors: list[dict[str, Any]]
) -> dict[str, Any]:
    mine = [e for e in errors if (e["setting"], e["dtype"]) == (setting.name, dtype)]
    by_spread = [e for e in mine if _is_of_spread(e)]
    spheres = [e for e in mine if not _is_of_spread(e)]
    return {
        "function": setting.function,
        **setting.options,
        "gradients": setting.gradients,
        "dtype": dtype,
        "nanoseconds": float(f"{1e9 / rate:.4g}"),
        "errors": _errors_by_answer(by_spread),
        "errors_of_spheres": _errors_by_answer(spheres),
    }


def _errors_by_answer(entries: list[dict[str, Any]]) -> dict[str, Any]:
    answers = dict.fromkeys(e["answer"] for e in entries)
    return {a: _by_spread([e for e in entries if e["answer"] == a]) for a in answers}


def _by_spread(entries: list[dict[str, Any]]) -> list[list[float]]:
    """A row for each spread: the worst of all kinds up to it."""
    spreads = sorted({e["spread"] for e in entries})
    return [_worst([_errors(e) for e in entries if e["spread"] <= s]) for s in spreads]


def _errors(entry: dict[str, Any]) -> list[float]:
    """By SHARES; of verdicts the share of separated pairs that a filter keeps."""
    if "missed" in entry:
        return [entry["false_keep_share"]]
    return [entry["error"][share] for share in SHARES]


def _worst(rows: list[list[float]]) -> list[float]:
    return [float(f"{max(column):.3g}") for column in zip(*rows, strict=True)]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for name in ("throughput", "accuracy"):
        parser.add_argument(
            f"--{name}",
            type=Path,
            required=True,
            metavar="FILE",
            help=f"what benchmarks.{name} wrote with --json",
        )
    report.add_output_options(parser)
    parser.add_argument("--figures", type=Path, metavar="PREFIX", help="a PNG a kind")
    parser.add_argument("--table", type=Path, metavar="FILE", help="for jaxbe.plan")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Joins, prints, draws, writes."""
    options = parse(arguments)
    throughput, accuracy = (
        json.loads(file.read_text()) for file in (options.throughput, options.accuracy)
    )
    every = points(throughput, accuracy)
    numbers = {
        "machine": throughput["machine"],
        "pairs": accuracy["pairs"],
        "points": [p._asdict() for p in every],
    }
    report.write(options, frontier_report.text(numbers), numbers)
    if options.figures:
        frontier_report.draw(numbers, options.figures)
    if options.table:
        rows = table(throughput, accuracy)
        options.table.write_text(_compact(rows))


def _compact(rows: dict[str, Any]) -> str:
    """JSON with a line for each setting."""
    lines = ",\n  ".join(json.dumps(row) for row in rows["settings"])
    head = json.dumps({k: v for k, v in rows.items() if k != "settings"}, indent=1)
    return f'{head[:-2]},\n "settings": [\n  {lines}\n ]\n}}\n'


if __name__ == "__main__":
    main()
