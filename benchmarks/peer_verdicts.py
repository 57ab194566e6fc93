"""Who is wrong: the verdicts and distances of jaxbe and its peers, judged exactly.

Every verdict is judged on the floats that its system was given: float64 numbers, or the
same rounded to float32. (Systems that take quaternions or shape matrices get them
converted in float64, which moves a pair by some 1e-16.) Touching counts as overlap.
Where two systems differ the exact rational oracle settles it, and the pair is listed.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import reference, scenes
from benchmarks.peer_adapters import Answer
from tests import oracle, truth

DTYPES = ("float64", "float32")

BANDS = {"float32": (1e-5, 1e-4), "float64": (1e-12, 1e-10)}
"""The README's bounds of |sqrt(q) - 1| within which rounding may decide, for spreads
to 40 and to 1000; beyond, the latter in proportion to the spread."""

REFERENCE_STEPS = 12
"""Steps of the distance whose normals the reference takes."""

System = tuple[str, str, Answer]
"""A system's name, the dtype of what it was given, and what it said."""


def band(spread: float, dtype: str) -> float:
    """How far from touching, as |sqrt(q) - 1|, rounding may make a verdict wrong."""
    to_40, to_1000 = BANDS[dtype]
    return to_40 if spread <= 40 else to_1000 * max(1.0, spread / 1000)


def judge(kind: str, pairs: scenes.Scene, systems: Iterable[System]) -> dict[str, Any]:
    """Judges all systems on the same pairs.

    Args:
        kind: what the pairs are called.
        pairs: in float64.
        systems: their answers.

    Returns:
        `systems`: by name the number of wrong verdicts within and outside the band,
        the largest |sqrt(q) - 1| of a wrong one, answers that are NaN, and the largest
        error of the distances apart; `disagreements`: see `disagreements`.
    """
    systems = list(systems)
    given = {dtype: pairs.astype(dtype) for dtype in DTYPES}
    true = {dtype: truth.overlaps(given[dtype]) for dtype in DTYPES}
    told = {dtype for _, dtype, answer in systems if answer.distance is not None}
    distances = {dtype: apart_distance(given[dtype], true[dtype]) for dtype in told}
    judged = {
        name: verdict_errors(given[dtype], true[dtype], answer.overlap)
        | distance_errors(distances.get(dtype), answer.distance)
        for name, dtype, answer in systems
    }
    return {
        "kind": kind,
        "pairs": pairs.size,
        "overlapping": float(true["float64"].mean()),
        "systems": judged,
        "disagreements": disagreements(given, true, systems),
    }


def verdict_errors(
    given: scenes.Scene, true: np.ndarray, verdicts: np.ndarray
) -> dict[str, Any]:
    """Wrong verdicts, within the stated band and outside, and the furthest."""
    wrong = np.flatnonzero(verdicts != true)
    dtype, spread = given.C.dtype.name, given.spread
    far = [truth.distance_from_touching(given, i) for i in wrong]
    outside = sum(
        bool(x > band(spread[i], dtype)) for i, x in zip(wrong, far, strict=True)
    )
    return {
        "wrong_within_band": len(wrong) - outside,
        "wrong_outside_band": outside,
        "missed_overlaps": int(np.sum(true[wrong])),
        "furthest_wrong": max(far, default=0.0),
    }


def apart_distance(given: scenes.Scene, overlapping: np.ndarray) -> np.ndarray:
    """The distance of pairs that are apart, NaN where they overlap.

    The value of the direction that many steps of jaxbe find in float64, computed in
    extended precision by none of its formulas. At the best direction an error of the
    direction counts as its square, and no direction gives more than the distance.
    """
    wide = given.astype(np.float64)
    normals = np.asarray(_normals()(*wide.bodies()))
    return np.where(overlapping, np.nan, reference.value_along(wide, normals))


@functools.cache
def _normals() -> Any:
    return jax.jit(lambda *bodies: jaxbe.contact(*bodies, steps=REFERENCE_STEPS).normal)


def distance_errors(
    true: np.ndarray | None, distance: np.ndarray | None
) -> dict[str, Any]:
    """The largest error in metres of pairs apart; and how many answers are NaN."""
    if true is None or distance is None:
        return {}
    apart = np.isfinite(true)
    # What a system takes for an overlap is counted among the verdicts.
    compared = apart & np.isfinite(distance) & (distance > 0)
    error = abs(distance - true)[compared]
    return {
        "distances_compared": int(compared.sum()),
        "distances_nan": int(np.sum(np.isnan(distance))),
        "largest_distance_error": float(error.max(initial=0.0)),
    }


def disagreements(
    given: Mapping[str, scenes.Scene],
    true: Mapping[str, np.ndarray],
    systems: Sequence[System],
) -> list[dict[str, Any]]:
    """Every pair on which two systems differ, settled by the exact oracle.

    Returns:
        A dictionary each. `index`: the pair's place. `pair`: its numbers C, U, e, K, V,
        a, row by row, which read back to the very float64 numbers. `truth`: of these,
        and of the same rounded to float32; `from_touching`: |sqrt(q) - 1| of both. And
        one digit a system, in the order of `systems`: `overlap`, 1 for who said so;
        `wrong`, 1 for who was; `outside_band`, 1 for who was so far from touching.
    """
    said = np.array([answer.overlap for _, _, answer in systems])
    differ = np.flatnonzero(np.any(said != said[:1], axis=0)) if systems else ()
    return [_settled(given, true, systems, said[:, i], int(i)) for i in differ]


def _settled(
    given: Mapping[str, scenes.Scene],
    true: Mapping[str, np.ndarray],
    systems: Sequence[System],
    said: np.ndarray,
    i: int,
) -> dict[str, Any]:
    settled = {d: oracle.overlaps(truth.exact(given[d], i)) for d in DTYPES}
    assert all(settled[d] == true[d][i] for d in DTYPES)
    far = {d: truth.distance_from_touching(given[d], i) for d in DTYPES}
    beyond = {d: bool(far[d] > band(given[d].spread[i], d)) for d in DTYPES}
    dtypes = [dtype for _, dtype, _ in systems]
    wrong = [bool(v != settled[d]) for v, d in zip(said, dtypes, strict=True)]
    outside = [w and beyond[d] for w, d in zip(wrong, dtypes, strict=True)]
    return {
        "index": i,
        "pair": " ".join(repr(float(x)) for x in flat(given["float64"], i)),
        "truth": settled,
        "from_touching": far,
        "overlap": _digits(said),
        "wrong": _digits(wrong),
        "outside_band": _digits(outside),
    }


def _digits(flags: Iterable[Any]) -> str:
    return "".join(str(int(flag)) for flag in flags)


def flat(pairs: scenes.Scene, i: int) -> np.ndarray:
    """The 30 numbers of a pair."""
    return np.concatenate([x[i].ravel() for x in pairs])


def counts(judged: Mapping[str, Any]) -> dict[str, int]:
    """How the disagreements on one kind were settled.

    `both_right`: float32 rounding moved the pair across touching, and each system is
    right about the floats it was given. A pair may count in several.
    """
    entries, names = judged["disagreements"], list(judged["systems"])

    def count(key: str, ours: bool) -> int:
        chosen = [i for i, n in enumerate(names) if n.startswith("jaxbe") == ours]
        return sum(any(e[key][i] == "1" for i in chosen) for e in entries)

    return {
        "all": len(entries),
        "a_peer_wrong": count("wrong", False),
        "jaxbe_wrong": count("wrong", True),
        "jaxbe_wrong_outside_band": count("outside_band", True),
        "both_right": sum("1" not in e["wrong"] for e in entries),
    }
