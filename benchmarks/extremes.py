"""A map of the extremes: what is lost beyond what the inputs' rounding must lose.

Run from the repository root:

    python -m benchmarks.extremes

Aspect ratios from 1 to 1e7, sizes from 1e-18 to 1e18 m, distances from 0 to 1e6 sizes,
in float32, in float64 and with inputs in bfloat16. Every error is divided by the
conditioning of its pair: by how much the true answer changes when each of the 30
numbers given is moved by half a unit in the last place, all changes added up, plus
half a unit of the answer. So 1 is what no arithmetic in that dtype can be sure to meet.
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
from benchmarks import extended, extremes_report, machine, report
from benchmarks.extended import Answer
from benchmarks.extremes_scenes import (
    ASPECTS,
    COMPUTED,
    DISTANCES,
    DTYPES,
    SIZES,
    pairs,
    scaled,
)
from benchmarks.reference import LONG
from benchmarks.scenes import Scene
from tests import truth


class Query(NamedTuple):
    """A function of the library, and its truth.

    Attributes:
        function: the library's.
        truth: the true value, of which `offset` is subtracted.
        offset: 1 for the margin, which is the growth distance less one.
        is_length: whether the value is in metres.
    """

    function: Callable[..., jax.Array]
    truth: Callable[[Scene], Answer]
    offset: int = 0
    is_length: bool = False


QUERIES = {
    "scaled_distance": Query(jaxbe.scaled_distance, extended.scaled_distance),
    "margin": Query(jaxbe.margin, extended.growth_distance, offset=1),
    "signed_distance": Query(jaxbe.signed_distance, extended.distance, is_length=True),
}
OVERLAP = "overlap"
ROWS = (OVERLAP, *(f"{name}{of}" for name in QUERIES for of in ("", ", gradient")))
"""What is judged."""


class True_(NamedTuple):
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
    """Errors over conditioning (n,), and which answers are not finite (n,)."""

    ratio: np.ndarray
    lost: np.ndarray


@functools.cache
def compiled(name: str) -> Callable[..., Any]:
    """Value and gradient of a query, under vmap."""
    function = QUERIES[name].function
    return jax.jit(jax.vmap(jax.value_and_grad(function, argnums=(0, 1))))


@functools.cache
def verdicts(method: str) -> Callable[..., jax.Array]:
    """`overlap` by one method, compiled."""
    return jax.jit(jax.vmap(functools.partial(jaxbe.overlap, method=method)))


def true_answer(scene: Scene, query: Query) -> True_:
    """The truth at one scene and its change with each of the 30 numbers."""
    unit = float(np.finfo(scene.a.dtype).eps) / 2
    at = query.truth(scene)
    value, gradient = at.value - query.offset, extended.gradient(scene, at)
    conditioning = unit * abs(value)
    of_gradient = unit * _by_field(gradient)
    for both in _moved(scene.astype(LONG), unit):
        moves = [_change(scene, at, gradient, query) for scene in both]
        change, slopes = (np.maximum(*x) for x in zip(*moves, strict=True))
        conditioning, of_gradient = conditioning + change, of_gradient + slopes
    judged = np.ones(scene.size, bool)
    if query.is_length:
        judged = at.value > 0
    return True_(value, conditioning, gradient, of_gradient, judged)


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
    changes = (x - y for x, y in zip(slopes, gradient, strict=True))
    return abs(there.value - at.value), _by_field(list(changes))


def _by_field(fields: Sequence[np.ndarray]) -> np.ndarray:
    """The largest entry of each field, (n, 6)."""
    return np.stack([abs(x).reshape(len(x), -1).max(axis=1) for x in fields], axis=1)


def judge(scene: Scene, exponent: int, name: str, true: True_) -> tuple[Judged, Judged]:
    """Values and gradients of the scene, scaled by a power of two."""
    value, gradient = found(scaled(scene, exponent), name, exponent)
    error = abs(value - true.value)
    if QUERIES[name].is_length:
        along, rounding = along_own_direction(scene, gradient[3])
        error = np.where(true.judged, error, abs(value - along))
        conditioning = np.where(true.judged, true.conditioning, rounding)
    else:
        conditioning = true.conditioning
    ratio = _ratio(error, conditioning)
    off = _by_field(Scene(*(x - y for x, y in zip(gradient, true.gradient))))
    of_gradient = np.max(_ratio(off, true.of_gradient), axis=1)
    lost = ~np.all([np.isfinite(x).reshape(scene.size, -1).all(1) for x in gradient], 0)
    return (
        Judged(ratio, ~np.isfinite(value)),
        Judged(np.where(true.judged, of_gradient, 0), lost),
    )


def found(scene: Scene, name: str, exponent: int) -> tuple[np.ndarray, Scene]:
    """What the library says, in extended precision, in units of the exponent."""
    value, gradient = compiled(name)(*scene.bodies())
    metres = LONG(2.0) ** exponent
    per_value = 1 / metres if QUERIES[name].is_length else LONG(1)
    fields = [np.asarray(x).astype(LONG) * per_value for x in jax.tree.leaves(gradient)]
    for i in (0, 2, 3, 5):
        fields[i] = fields[i] * metres
    return np.asarray(value).astype(LONG) * per_value, Scene(*fields)


def along_own_direction(
    scene: Scene, world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The distance along directions in world axes, and what rounding does to it.

    Of overlapping pairs there are several depths; the one found is judged by itself.
    """
    long = scene.astype(LONG)
    length = np.sqrt(np.sum(world * world, axis=1))
    n = np.einsum(
        "nri,nr->ni", long.U, world / np.where(length > 0, length, 1)[:, None]
    )
    one = np.ones(scene.size, LONG)
    pair = extended.canonical(scene)
    value = extended.along(pair, n)
    slopes = extended.gradient(scene, Answer(value, n, one, one))
    terms = [
        np.sum(abs(x * y).reshape(scene.size, -1), 1) for x, y in zip(slopes, long)
    ]
    unit = float(np.finfo(scene.a.dtype).eps) / 2
    return value, unit * (np.sum(terms, axis=0) + abs(value))


