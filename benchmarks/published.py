"""How often the paper's three tests are wrong, beside jaxbe's, by aspect ratio.

Run from the repository root:

    python -m benchmarks.published

The published tests are those of `benchmarks.paper`: slips of the pen fixed, the
mathematics as printed. The truth is `benchmarks.reference`. Everything is float64.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import machine, paper, reference, report, scenes

TOUCHING = 1e-9
"""Pairs whose sqrt(q) differs from 1 by no more are left out: rounding decides."""

BANDS = ((1, 2), (2, 10), (10, 40), (40, np.inf))
"""Ranges of the ellipsoid's aspect ratio, its largest over its smallest semi-axis."""

CHUNK = 50_000

Test = Callable[[scenes.Scene], np.ndarray]


def _published(test: Callable[..., np.ndarray], **options: Any) -> Test:
    return lambda pairs: test(*paper.bodies(pairs), **options)


def _corrected(method: str) -> Test:
    compiled = jax.jit(functools.partial(jaxbe.overlap, method=method))
    return lambda pairs: np.asarray(compiled(*pairs.bodies()))


TESTS: dict[str, Test] = {
    "All-Features, published": _published(paper.all_features),
    "Closest-Features, published": _published(paper.closest_features),
    "Minkowski, published": _published(paper.minkowski),
    "Minkowski, published, cylinders fixed": _published(
        paper.minkowski, fix_cylinders=True
    ),
    **{f"jaxbe {method}": _corrected(method) for method in jaxbe.METHODS},
}


def count(pairs: scenes.Scene) -> dict[str, Any]:
    """Counts right and wrong verdicts.

    Returns:
        `left_out`, and `bands`: for "all" and each band of aspect ratios the
        numbers of separated and overlapping pairs and, by test, of false
        positives and false negatives.
    """
    q = reference.scaled_distance(pairs)
    decided = np.abs(q - 1) > TOUCHING
    pairs, overlapping = pairs.part(decided), q[decided] <= 1
    verdicts = {name: test(pairs) for name, test in TESTS.items()}
    bands = {
        name: _count_band(overlapping[at], {t: v[at] for t, v in verdicts.items()})
        for name, at in _bands(pairs)
    }
    return {"left_out": int(np.sum(~decided)), "bands": bands}


def _bands(pairs: scenes.Scene) -> Iterator[tuple[str, np.ndarray]]:
    aspect = pairs.a.max(axis=1) / pairs.a.min(axis=1)
    yield "all", np.full(len(aspect), True)
    for low, high in BANDS:
        name = f"{low}-{high}" if np.isfinite(high) else f"{low}+"
        yield name, (low <= aspect) & (aspect < high)


def _count_band(
    overlapping: np.ndarray, verdicts: dict[str, np.ndarray]
) -> dict[str, Any]:
    return {
        "separated": int(np.sum(~overlapping)),
        "overlapping": int(np.sum(overlapping)),
        "false_positives": {
            t: int(np.sum(v & ~overlapping)) for t, v in verdicts.items()
        },
        "false_negatives": {
            t: int(np.sum(~v & overlapping)) for t, v in verdicts.items()
        },
    }


def count_in_chunks(pairs: scenes.Scene, tick: Callable[[], Any]) -> dict[str, Any]:
    """`count`, in parts that fit into memory."""
    parts = []
    for start in range(0, pairs.size, CHUNK):
        parts.append(count(pairs.part(slice(start, start + CHUNK))))
        tick()
    return _total(parts)


def _total(parts: Sequence[Any]) -> Any:
    """The sum of nested dictionaries of numbers, in their order."""
    if isinstance(parts[0], dict):
        return {key: _total([part[key] for part in parts]) for key in parts[0]}
    return sum(parts)


def rates_table(counts: dict[str, Any]) -> str:
    """False positives in % of separated, false negatives in % of overlapping pairs."""
    bands = {
        name: band
        for name, band in counts["bands"].items()
        if band["separated"] + band["overlapping"] > 0
    }
    pairs = [
        f"{band['separated']:,} / {band['overlapping']:,}" for band in bands.values()
    ]
    rows = [[test, *(_rates(band, test) for band in bands.values())] for test in TESTS]
    header = ["false positives / false negatives, %", *bands]
    return report.table(header, [["(separated / overlapping pairs)", *pairs], *rows])


def _rates(band: dict[str, Any], test: str) -> str:
    positive = _percent(band["false_positives"][test], band["separated"])
    negative = _percent(band["false_negatives"][test], band["overlapping"])
    return f"{positive} / {negative}"


def _percent(part: int, whole: int) -> str:
    """One decimal; "0" means none at all, "-" that there was nothing to get wrong."""
    if whole == 0:
        return "-"
    return f"{100 * part / whole:.1f}" if part else "0"


def text(counts: dict[str, Any], seed: int, hardware: dict[str, Any]) -> str:
    """The report in Markdown."""
    everything = counts["bands"]["all"]
    n = everything["separated"] + everything["overlapping"]
    overlapping = _percent(everything["overlapping"], n)
    low, high = scenes.LENGTHS
    return f"""\
# What the published tests answer

{n:,} random pairs (seed {seed}), half extents and semi-axes log-uniform in \
[{low}, {high}], float64; {overlapping} % overlap. {counts["left_out"]} more, \
within {TOUCHING:g} of touching, are left out. Columns: the ellipsoid's aspect ratio.
"Published": slips of the pen fixed, mathematics as printed. "0" means none at all.

{rates_table(counts)}

{report.machine_lines(hardware)}"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Counts, prints, writes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=400_000)
    parser.add_argument("--seed", type=int, default=0)
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    hardware = machine.describe()
    pairs = scenes.random(options.pairs, options.seed)
    with report.progress_bar() as progress:
        task = progress.add_task("counting", total=-(-options.pairs // CHUNK))
        counts = count_in_chunks(pairs, lambda: progress.advance(task))
    numbers = {"seed": options.seed, "machine": hardware, **counts}
    report.write(options, text(counts, options.seed, hardware), numbers)


if __name__ == "__main__":
    main()
