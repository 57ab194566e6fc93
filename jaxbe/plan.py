"""`plan`: the cheapest settings that are accurate enough for a scene.

It reads `frontier.json`, measured by `python -m benchmarks`: what each setting costs,
and how wrong it was on random scenes of several spreads, needles, plates and spheres;
of a sample of the scene's own pairs it measures the errors (see `plan_sample`).
Costs are of one machine; what counts is their order, which steps give everywhere.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxbe.margin import rounding_slack
from jaxbe.plan_sample import Sample
from jaxbe.plan_table import Measured, Settings, frontier, lines
from jaxbe.scene_facts import SceneFacts
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.validate import as_number

Output = Literal["overlap", "margin", "signed_distance", "contact", "filter_contacts"]
DType = Literal["float32", "float64"]
Keywords = Mapping[str, Any]

SHARES = {0.99: 0, 0.999: 1, 1.0: 2}
"""The shares of pairs that a tolerance can be for, and their columns in the table."""

VERDICT_BAND = {"float32": 2.1, "float64": 112.0}
"""In eps times the spread: nearer to touching `overlap` may be wrong (its tests)."""

FALSE_KEEPS = 0.01
"""The share of separated pairs that a filter may keep, if nothing else is said."""

SAFETY = 1.5
"""Another scene may be so much worse than the table's."""

ENOUGH = 2.0
"""Without a tolerance: the cheapest within so much of the best there is."""


class _Question(NamedTuple):
    """How an output is looked up: the table's function, and its kind of answer."""

    function: str
    answer: str
    gradient: str | None = None


_QUESTIONS: dict[str, _Question] = {
    "overlap": _Question("overlap", "verdict"),
    "margin": _Question("margin", "margin", "margin's gradient"),
    "signed_distance": _Question("signed_distance", "distance", "distance's gradient"),
    "contact": _Question("signed_distance", "distance", "distance's gradient"),
    "filter_contacts": _Question("lower_bound", "verdict"),
}


class _Row(NamedTuple):
    """A setting of the table and what it would cost here.

    Attributes:
        keywords: of the call.
        dtype: of the inputs.
        nanoseconds: for a pair, on the machine of the table.
        error: for the scene and the share of pairs asked for.
    """

    keywords: Keywords
    dtype: DType
    nanoseconds: float
    error: float


@dataclasses.dataclass(frozen=True)
class Plan:
    """Settings, by the functions asked for, as their keyword arguments.

    `jaxbe.margin(box, ellipsoid, **plan.margin)`; None for what was not asked for.
    Printed it says why; `dataclasses.asdict` of it is what `json.dumps` takes.

    Attributes:
        dtype: of the poses and sizes: "float32" or "float64".
        overlap: for `jaxbe.overlap`; None where pairs may not be missed.
        margin: for `jaxbe.margin`.
        signed_distance: for `jaxbe.signed_distance`.
        contact: for `jaxbe.contact`.
        filter_contacts: for `jaxbe.mjx.filter_contacts`.
        drop_above: where pairs may not be missed: only those whose margin is larger
            may be dropped; `rounding_slack` of the scene.
        why: a line for each function.
    """

    dtype: DType
    overlap: Keywords | None = None
    margin: Keywords | None = None
    signed_distance: Keywords | None = None
    contact: Keywords | None = None
    filter_contacts: Keywords | None = None
    drop_above: float | None = None
    why: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join((f"{self.dtype}:", *(f"  {line}" for line in self.why)))