def _ratio(error: np.ndarray, conditioning: np.ndarray) -> np.ndarray:
    """Their quotient; 0 for no error, infinite for one without reason, NaN stays 0."""
    wrong = error > 0
    quotient = error / np.where(conditioning > 0, conditioning, np.finfo(LONG).tiny)
    return np.where(wrong, quotient, 0)


def judge_verdicts(
    scene: Scene, exponent: int, true: True_, right: np.ndarray
) -> Judged:
    """How far from touching wrong verdicts are, over the conditioning of sqrt(q)."""
    bodies = scaled(scene, exponent).bodies()
    given = [np.asarray(verdicts(method)(*bodies)) for method in jaxbe.METHODS]
    wrong = np.any([x != right for x in given], axis=0)
    return Judged(
        np.where(wrong, _ratio(abs(true.value - 1), true.conditioning), 0), wrong
    )


def measure_cell(
    aspect: float, distance: str | float, dtype: str, sizes: Sequence[int], n: int
) -> Iterator[dict[str, Any]]:
    """Entries of one cell, one for each size and row."""
    scene = pairs(aspect, distance, dtype, n)
    right = truth.overlaps(scene)
    truths = {name: true_answer(scene, query) for name, query in QUERIES.items()}
    for size in sizes:
        rows = {OVERLAP: judge_verdicts(scene, size, truths["scaled_distance"], right)}
        for name, true in truths.items():
            judged = judge(scene, size, name, true)
            rows[name], rows[f"{name}, gradient"] = judged
        for row, (ratio, lost) in rows.items():
            yield {
                "row": row, "dtype": dtype, "aspect": aspect, "distance": distance,
                "size": size, "ratio": float(np.max(ratio)),
                "beyond_ten": int(np.sum(ratio > 10)), "lost": int(np.sum(lost)),
            }  # fmt: skip
