"""A map of the extremes: what is lost beyond what the inputs' rounding must lose.

Run from the repository root:

    python -m benchmarks.extremes

Aspect ratios from 1 to 1e7, sizes from 1e-18 to 1e18 m, distances from 0 to 1e6 sizes,
in float32, in float64 and with inputs in bfloat16. Every error is divided by the
conditioning of its pair: by how much the true answer changes when each of the 30
numbers given is moved by half a unit of rounding, up or down, all changes added up,
plus half a unit of the answer. A ratio of 1 is what no arithmetic can be sure to beat.
"""

from __future__ import annotations

import argparse
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxbe
from benchmarks import extended, extremes_figure, extremes_report, machine, report
from benchmarks.extended import Answer
from benchmarks.extremes_scenes import (
    ASPECTS,
    DISTANCES,
    DTYPES,
    SIZES,
    pairs,
    scaled,
)
from benchmarks.reference import LONG
from benchmarks.scenes import Scene
from jaxbe.growth import MAX_STEPS
from tests import truth


class Query(NamedTuple):
    """A function of the library, and its truth.

    Attributes:
        function: the library's.
        truth: the true value, of which `offset` is subtracted.
        offset: 1 for the margin, which is the growth distance less one.
        is_length: whether the value is in metres.
        more_steps: than the default, to tell rounding from stopping early.
    """

    function: Callable[..., jax.Array]
    truth: Callable[[Scene], Answer]
    offset: int = 0
    is_length: bool = False
    more_steps: int | None = None


QUERIES = {
    "scaled_distance": Query(jaxbe.scaled_distance, extended.scaled_distance),
    "margin": Query(
        jaxbe.margin, extended.growth_distance, offset=1, more_steps=MAX_STEPS
    ),
    "signed_distance": Query(
        jaxbe.signed_distance, extended.distance, is_length=True, more_steps=8
    ),
}
OVERLAP = "overlap"
CHUNK = 128


class TrueAnswer(NamedTuple):
    """What a query should give, and how far rounding the inputs moves it.

    Attributes:
        value, conditioning: (n,).
        gradient: six arrays.
        of_gradient: its conditioning, (n, 6): by field.
        judged: (n,), pairs whose truth this is: for distances, those apart.
    """

    value: np.ndarray
    conditioning: np.ndarray
    gradient: Scene
    of_gradient: np.ndarray
    judged: np.ndarray


class Judged(NamedTuple):
    """Errors over conditioning (n,), and which answers are not finite or wrong (n,).

    Of gradients also the ratios by field, (n, 6), and the error of the derivatives in
    the ellipsoid's centre relative to their size, (n,).
    """

    ratio: np.ndarray
    lost: np.ndarray
    by_field: np.ndarray | None = None
    direction: np.ndarray | None = None


@functools.cache
def compiled(name: str, steps: int | None = None) -> Callable[..., Any]:
    """Value and gradient of a query, under vmap; at its default steps, or others."""
    options = {} if steps is None else {"steps": steps}
    function = functools.partial(QUERIES[name].function, **options)
    return jax.jit(jax.vmap(jax.value_and_grad(function, argnums=(0, 1))))


@functools.cache
def verdicts(method: str) -> Callable[..., jax.Array]:
    """`overlap` by one method, compiled."""
    return jax.jit(jax.vmap(functools.partial(jaxbe.overlap, method=method)))


def true_answer(scene: Scene, query: Query) -> TrueAnswer:
    """The truth at one scene and its change with each of the 30 numbers."""
    unit = _unit(scene)
    at = query.truth(scene)
    value, gradient = at.value - query.offset, extended.gradient(scene, at)
    conditioning = unit * abs(value)
    of_gradient = unit * _by_field(gradient)
    for both in _moved(scene.astype(LONG), unit):
        moves = [_change(moved, at, gradient, query) for moved in both]
        change, slopes = (np.maximum(*x) for x in zip(*moves, strict=True))
        conditioning, of_gradient = conditioning + change, of_gradient + slopes
    judged = at.value > 0 if query.is_length else np.ones(scene.size, bool)
    return TrueAnswer(value, conditioning, gradient, of_gradient, judged)