def plan(
    *outputs: Output,
    scene: SceneFacts | None = None,
    sample: tuple[Box, Ellipsoid] | None = None,
    gradients: bool = False,
    dtype: DType | None = None,
    tolerance: float | None = None,
    share: float = 0.999,
    never_miss: bool = False,
) -> Plan:
    """The cheapest settings for a scene that keep a tolerance, and why.

    Args:
        *outputs: the functions needed: "overlap", "margin", "signed_distance",
            "contact", "filter_contacts".
        scene: its facts: `jaxbe.scene_facts(box, ellipsoid)`,
            `jaxbe.mjx.scene_facts(pairs, model)`, or a `SceneFacts` by hand. By
            default those of the sample.
        sample: boxes and ellipsoids of the scene in poses of its own, of shapes that
            broadcast: errors are measured on them then, instead of looked up (but for
            the verdict of "overlap"), and `tolerance` has to be given; where pairs may
            not be missed, also the `scene`, whose slimmest pair need not be in the
            sample. At least 4 / (1 - share) pairs that the answer is judged by, better
            ten times as many. Settings are compiled for it, which takes seconds to a
            minute.
        gradients: whether derivatives of margin and distances are needed as well; then
            the tolerance is for these, relative to the size of the gradient.
        dtype: "float32" or "float64"; by default float32 unless the tolerance needs
            the other.
        tolerance: largest error, for all outputs; best one output a plan. Of "margin"
            relative to max(1, growth distance); of "signed_distance" and "contact", for
            pairs that are apart, relative to the longest length of the pair or the
            distance; of "overlap" the |sqrt(q) - 1| of `scaled_distance` nearer than
            which a verdict may be wrong. Of a filter ("filter_contacts", or where pairs
            may not be missed) the share of separated pairs that may be kept, 0.01 if
            None. None otherwise: within twice of the best there is.
        share: of the pairs for which the tolerance is meant: 0.99, 0.999 or, without a
            sample, 1, as far as the table's 100,000 pairs a scene can tell.
        never_miss: whether no overlapping pair may be called separated, rounding
            included. "overlap" and "margin" are a filter then, by the margin and
            `drop_above`; ask for the values of margins in a plan of their own.

    Returns:
        A `Plan`. Without a sample, the errors are those that were measured on random
        scenes of the same upper spread (see `SceneFacts`), needles and plates included,
        interpolated in between; half as much again is allowed for, as another scene's
        may differ. Where bodies are aligned or seldom near each other, less would often
        do, and a sample tells. With one, the errors are those on its pairs, two
        standard deviations up, of what its size can tell.

    Raises:
        TypeError: a scene that is not a SceneFacts, a sample that is not a pair of
            bodies, or neither; a tolerance or share that is not a number.
        ValueError: no or unknown outputs, or another dtype or share; a tolerance that
            no setting reaches, or a spread beyond the table's (of "overlap" there is
            none): the message says what is the least. A sample that is too small, or
            without a tolerance, or for a share of 1, which none can tell.
    """
    share = _known_share(share)
    tolerance = None if tolerance is None else as_number("tolerance", tolerance)
    pairs = _measured(sample, share, tolerance)
    if pairs and scene is None and not never_miss:
        scene = pairs.facts
    _check(outputs, scene, dtype, tolerance, gradients, never_miss)
    assert scene is not None
    ask = _Ask(scene, pairs, gradients, tolerance, share, never_miss)
    names = tuple(dict.fromkeys(ask.answered_by(name) for name in outputs))
    for kind in (dtype,) if dtype else ("float32", "float64"):
        found = {name: _choose(name, kind, ask) for name in names}
        if all(found.values()):
            break
    else:
        raise ValueError(_best_there_is(found, names, dtype, ask))
    return _plan(found, kind, ask)  # type: ignore[arg-type]


class _Ask(NamedTuple):
    """What is asked, of whatever function."""

    scene: SceneFacts
    sample: Sample | None
    gradients: bool
    tolerance: float | None
    share: float
    never_miss: bool

    def answered_by(self, output: str) -> str:
        """The function that answers."""
        return "margin" if output == "overlap" and self.never_miss else output

    def is_filter(self, name: str) -> bool:
        """Whether this function is to drop pairs here, not to give values."""
        return name == "filter_contacts" or (name == "margin" and self.never_miss)


def _known_share(share: Any) -> float:
    """The share of the table that is meant, also by a number of few digits."""
    given = as_number("share", share)
    for known in SHARES:
        if math.isclose(given, known, rel_tol=1e-6):
            return known
    raise ValueError(f"share must be one of {', '.join(map(str, SHARES))}, got {share}")


def _measured(sample: Any, share: float, tolerance: float | None) -> Sample | None:
    if sample is None:
        return None
    if not isinstance(sample, tuple) or len(sample) != 2:
        given = type(sample).__name__
        raise TypeError(f"sample must be a tuple (box, ellipsoid), got {given}")
    if tolerance is None:
        raise ValueError("with a sample, a tolerance must be given")
    if share == 1:
        raise ValueError("a sample cannot tell a share of 1, only 0.99 or 0.999")
    return Sample(*sample)


def _check(
    outputs: tuple[str, ...],
    scene: Any,
    dtype: Any,
    tolerance: float | None,
    gradients: bool,
    never_miss: bool,
) -> None:
    if not isinstance(scene, SceneFacts):
        hint = "" if scene is not None else "; a sample alone does, but for never_miss"
        raise TypeError(f"scene must be a SceneFacts, got {type(scene).__name__}{hint}")
    for name in outputs or ("none",):
        if name not in _QUESTIONS:
            known = ", ".join(_QUESTIONS)
            raise ValueError(f"outputs must be of {known}; got {name!r}")
    if dtype not in (None, "float32", "float64"):
        raise ValueError(f"dtype must be 'float32' or 'float64', got {dtype!r}")
    if gradients and never_miss and {"margin", "overlap"} & set(outputs):
        raise ValueError("a margin that may miss no pair is a filter: no gradients")
    if tolerance is not None and not tolerance > 0:
        raise ValueError(f"tolerance must be positive, got {tolerance}")


def _choose(name: str, dtype: DType, ask: _Ask) -> _Row | None:
    """The cheapest row that is accurate enough."""
    limit = _limit(name, dtype, ask)
    # Beyond the table the error is infinite, and so is twice the least one.
    good = (row for row in _rows(name, dtype, ask) if math.inf > row.error <= limit)
    return next(good, None)


def _limit(name: str, dtype: DType, ask: _Ask) -> float:
    if ask.tolerance is not None:
        return ask.tolerance
    if ask.is_filter(name):
        return FALSE_KEEPS
    return ENOUGH * min(row.error for row in _rows(name, dtype, ask))


