"""Whether certificates prove their verdicts, checked in exact rational arithmetic.

Run from the repository root:

    python -m benchmarks.certificates

A tenth of the pairs are within 1e-6 of touching. The check (`holds`) takes the floats
at their exact values and shares no line with jaxbe.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxbe
from benchmarks import machine, report, scenes
from tests import oracle, truth

LOWS = {"to 40": 0.05, "to 1000": 0.002, "to 1e5": 2e-5}
"""The smallest length, by the largest spread; the largest is 2."""

DTYPES = ("float32", "float64")

QUICK = 200
"""Pairs of each spread and dtype for a look."""


class Judged(NamedTuple):
    """Certificates of a scene.

    Attributes:
        false: numbers of the pairs whose proof does not hold.
        verdict: (n,) 1 overlapping, -1 apart, 0 undecided.
    """

    false: list[int]
    verdict: np.ndarray

    @property
    def undecided(self) -> float:
        """The share of the pairs."""
        return float(np.mean(self.verdict == 0))


def judge(scene: scenes.Scene) -> Judged:
    """Checks every certificate of the scene."""
    certificate = jax.jit(jaxbe.certify)(*scene.bodies())
    verdict, point, direction = (np.asarray(x) for x in certificate)
    decided = np.flatnonzero(verdict)
    proofs = ((i, verdict[i], point[i], direction[i]) for i in decided)
    false = [int(i) for i, *proof in proofs if not holds(truth.exact(scene, i), *proof)]
    return Judged(false, verdict)


def holds(
    pair: oracle.ExactPair, verdict: int, point: np.ndarray, direction: np.ndarray
) -> bool:
    """Whether the proof holds for the very floats of the pair.

    Args:
        pair: the exact values.
        verdict: 1 or -1.
        point: (3,) proves an overlap: the box's frame, within it and the ellipsoid.
        direction: (3,) proves separation: both bodies' extents along it leave a gap.
    """
    if verdict == 1:
        return _is_in_both(pair, [Fraction(float(x)) for x in point])
    return _separates(pair, [Fraction(float(x)) for x in direction])


def _is_in_both(pair: oracle.ExactPair, x: list[Fraction]) -> bool:
    if any(abs(v) > e for v, e in zip(x, pair.e, strict=True)):
        return False
    w = [
        c + v - k
        for c, v, k in zip(pair.C, oracle.apply(pair.U, x), pair.K, strict=True)
    ]
    y = oracle.apply(oracle.inverse(pair.V), w)
    return sum((v / a) ** 2 for v, a in zip(y, pair.a, strict=True)) <= 1


def _separates(pair: oracle.ExactPair, w: list[Fraction]) -> bool:
    across = [k - c for k, c in zip(pair.K, pair.C, strict=True)]
    gap = sum(p * q for p, q in zip(w, across, strict=True))
    on_box = oracle.apply(oracle.transpose(pair.U), w)
    gap -= sum(e * abs(v) for e, v in zip(pair.e, on_box, strict=True))
    on_ellipsoid = oracle.apply(oracle.transpose(pair.V), w)
    square = sum((a * v) ** 2 for a, v in zip(pair.a, on_ellipsoid, strict=True))
    return gap > 0 and gap * gap > square


def mixed(pairs: int, low: float, seed: int) -> scenes.Scene:
    """Random pairs, a tenth of them within 1e-6 of touching."""
    scene = scenes.random(pairs, seed=seed, low=low)
    near = pairs // 10
    close = scenes.near_touching(scene.part(slice(near)), growth=1e-6)
    parts = zip(close, scene, strict=True)
    return scenes.Scene(*(np.concatenate([c, x[near:]]) for c, x in parts))


def measure(pairs: int, seed: int, tick: Callable[[], Any]) -> Iterator[dict[str, Any]]:
    """One row a spread and dtype."""
    for spread, low in LOWS.items():
        scene = mixed(pairs, low, seed)
        for dtype in DTYPES:
            judged = judge(scene.astype(dtype))
            yield {
                "spread": spread,
                "dtype": dtype,
                "pairs": pairs,
                "false": len(judged.false),
                "undecided": int(np.sum(judged.verdict == 0)),
            }
            tick()


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    rows = numbers["rows"]
    cells = [
        [
            row["spread"],
            row["dtype"],
            f"{row['pairs']:,}",
            str(row["false"]),
            f"{row['undecided']:,}",
            f"{100 * row['undecided'] / row['pairs']:.3g}",
        ]
        for row in rows
    ]
    header = ["spread", "dtype", "pairs", "false", "undecided", "undecided, %"]
    return f"""\
# Certificates

{sum(row["pairs"] for row in rows):,} pairs (seed {numbers["seed"]}), a tenth of them \
within 1e-6 of touching. "False": a proof that does not hold for the very floats \
given, in exact rational arithmetic.

{report.table(header, cells)}

{report.machine_lines(numbers["machine"])}"""


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=34_000, help="of each row")
    parser.add_argument("--seed", type=int, default=82)
    parser.add_argument("--quick", action="store_true", help="few pairs")
    report.add_output_options(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Judges, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    pairs = QUICK if options.quick else options.pairs
    with report.progress_bar() as progress:
        task = progress.add_task("judging", total=len(LOWS) * len(DTYPES))
        rows = list(measure(pairs, options.seed, lambda: progress.advance(task)))
    numbers = {"seed": options.seed, "machine": machine.describe(), "rows": rows}
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