def _moved(scene: Scene, unit: float) -> Iterator[list[Scene]]:
    """The scene with one number after the other larger, and smaller, by a unit."""
    for field, values in enumerate(scene):
        for entry in np.ndindex(values.shape[1:]):
            both = []
            for sign in (1, -1):
                changed = values.copy()
                changed[(slice(None), *entry)] *= 1 + sign * LONG(unit)
                both.append(scene._replace(**{scene._fields[field]: changed}))
            yield both


def _change(
    moved: Scene, at: Answer, gradient: Scene, query: Query
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the answer differs from the one given, and its gradient."""
    there = query.truth(moved)
    slopes = extended.gradient(moved, there)
    changes = [x - y for x, y in zip(slopes, gradient, strict=True)]
    return abs(there.value - at.value), _by_field(changes)


def _by_field(fields: Sequence[np.ndarray]) -> np.ndarray:
    """The largest entry of each field, (n, 6)."""
    return np.stack([abs(x).reshape(len(x), -1).max(axis=1) for x in fields], axis=1)


def judge(
    scene: Scene, exponent: int, name: str, steps: int | None, true: TrueAnswer
) -> tuple[Judged, Judged]:
    """Values and gradients of the scene, scaled by a power of two."""
    value, gradient = found(scaled(scene, exponent), name, steps, exponent)
    error, conditioning = abs(value - true.value), true.conditioning
    if QUERIES[name].is_length:
        along, rounding = along_own_direction(scene, gradient.K)
        error = np.where(true.judged, error, abs(value - along))
        conditioning = np.where(true.judged, conditioning, rounding)
    off = _by_field([x - y for x, y in zip(gradient, true.gradient, strict=True)])
    by_field = np.where(true.judged[:, None], _ratio(off, true.of_gradient), 0)
    finite = [np.isfinite(x).reshape(scene.size, -1).all(axis=1) for x in gradient]
    return (
        Judged(_ratio(error, conditioning), ~np.isfinite(value)),
        Judged(
            by_field.max(axis=1),
            ~np.all(finite, axis=0),
            by_field,
            _direction_error(gradient, true),
        ),
    )


def _direction_error(gradient: Scene, true: TrueAnswer) -> np.ndarray:
    """Of the derivatives in the ellipsoid's centre, relative to the largest."""
    size = abs(true.gradient.K).max(axis=1)
    error = abs(gradient.K - true.gradient.K).max(axis=1)
    return np.where(true.judged & (size > 0), error / np.where(size > 0, size, 1), 0)


def found(
    scene: Scene, name: str, steps: int | None, exponent: int
) -> tuple[np.ndarray, Scene]:
    """What the library says, in extended precision, in units of the exponent."""
    metres = LONG(2.0) ** exponent
    per_value = 1 / metres if QUERIES[name].is_length else LONG(1)
    value, *arrays = (x * per_value for x in in_chunks(compiled(name, steps), scene))
    fields = [x if i in (1, 4) else x * metres for i, x in enumerate(arrays)]
    return value, Scene(*fields)


def in_chunks(function: Callable[..., Any], scene: Scene) -> list[np.ndarray]:
    """The arrays that a function gives, so many pairs at a time: it compiles once."""
    parts = []
    for start in range(0, scene.size, CHUNK):
        which = np.arange(start, start + CHUNK) % scene.size
        leaves = jax.tree.leaves(function(*scene.part(which).bodies()))
        parts.append([np.asarray(x).astype(LONG) for x in leaves])
    return [np.concatenate(x)[: scene.size] for x in zip(*parts, strict=True)]


def along_own_direction(
    scene: Scene, world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The distance along directions in world axes, and its conditioning.

    Of overlapping pairs there are several depths; the one found is judged by itself.
    Components of rounding are zeros: the direction was turned to world axes.
    """
    long, unit = scene.astype(LONG), _unit(scene)
    n = np.einsum("nri,nr->ni", long.U, world)
    n = np.where(abs(n) < 32 * unit, 0, n)
    n = n / np.maximum(np.sqrt(np.sum(n * n, axis=1)), LONG(1e-30))[:, None]
    one = np.ones(scene.size, LONG)
    value = extended.along(extended.canonical(scene), n)
    slopes = extended.gradient(scene, Answer(value, n, one, one))
    terms = [
        np.sum(abs(x * y).reshape(scene.size, -1), axis=1)
        for x, y in zip(slopes, long, strict=True)
    ]
    return value, unit * (np.sum(terms, axis=0) + abs(value))


def _unit(scene: Scene) -> float:
    return float(np.finfo(scene.a.dtype).eps) / 2


def _ratio(error: np.ndarray, conditioning: np.ndarray) -> np.ndarray:
    """Their quotient; 0 for no error and for NaN, which are counted apart."""
    wrong = error > 0
    quotient = error / np.where(conditioning > 0, conditioning, np.finfo(LONG).tiny)
    return np.where(wrong, quotient, 0)


def judge_verdicts(
    scene: Scene, exponent: int, true: TrueAnswer, right: np.ndarray
) -> Judged:
    """How far from touching wrong verdicts are, over the conditioning of sqrt(q)."""
    there = scaled(scene, exponent)
    given = [in_chunks(verdicts(method), there)[0] for method in jaxbe.METHODS]
    wrong = np.any([x != right for x in given], axis=0)
    ratio = _ratio(abs(true.value - 1), true.conditioning)
    return Judged(np.where(wrong, ratio, 0), wrong)


def measure_cell(
    aspect: float,
    distance: str | float,
    dtype: str,
    sizes: Sequence[int],
    n: int,
    more: bool = True,
) -> Iterator[dict[str, Any]]:
    """Entries of one cell, one for each size and row; and at more steps."""
    scene = pairs(aspect, distance, dtype, n)
    right = truth.overlaps(scene)
    truths = {name: true_answer(scene, query) for name, query in QUERIES.items()}
    at = {"dtype": dtype, "aspect": aspect, "distance": str(distance)}
    for size in sizes:
        judged = judge_verdicts(scene, size, truths["scaled_distance"], right)
        yield _entry(OVERLAP, at, size, judged)
        for name, true in truths.items():
            both = judge(scene, size, name, None, true)
            for row, result in zip(_rows(name), both, strict=True):
                yield _entry(row, at, size, result)
    for name, true in truths.items():
        steps = QUERIES[name].more_steps
        if more and steps is not None:
            both = judge(scene, 0, name, steps, true)
            for row, result in zip(_rows(name), both, strict=True):
                yield _entry(row, at, 0, result) | {"steps": steps}


def _rows(name: str) -> tuple[str, str]:
    return name, f"{name}, gradient"


def _entry(row: str, at: dict[str, Any], size: int, judged: Judged) -> dict[str, Any]:
    entry = at | {
        "row": row,
        "size": size,
        "ratio": float(f"{np.max(judged.ratio):.3g}"),
        "beyond": int(np.sum(judged.ratio > extremes_report.CLEAN)),
        "lost": int(np.sum(judged.lost)),
    }
    if judged.by_field is None or judged.direction is None:
        return entry
    worst = [float(f"{x:.3g}") for x in judged.by_field.max(axis=0)]
    direction = float(f"{judged.direction.max():.3g}")
    return entry | {"fields": worst, "direction": direction}


def measure(
    dtypes: Sequence[str],
    aspects: Sequence[float],
    sizes: Sequence[int],
    n: int,
    more: bool,
    tick: Callable[[], Any],
) -> list[dict[str, Any]]:
    """All cells; `more`: at more steps too."""
    entries: list[dict[str, Any]] = []
    for dtype, aspect, distance in itertools.product(dtypes, aspects, DISTANCES):
        entries += measure_cell(aspect, distance, dtype, sizes, n, more)
        tick()
    return entries


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes, draws."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=100, help="in each cell")
    parser.add_argument("--quick", action="store_true", help="few cells, few pairs")
    report.add_output_options(parser)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the maps")
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    dtypes, aspects, sizes, n = DTYPES, ASPECTS, SIZES, options.pairs
    if options.quick:
        dtypes, aspects, sizes, n = DTYPES[:1], (1.0, 1e4), (-60, 0, 60), 12
    with report.progress_bar() as progress:
        total = len(dtypes) * len(aspects) * len(DISTANCES)
        bar = progress.add_task("cells", total=total)
        tick = functools.partial(progress.advance, bar)
        entries = measure(dtypes, aspects, sizes, n, not options.quick, tick)
    numbers = {"machine": machine.describe(), "pairs": n}
    numbers |= extremes_report.maps(entries)
    report.write(options, extremes_report.text(numbers), numbers)
    if options.figure:
        extremes_figure.draw(numbers, options.figure)


if __name__ == "__main__":
    main()
