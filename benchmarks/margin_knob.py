"""The margin's knob: what each step buys, by scene kind and float type.

Run from the repository root:

    python -m benchmarks.margin_knob

Errors are relative to max(1, growth distance), against `margin_scenes.truth` of the
same (rounded) numbers; a share of these is compared with the bisection of
`benchmarks.reference`.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks import (
    machine,
    margin_knob_report,
    margin_scenes,
    reference,
    report,
    scenes,
    timing,
)
from jaxbe.growth import MAX_STEPS

DTYPES = ("float32", "float64")
STEPS = range(MAX_STEPS + 1)
PERCENTILES = {"50": 50, "99": 99, "99.9": 99.9, "max": 100}
TOUCHING = 1e-9
"""Pairs whose true margin is within this of zero have no verdict to get wrong."""


def measure_errors(
    pairs: int, seed: int, checked: int, tick: Callable[[], Any]
) -> list[dict[str, Any]]:
    """Errors and false verdicts of every scene kind, dtype and count of steps."""
    entries = []
    for kind, scene in margin_scenes.KINDS.items():
        exact = scene(pairs, seed)
        for dtype in DTYPES:
            typed = exact.astype(dtype)
            truth = margin_scenes.truth(typed)
            labels = {
                "scene": kind,
                "dtype": dtype,
                "reference_differs": reference_error(typed, truth, checked),
            }
            entries += [labels | _errors(typed, truth, steps) for steps in STEPS]
            tick()
    return entries


def reference_error(pairs: scenes.Scene, truth: np.ndarray, checked: int) -> float:
    """The largest relative difference from bisection, on the first pairs."""
    growth = reference.growth_by_bisection(pairs.part(slice(checked)))
    return float(np.max(abs(truth[:checked] + 1 - growth) / np.maximum(1, growth)))


def _errors(pairs: scenes.Scene, truth: np.ndarray, steps: int) -> dict[str, Any]:
    found = margin_scenes.margin(pairs, steps).astype(np.float64)
    error = abs(found - truth) / np.maximum(1, truth + 1)
    separated, overlapping = truth > TOUCHING, truth < -TOUCHING
    return {
        "steps": steps,
        "error": {
            name: float(np.percentile(error, p)) for name, p in PERCENTILES.items()
        },
        "false_overlap": float(np.mean(found[separated] <= 0)),
        "false_separated": float(np.mean(found[overlapping] > 0)),
        "largest_false_margin": float(np.max(found[overlapping], initial=-1)),
    }


def measure_rates(
    pairs: int, repeats: int, tick: Callable[[], Any]
) -> list[dict[str, Any]]:
    """Pairs a second by dtype and count of steps: no branches, so of any scene."""
    random = scenes.random(pairs)
    tasks = {
        (dtype, steps): timing.Task(
            functools.partial(
                margin_scenes.compiled(steps), *random.astype(dtype).bodies()
            )
        )
        for dtype in DTYPES
        for steps in STEPS
    }
    keyed = {f"{dtype} {steps}": task for (dtype, steps), task in tasks.items()}
    measured = timing.interleaved(keyed, repeats, tick)
    return [
        {
            "dtype": dtype,
            "steps": steps,
            "pairs_per_second": pairs / measured.times[f"{dtype} {steps}"].median,
            "cores_busy_with_others": measured.others,
        }
        for dtype, steps in tasks
    ]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1_000_000, help="of each kind")
    parser.add_argument("--checked", type=int, default=5000, metavar="PAIRS")
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument("--seed", type=int, default=0)
    report.add_output_options(parser)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the table")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {
        "machine": machine.describe(),
        "pairs": options.pairs,
        "seed": options.seed,
        "checked": options.checked,
    }
    with report.progress_bar() as progress:
        bar = progress.add_task("rates", total=options.repeats)
        numbers["rates"] = measure_rates(
            options.pairs, options.repeats, lambda: progress.advance(bar)
        )
        total = len(margin_scenes.KINDS) * len(DTYPES)
        bar = progress.add_task("errors", total=total)
        numbers["errors"] = measure_errors(
            options.pairs,
            options.seed,
            options.checked,
            lambda: progress.advance(bar),
        )
    report.write(options, margin_knob_report.text(numbers), numbers)
    if options.figure:
        margin_knob_report.draw(numbers, options.figure)


if __name__ == "__main__":
    main()
