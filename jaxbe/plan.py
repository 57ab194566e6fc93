"""`plan`: the cheapest settings that are accurate enough for a scene.

It reads `frontier.json`, measured by `python -m benchmarks`: what each setting costs,
and how wrong it was on random scenes of several spreads, needles, plates and spheres.
Costs are of one machine; what counts is their order, which steps give everywhere.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxbe.margin import rounding_slack
from jaxbe.plan_table import frontier, lines
from jaxbe.scene_facts import SceneFacts

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
        depth: of distances, that of the depths of overlapping pairs.
    """

    keywords: Keywords
    dtype: str
    nanoseconds: float
    error: float
    depth: float = math.nan


@dataclasses.dataclass(frozen=True)
class Plan:
    """Settings, by the functions asked for, as their keyword arguments.

    `jaxbe.margin(box, ellipsoid, **plan.margin)`; None for what was not asked for.
    Printed it says why.

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
    scene: SceneFacts,
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
            `jaxbe.mjx.scene_facts(pairs, model)`, or a `SceneFacts` by hand.
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
        share: of the pairs for which the tolerance is meant: 0.99, 0.999 or 1, as
            far as the table's 100,000 pairs a scene can tell.
        never_miss: whether no overlapping pair may be called separated, rounding
            included. "overlap" and "margin" are a filter then, by the margin and
            `drop_above`; ask for the values of margins in a plan of their own.

    Returns:
        A `Plan`. The errors are those that were measured on random scenes of the same
        upper spread (see `SceneFacts`), needles and plates included, interpolated in
        between; half as much again is allowed for, as another scene's may differ. Where
        bodies are aligned or seldom near each other, less would often do.

    Raises:
        TypeError: a scene that is not a SceneFacts.
        ValueError: no or unknown outputs, or another dtype or share; a tolerance that
            no setting reaches, or a spread beyond the table's (of "overlap" there is
            none): the message says what is the least.
    """
    _check(outputs, scene, dtype, share, tolerance, gradients, never_miss)
    ask = _Ask(scene, gradients, tolerance, share, never_miss)
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
    gradients: bool
    tolerance: float | None
    share: float
    never_miss: bool

    @property
    def column(self) -> int:
        """Of the share, in the table."""
        return SHARES[self.share]

    def answered_by(self, output: str) -> str:
        """The function that answers."""
        return "margin" if output == "overlap" and self.never_miss else output

    def is_filter(self, name: str) -> bool:
        """Whether this function is to drop pairs here, not to give values."""
        return name == "filter_contacts" or (name == "margin" and self.never_miss)


def _check(
    outputs: tuple[str, ...],
    scene: Any,
    dtype: Any,
    share: Any,
    tolerance: Any,
    gradients: bool,
    never_miss: bool,
) -> None:
    if not isinstance(scene, SceneFacts):
        raise TypeError(f"scene must be a SceneFacts, got {type(scene).__name__}")
    for name in outputs or ("none",):
        if name not in _QUESTIONS:
            known = ", ".join(_QUESTIONS)
            raise ValueError(f"outputs must be of {known}; got {name!r}")
    if dtype not in (None, "float32", "float64"):
        raise ValueError(f"dtype must be 'float32' or 'float64', got {dtype!r}")
    if share not in SHARES:
        raise ValueError(f"share must be one of {', '.join(map(str, SHARES))}")
    if gradients and never_miss and {"margin", "overlap"} & set(outputs):
        raise ValueError("a margin that may miss no pair is a filter: no gradients")
    if tolerance is not None and not tolerance > 0:
        raise ValueError(f"tolerance must be positive, got {tolerance}")


def _choose(name: str, dtype: str, ask: _Ask) -> _Row | None:
    """The cheapest row that is accurate enough."""
    rows = _rows(name, dtype, ask)
    limit = _limit(name, rows, ask)
    # Beyond the table the error is infinite, and so is twice the least one.
    good = [row for row in rows if SAFETY * row.error <= limit and row.error < math.inf]
    return min(good, key=lambda row: row.nanoseconds, default=None)


def _limit(name: str, rows: list[_Row], ask: _Ask) -> float:
    if ask.tolerance is not None:
        return ask.tolerance
    if ask.is_filter(name):
        return FALSE_KEEPS
    return SAFETY * ENOUGH * min(row.error for row in rows)


def _rows(name: str, dtype: str, ask: _Ask) -> list[_Row]:
    """All settings that could answer."""
    if name == "overlap":
        eps = float(np.finfo(dtype).eps)
        band = VERDICT_BAND[dtype] * eps * ask.scene.spread
        table = [row for row in lines(name) if row.dtype == dtype]
        return [
            _Row(MappingProxyType(row.keywords), dtype, row.nanoseconds, band)
            for row in table
        ]
    question = _QUESTIONS[name]
    gradients = ask.gradients and question.gradient is not None
    answer = question.gradient if gradients else question.answer
    column = ask.column
    if ask.is_filter(name):
        gradients, answer, column = False, "verdict", 0
    table = [
        row
        for row in lines(question.function)
        if row.dtype == dtype and row.gradients == gradients
    ]
    return [
        _Row(
            MappingProxyType(row.keywords),
            dtype,
            row.nanoseconds,
            row.error(answer, column, ask.scene),
            _depth_error(row.keywords, question, dtype, ask),
        )
        for row in table
    ]


def _depth_error(
    keywords: Keywords, question: _Question, dtype: str, ask: _Ask
) -> float:
    """Of the depths with these keywords; NaN for what is no distance."""
    if question.function != "signed_distance":
        return math.nan
    return next(
        row.error("depth", ask.column, ask.scene)
        for row in lines(question.function)
        if (row.keywords, row.dtype, row.gradients) == (keywords, dtype, False)
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
    where = f"at spread {spread:.3g}{spheres}"
    rate = f"{row.nanoseconds:.3g} ns a pair on {frontier()['machine']}"
    return f"{name}({call}): {_promise(name, row, ask)} {where}; {rate}"


def _promise(name: str, row: _Row, ask: _Ask) -> str:
    if ask.is_filter(name):
        return f"misses no pair, keeps {100 * row.error:.2g} % of the separated ones"
    if name == "overlap":
        return f"right wherever |sqrt(q) - 1| > {row.error:.1e}"
    what = "gradients" if ask.gradients else "values"
    if name == "margin":
        return f"{what} to {row.error:.1e} in {100 * ask.share:g} % of pairs"
    return (
        f"{what} to {row.error:.1e} in {100 * ask.share:g} % of pairs apart (depths of "
        f"overlapping ones to {row.depth:.1e})"
    )


def _best_there_is(
    found: dict[str, _Row | None],
    names: tuple[str, ...],
    dtype: str | None,
    ask: _Ask,
) -> str:
    last = dtype or "float64"
    errors = {
        name: SAFETY * min(row.error for row in _rows(name, last, ask))
        for name in names
        if found[name] is None
    }
    best = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
    return (
        f"no setting is sure to keep tolerance {ask.tolerance} at upper spread "
        f"{ask.scene.upper_spread:.3g}; the least that is, in {last}: {best} (inf: "
        "beyond the table)"
    )
