"""One-sidedness: how far above zero can the margin of an overlapping pair be?

Run from the repository root:

    python -m benchmarks.one_sided

In exact arithmetic never: each count of steps gives a lower bound. In float32
rounding adds a little, and a filter that keeps every pair with a margin up to
`jaxbe.margin.rounding_slack` never drops an overlapping one. Measured on
near-touching pairs: growth distances 1 +- 10^x, x uniform in [-8, -3]. The truth is
that of the same rounded numbers, in more than float64 (`margin_scenes.truth`); pairs
closer than 1e-9 to touching are counted apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import machine, margin_scenes, report, scenes
from jaxbe.growth import MAX_STEPS
from jaxbe.margin import rounding_slack

TOUCHING = 1e-9
DISTANCES = (-8, -3)
"""Powers of ten between which the pairs' distances from touching lie."""

CHUNK = 200_000
DTYPE = np.dtype(np.float32)


class Band(NamedTuple):
    """Ellipsoids of aspect ratios up to `aspect`, the longest semi-axis up to 2."""

    name: str
    aspect: float

    def scene(self, n: int, seed: int) -> scenes.Scene:
        """Near-touching pairs in float32."""
        pairs = scenes.random(n, seed, low=2 / self.aspect, high=2)
        rng = np.random.default_rng(seed)
        distance = rng.choice([-1, 1], n) * 10 ** rng.uniform(*DISTANCES, n)
        return margin_scenes.near_touching(pairs, 1 + distance).astype(DTYPE)


BANDS = (Band("to 40", 40), Band("to 1000", 1e3), Band("to 1e5", 1e5))


def measure(band: Band, pairs: int, seed: int, tick: Callable[[], Any]) -> Any:
    """The counts and maxima of a band, by steps."""
    parts = []
    for start in range(0, pairs, CHUNK):
        n = min(CHUNK, pairs - start)
        parts.append(_measure_chunk(band.scene(n, seed + start)))
        tick()
    return {"band": band.name} | _merged(parts)


def _measure_chunk(pairs: scenes.Scene) -> dict[str, Any]:
    truth = margin_scenes.truth(pairs)
    overlapping, separated = truth < -TOUCHING, truth > TOUCHING
    spread = pairs.astype(np.float64).spread
    slack = np.array([rounding_slack(DTYPE, x) for x in spread])
    roundings = {"aspect": pairs.aspect.astype(np.float64), "spread": spread}
    units = {name: np.finfo(DTYPE).eps * x for name, x in roundings.items()}
    units["slack"] = slack
    return {
        "count": {
            "touching": int(np.sum(~overlapping & ~separated)),
            "overlapping": int(np.sum(overlapping)),
            "separated": int(np.sum(separated)),
        },
        "steps": [
            _by_steps(margin_scenes.margin(pairs, steps), truth, units)
            for steps in range(MAX_STEPS + 1)
        ],
    }


def _by_steps(
    found: np.ndarray, truth: np.ndarray, units: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Counts; and the largest margins of overlapping pairs, in several units."""
    overlapping, separated = truth < -TOUCHING, truth > TOUCHING
    found = found.astype(np.float64)
    within_slack, excess = found <= units["slack"], found[overlapping]
    relative = {name: excess / unit[overlapping] for name, unit in units.items()}
    return {
        "count": {
            "false_separated": int(np.sum(excess > 0)),
            "dropped": int(np.sum(overlapping & ~within_slack)),
            "extra": int(np.sum(separated & within_slack)),
            "extra_without_slack": int(np.sum(found[separated] <= 0)),
        },
        "largest": {
            name: float(np.max(x, initial=-1))
            for name, x in ({"margin": excess} | relative).items()
        },
    }


def _merged(parts: Sequence[Any]) -> dict[str, Any]:
    """The sums of all "count" and the maxima of all "largest"."""
    merged: dict[str, Any] = {}
    for key, first in parts[0].items():
        values = [part[key] for part in parts]
        if key == "steps":
            merged[key] = [_merged(row) for row in zip(*values, strict=True)]
        else:
            combine = sum if key == "count" else max
            merged[key] = {q: combine(v[q] for v in values) for q in first}
    return merged


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    header = (
        *("aspect", "steps", "largest margin", "/ (eps aspect)", "/ (eps spread)"),
        "/ slack",
        *("margin > 0", "dropped", "extra, %", "extra without slack, %"),
    )
    rows = [row for band in numbers["bands"] for row in _rows(band)]
    return f"""\
# One-sidedness near touching

{numbers["pairs"]:,} float32 pairs (seed {numbers["seed"]}) with growth distances \
1 +- 10^{DISTANCES[0]} to 10^{DISTANCES[1]}; {_count(numbers, "overlapping"):,} \
overlap, {_count(numbers, "separated"):,} are apart, {_count(numbers, "touching"):,} \
more are closer than {TOUCHING:g} to touching. "Largest": over the pairs that truly \
overlap; negative would mean that no margin was above zero. "Aspect": of the \
ellipsoid; "spread": the longest of all six lengths over the shortest semi-axis, \
which is what rounding_slack means by aspect ratio. "Dropped": overlapping \
with a margin above rounding_slack. "Extra": separated pairs that a filter keeps, of \
these nearly touching ones.

{report.table(header, rows)}

{report.machine_lines(numbers["machine"])}"""


def _count(numbers: dict[str, Any], what: str) -> int:
    return sum(band["count"][what] for band in numbers["bands"])


def _rows(band: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    separated = max(1, band["count"]["separated"])
    for steps, found in enumerate(band["steps"]):
        count, largest = found["count"], found["largest"]
        yield (
            band["band"],
            str(steps),
            f"{largest['margin']:.1e}",
            *(f"{largest[unit]:.2f}" for unit in ("aspect", "spread", "slack")),
            f"{count['false_separated']:,}",
            f"{count['dropped']:,}",
            f"{100 * count['extra'] / separated:.2f}",
            f"{100 * count['extra_without_slack'] / separated:.2f}",
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {
        "machine": machine.describe(),
        "pairs": options.pairs,
        "seed": options.seed,
    }
    each = -(-options.pairs // len(BANDS))
    with report.progress_bar() as progress:
        bar = progress.add_task("pairs", total=len(BANDS) * -(-each // CHUNK))
        numbers["bands"] = [
            measure(band, each, options.seed, lambda: progress.advance(bar))
            for band in BANDS
        ]
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
