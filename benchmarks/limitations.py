"""The figures of the README's limitations.

Run from the repository root:

    python -m benchmarks limitations

How near to touching float32 verdicts of small ellipsoids on a large floor are wrong;
from which distance float32 has no answer; what a short last batch axis costs on a CPU;
and from how many operations on XLA's CPU backend computes an expression many times.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import machine, report, scenes, timing, verdicts
from jaxbe import growth
from jaxbe.pose import canonical_pair
from tests import programs

PAIRS = 1000
GRID = (200, 5)
FUNCTIONS: dict[str, Callable[..., jax.Array]] = {
    "overlap": jaxbe.overlap,
    "margin": jaxbe.margin,
    "signed_distance": jaxbe.signed_distance,
}
DISTANCES = (jaxbe.margin, jaxbe.signed_distance)

EXPRESSIONS = (2, 4, 6, 8)
"""Steps of the margin in one expression; jaxbe itself takes at most five."""


def floor(n: int, near: float) -> scenes.Scene:
    """Ellipsoids of 1 to 5 mm on floors of 5 m, to a share from touching."""
    pairs, rng = scenes.random(n, low=0.001, high=0.005), np.random.default_rng(5)
    e = np.broadcast_to([5.0, 5.0, 0.05], (n, 3))
    normal = np.einsum("nrp,nr->np", pairs.V, pairs.U[:, :, 2]) * pairs.a
    above = np.linalg.norm(normal, axis=1) * (1 + rng.uniform(-near, near, n))
    place = rng.uniform(-4.5, 4.5, (n, 3))
    place[:, 2] = 0.05 + above
    K = np.einsum("nri,ni->nr", pairs.U, place)
    return pairs._replace(C=np.zeros((n, 3)), e=e, K=K)


def on_floors(n: int) -> list[dict[str, Any]]:
    """Wrong verdicts, by how near the pairs are to touching."""
    found = []
    for near in (1e-2, 1e-3, 1e-4, 1e-5):
        pairs = floor(n, near).astype(np.float32)
        found.append({"near": near} | verdicts.row(pairs, "floor", "", "float32"))
    return found


def furthest(function: Callable[..., jax.Array]) -> float:
    """The power of ten of semi-axes apart up to which float32 has a finite answer."""
    distances = 10.0 ** np.arange(0, 38)
    unit = np.broadcast_to(np.eye(3), (len(distances), 3, 3))
    box = jaxbe.Box.unchecked(*_single(np.zeros((len(unit), 3)), unit, unit[:, 0] + 1))
    center = distances[:, None] * np.array([0.6, 0.0, 0.8])
    one = np.broadcast_to([1.0, 0.9, 0.8], center.shape)
    found = jax.jit(function)(
        box, jaxbe.Ellipsoid.unchecked(*_single(center, unit, one))
    )
    return float(distances[np.isfinite(found)].max())


def _single(*arrays: np.ndarray) -> Iterator[np.ndarray]:
    return (np.float32(x) for x in arrays)


def short_last_axis(repeats: int) -> dict[str, float]:
    """How many times as much a grid costs whose last axis is the short one."""
    many, few = GRID
    box, ellipsoid = scenes.random(many).astype(np.float32).bodies()
    box = jax.tree.map(lambda x: x[:few], box)
    column = functools.partial(jax.tree.map, lambda x: x[:, None])
    grids = {"short": (box, column(ellipsoid)), "long": (column(box), ellipsoid)}
    tasks = {
        f"{name}, {last}": timing.long_enough(
            timing.Task(functools.partial(jax.jit(function), *bodies)), 0.01
        )
        for name, function in FUNCTIONS.items()
        for last, bodies in grids.items()
    }
    times, *_ = timing.interleaved(tasks, repeats)
    return {
        name: times[f"{name}, short"].median / times[f"{name}, long"].median
        for name in FUNCTIONS
    }


def expressions(repeats: int) -> list[dict[str, float]]:
    """Operations of one expression, and its cost for a pair and an operation."""
    pairs, found = scenes.random(PAIRS).astype(np.float32).bodies(), []
    for count in EXPRESSIONS:
        function = jax.jit(functools.partial(_in_one_expression, count))
        size = programs.largest_expression(function, *pairs)
        task = timing.Task(functools.partial(function, *pairs))
        times, *_ = timing.interleaved({"it": task}, repeats)
        nanoseconds = times["it"].median / PAIRS * 1e9
        entry = {"steps": count, "operations": size, "nanoseconds": nanoseconds}
        found.append(entry | {"nanoseconds_an_operation": nanoseconds / size})
    return found


def _in_one_expression(steps: int, box: Any, ellipsoid: Any) -> jax.Array:
    return growth.growth_estimate(canonical_pair(box, ellipsoid), steps)


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    floors = [
        (f"{r['near']:.0e}", *(f"{r[m]['furthest']:.1e}" for m in jaxbe.METHODS))
        for r in numbers["floors"]
    ]
    cliff = [
        (
            str(e["steps"]),
            f"{e['operations']:,}",
            f"{e['nanoseconds']:,.0f}",
            f"{e['nanoseconds_an_operation']:.3f}",
        )
        for e in numbers["expressions"]
    ]
    far = [(name, f"{x:.0e}") for name, x in numbers["furthest"].items()]
    short = [(name, f"{x:.1f}") for name, x in numbers["short_last_axis"].items()]
    parts = [
        "# Limitations in figures (float32)",
        "Ellipsoids of 1 to 5 mm on floors of 5 m, so near to touching: the furthest "
        "|sqrt(q) - 1| of a wrong verdict.",
        report.table(("near", *jaxbe.METHODS), floors),
        "Finite up to so many of the largest semi-axis between the centres.",
        report.table(("function", "distance"), far),
        f"{GRID[0]} by {GRID[1]} pairs: times the cost of {GRID[1]} by {GRID[0]}.",
        report.table(("function", "times"), short),
        "Steps of the margin in one expression.",
        report.table(("steps", "operations", "ns/pair", "ns/operation"), cliff),
        report.machine_lines(numbers["machine"]),
    ]
    return "\n\n".join(parts)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=100_000, help="on floors")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="2000 pairs: a look")
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs, options.repeats = min(options.pairs, 2000), 3
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers = {
        "machine": machine.describe(),
        "floors": on_floors(options.pairs),
        "furthest": {f.__name__: furthest(f) for f in DISTANCES},
        "short_last_axis": short_last_axis(options.repeats),
        "expressions": expressions(options.repeats),
    }
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