def _rows(name: str, dtype: DType, ask: _Ask) -> Iterator[_Row]:
    """All settings that could answer, the cheapest first, with what errors to expect.

    One by one: on a sample each is measured when it is asked for.
    """
    with_gradients = _with_gradients(name, ask)
    table = [
        row
        for row in lines(_QUESTIONS[name].function)
        if row.dtype == dtype and row.gradients == with_gradients
    ]
    for row in sorted(table, key=lambda row: row.nanoseconds):
        yield _Row(
            Settings(row.keywords), dtype, row.nanoseconds, _error(name, row, ask)
        )


def _with_gradients(name: str, ask: _Ask) -> bool:
    known = _QUESTIONS[name].gradient is not None
    return ask.gradients and known and not ask.is_filter(name)


def _error(name: str, row: Measured, ask: _Ask) -> float:
    """What to expect of a setting, with what is allowed for."""
    if name == "overlap":
        eps = float(np.finfo(row.dtype).eps)
        return SAFETY * VERDICT_BAND[row.dtype] * eps * ask.scene.spread
    if ask.is_filter(name):
        return _false_keeps(name, row, ask)
    question = _QUESTIONS[name]
    answer = question.gradient if row.gradients else question.answer
    if ask.sample is None:
        return SAFETY * row.error(answer, SHARES[ask.share], ask.scene)
    return ask.sample.error(
        question.function,
        row.keywords["steps"],
        row.dtype,
        question.answer,
        ask.share,
        row.gradients,
    )


def _false_keeps(name: str, row: Measured, ask: _Ask) -> float:
    """The share of separated pairs that a filter keeps."""
    if ask.sample is None:
        return SAFETY * row.error("verdict", 0, ask.scene)
    slack = rounding_slack(row.dtype, ask.scene.spread) if name == "margin" else 0.0
    function, steps = _QUESTIONS[name].function, row.keywords["steps"]
    return ask.sample.false_keeps(function, steps, row.dtype, slack)


def _depth_error(chosen: _Row, ask: _Ask) -> float:
    """Of the depths of overlapping pairs, by a distance's setting; NaN if unknown."""
    keywords = dict(chosen.keywords)
    if ask.sample is not None:
        question = keywords["steps"], chosen.dtype, "depth", ask.share
        try:
            return ask.sample.error("signed_distance", *question)
        except ValueError:  # Too few of them.
            return math.nan
    return next(
        SAFETY * row.error("depth", SHARES[ask.share], ask.scene)
        for row in lines("signed_distance")
        if (row.keywords, row.dtype, row.gradients) == (keywords, chosen.dtype, False)
    )


def _plan(found: dict[str, _Row], dtype: DType, ask: _Ask) -> Plan:
    slack = rounding_slack(dtype, ask.scene.spread) if ask.never_miss else None
    return Plan(
        dtype=dtype,
        drop_above=slack if "margin" in found else None,
        why=tuple(_reason(name, row, ask) for name, row in found.items()),
        **{name: row.keywords for name, row in found.items()},
    )


def _reason(name: str, row: _Row, ask: _Ask) -> str:
    call = ", ".join(f"{key}={value!r}" for key, value in row.keywords.items())
    spheres = ", spheres" if ask.scene.spheres else ""
    spread = ask.scene.spread if name == "overlap" else ask.scene.upper_spread
    where = f" at spread {spread:.3g}{spheres}"
    if ask.sample and name != "overlap":
        where = f", measured on {ask.sample.size:,}"
    rate = f"{row.nanoseconds:.3g} ns a pair on {frontier()['machine']}"
    return f"{name}({call}): {_promise(name, row, ask)}{where}; {rate}"


def _promise(name: str, row: _Row, ask: _Ask) -> str:
    if ask.is_filter(name):
        return f"misses no pair, keeps {100 * row.error:.2g} % of the separated ones"
    if name == "overlap":
        return f"right wherever |sqrt(q) - 1| > {row.error:.1e}"
    what = "gradients" if ask.gradients else "values"
    if name == "margin":
        return f"{what} to {row.error:.1e} in {100 * ask.share:g} % of pairs"
    depth = _depth_error(row, ask)
    known = f"to {depth:.1e}" if depth == depth else "unknown, the sample has too few"
    return (
        f"{what} to {row.error:.1e} in {100 * ask.share:g} % of pairs apart (depths of "
        f"overlapping ones {known})"
    )


def _best_there_is(
    found: dict[str, _Row | None],
    names: tuple[str, ...],
    dtype: DType | None,
    ask: _Ask,
) -> str:
    last: DType = dtype or "float64"
    errors = {
        name: min(row.error for row in _rows(name, last, ask))
        for name in names
        if found[name] is None
    }
    best = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
    where = f"at upper spread {ask.scene.upper_spread:.3g}"
    if ask.sample and set(errors) != {"overlap"}:
        where = f"of a sample of {ask.sample.size:,} pairs"
    return (
        f"no setting is sure to keep tolerance {ask.tolerance} {where}; the least that "
        f"is, in {last}: {best} (inf: beyond the table, or NaN)"
    )
