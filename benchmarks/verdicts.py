"""How near to touching a verdict must be before rounding can make it wrong.

For each kind of scene, dtype and method: the largest |sqrt(q) - 1| of a pair with a
wrong verdict. The truth is exact, on the very floats given (`tests.truth`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import machine, report, scenes
from tests import truth

ASPECTS = {"40": 0.05, "1000": 0.002}
"""Aspect ratios to so much, by the smallest length; the largest is 2."""

Kind = Callable[[scenes.Scene], scenes.Scene]

KINDS: dict[str, tuple[float, Kind]] = {
    "random": (1.0, lambda s: s),
    "near touching (1e-9)": (0.1, scenes.near_touching),
    "near touching (1e-6)": (0.1, lambda s: scenes.near_touching(s, growth=1e-6)),
    "near touching (1e-4)": (0.1, lambda s: scenes.near_touching(s, growth=1e-4)),
    "plates, near": (
        0.02,
        lambda s: scenes.near_touching(scenes.flattened(s, 1), growth=1e-6),
    ),
    "points, near": (
        0.02,
        lambda s: scenes.near_touching(scenes.flattened(s, 3), growth=1e-6),
    ),
    "spheres, near": (
        0.02,
        lambda s: scenes.near_touching(scenes.spheres(s), growth=1e-6),
    ),
    "axis-aligned, near": (
        0.02,
        lambda s: scenes.near_touching(scenes.axis_aligned(s), growth=1e-6),
    ),
    "1e-15 m, near": (
        0.02,
        lambda s: scenes.scaled(scenes.near_touching(s, growth=1e-6), 1e-15),
    ),
    "1e15 m, near": (
        0.02,
        lambda s: scenes.scaled(scenes.near_touching(s, growth=1e-6), 1e15),
    ),
}
"""Each kind: its share of --pairs, and how it is made from random pairs."""


def measure(pairs: int, tick: Callable[[], Any]) -> Iterator[dict[str, Any]]:
    """One row a kind, aspect ratio and dtype."""
    for aspect, low in ASPECTS.items():
        for kind, (share, make) in KINDS.items():
            scene = make(scenes.random(max(1, int(pairs * share)), low=low))
            for dtype in ("float32", "float64"):
                yield row(scene.astype(dtype), kind, aspect, dtype)
                tick()


def row(scene: scenes.Scene, kind: str, aspect: str, dtype: str) -> dict[str, Any]:
    """Judges the three methods on one scene."""
    true = truth.overlaps(scene)
    bodies = scene.bodies()
    numbers: dict[str, Any] = {
        "scene": kind,
        "aspect": aspect,
        "dtype": dtype,
        "pairs": scene.size,
        "overlapping": float(true.mean()),
    }
    for method in jaxbe.METHODS:
        verdicts = np.asarray(_test(method)(*bodies))
        numbers[method] = {
            "wrong": int((verdicts != true).sum()),
            "furthest": truth.worst_wrong(scene, true, verdicts),
        }
    return numbers


def _test(method: str) -> Callable[..., jax.Array]:
    return jax.jit(lambda box, ellipsoid: jaxbe.overlap(box, ellipsoid, method=method))


def text(rows: Sequence[dict[str, Any]], hardware: dict[str, Any]) -> str:
    """The report in Markdown."""
    cells = [
        [
            r["scene"],
            r["aspect"],
            r["dtype"],
            f"{r['pairs']:,}",
            f"{100 * r['overlapping']:.0f}",
            *(_cell(r[method]) for method in jaxbe.METHODS),
        ]
        for r in rows
    ]
    header = ["scene", "aspect to", "dtype", "pairs", "overlap, %", *jaxbe.METHODS]
    return f"""\
# Wrong verdicts

The largest |sqrt(q) - 1| of a pair with a wrong verdict, and how many there are; "0":
none at all. The truth is exact, on the very floats given. "Near": moved along the line
of centres to a growth distance within so much (else 1e-6) of 1, before rounding.

{report.table(header, cells)}

{report.machine_lines(hardware)}"""


def _cell(result: dict[str, Any]) -> str:
    if not result["wrong"]:
        return "0"
    return f"{result['furthest']:.1e} ({result['wrong']:,})"


def main(arguments: Sequence[str] | None = None) -> None:
    """Judges, prints, writes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1_000_000)
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    hardware = machine.describe()
    with report.progress_bar() as progress:
        task = progress.add_task("judging", total=2 * len(ASPECTS) * len(KINDS))
        rows = list(measure(options.pairs, lambda: progress.advance(task)))
    numbers = {"machine": hardware, "rows": rows}
    report.write(options, text(rows, hardware), numbers)


if __name__ == "__main__":
    main()
