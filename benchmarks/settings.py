"""Everything that the suite measures: functions of a pair with their options.

The same list serves the throughput, the accuracy, and the frontier that joins both.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax

import jaxbe
from benchmarks import layouts
from jaxbe import lower_bound
from jaxbe.distance import DEFAULT_STEPS as DISTANCE_STEPS
from jaxbe.margin import DEFAULT_STEPS as MARGIN_STEPS

DTYPES = ("float32", "float64")

VERDICT, MARGIN, DISTANCE, DEPTH = "verdict", "margin", "distance", "depth"
MARGIN_GRADIENT, DISTANCE_GRADIENT = "margin's gradient", "distance's gradient"

ANSWERS = (VERDICT, MARGIN, MARGIN_GRADIENT, DISTANCE, DISTANCE_GRADIENT, DEPTH)
"""What a setting can be judged by; distances where bodies are apart, else depths."""

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "overlap": jaxbe.overlap,
    "scaled_distance": jaxbe.scaled_distance,
    "margin": jaxbe.margin,
    "margin_bounds": jaxbe.margin_bounds,
    "signed_distance": jaxbe.signed_distance,
    "distance_bounds": jaxbe.distance_bounds,
    "contact": jaxbe.contact,
    "certify": jaxbe.certify,
    "lower_bound": lower_bound.distance_lower_bound,
}
"""By name; the last one is what `jaxbe.mjx.filter_contacts` goes by."""

GRADIENTS = {
    "margin": MARGIN_GRADIENT,
    "signed_distance": DISTANCE_GRADIENT,
}

MARGIN_COUNTS = (0, 1, 2, 3, 4, 5, 7, 10)
MARGIN_GRADIENT_COUNTS = (1, 2, 3, 5, 7)
DISTANCE_COUNTS = (1, 2, 3, 4, 5, 8)
DISTANCE_GRADIENT_COUNTS = (1, 3, 4, 5)
CONTACT_COUNTS = (1, 3, 5)
BOUND_COUNTS = (0, 1, 2, 4)


class Setting(NamedTuple):
    """One way to ask.

    Attributes:
        function: a name of FUNCTIONS.
        option: its option by name, or nothing.
        gradients: whether with the derivatives in all 30 numbers of the pair.
    """

    function: str
    option: tuple[str, Any] | None = None
    gradients: bool = False

    @property
    def name(self) -> str:
        """As the reports have it."""
        words = [self.function + (" and gradients" if self.gradients else "")]
        if self.option:
            words.append(str(self.option[1]))
            if self.option[0] == "steps":
                words[-1] += " step" if self.option[1] == 1 else " steps"
        return ", ".join(words)

    @property
    def options(self) -> dict[str, Any]:
        """As keyword arguments."""
        return dict([self.option]) if self.option else {}

    @property
    def steps(self) -> int | None:
        """The count of steps, if the function has one."""
        return self.options.get("steps")

    @property
    def is_default(self) -> bool:
        """Whether it is what a call without options does."""
        return self.option in (
            None,
            ("method", jaxbe.METHODS[0]),
            ("steps", MARGIN_STEPS if "margin" in self.function else DISTANCE_STEPS),
        )

    @property
    def call(self) -> Callable[..., Any]:
        """The function of one pair."""
        function = functools.partial(FUNCTIONS[self.function], **self.options)
        if self.gradients:
            return jax.value_and_grad(function, argnums=(0, 1))
        return function

    @property
    def answers(self) -> tuple[str, ...]:
        """What it can be judged by."""
        if self.gradients:
            return (GRADIENTS[self.function],)
        values = {
            "margin": (MARGIN, VERDICT),
            "signed_distance": (DISTANCE, DEPTH, VERDICT),
            "lower_bound": (DISTANCE, VERDICT),
            "overlap": (VERDICT,),
            "certify": (VERDICT,),
        }
        return values.get(self.function, ())


@functools.cache
def under_vmap(setting: Setting) -> Callable[..., Any]:
    """The jitted function of bodies with arrays (N, 3) and (N, 3, 3)."""
    return layouts.by_vmap(setting.call)


def _by_steps(
    function: str, counts: tuple[int, ...], gradients: bool = False
) -> Iterator[Setting]:
    return (Setting(function, ("steps", n), gradients) for n in counts)


SETTINGS: tuple[Setting, ...] = (
    *(Setting("overlap", ("method", m)) for m in jaxbe.METHODS),
    Setting("scaled_distance"),
    Setting("certify"),
    *_by_steps("margin", MARGIN_COUNTS),
    *_by_steps("margin_bounds", (MARGIN_STEPS,)),
    *_by_steps("margin", MARGIN_GRADIENT_COUNTS, gradients=True),
    *_by_steps("lower_bound", BOUND_COUNTS),
    *_by_steps("signed_distance", DISTANCE_COUNTS),
    *_by_steps("distance_bounds", (DISTANCE_STEPS,)),
    *_by_steps("signed_distance", DISTANCE_GRADIENT_COUNTS, gradients=True),
    *_by_steps("contact", CONTACT_COUNTS),
)
"""All of them, the cheap ones first."""

JUDGED: tuple[Setting, ...] = tuple(s for s in SETTINGS if s.answers)
"""Those that `benchmarks.accuracy` judges."""


def named(settings: tuple[Setting, ...] = SETTINGS) -> Mapping[str, Setting]:
    """By the names of the reports."""
    return {setting.name: setting for setting in settings}
