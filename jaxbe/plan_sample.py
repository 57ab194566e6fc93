"""The errors of settings on a sample of a scene's own pairs, for `jaxbe.plan`.

The truth is the same function's at most steps in float64, for the very numbers that a
setting was given; of depths, which are local minima, the shorter one. Errors at a share
of the pairs, and shares of pairs, are upper ones: by two standard deviations of what a
sample of this size can tell.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxbe import plan_errors
from jaxbe.distance import MAX_STEPS as MOST_DISTANCE_STEPS
from jaxbe.distance import signed_distance
from jaxbe.float64 import float64_allowed
from jaxbe.growth import MAX_STEPS as MOST_MARGIN_STEPS
from jaxbe.lower_bound import distance_lower_bound
from jaxbe.margin import margin
from jaxbe.pose import batch_shape
from jaxbe.scene_facts import SceneFacts, scene_facts
from jaxbe.shapes import Box, Ellipsoid

FUNCTIONS: dict[str, tuple[Callable[..., Any], str, int]] = {
    "margin": (margin, "margin", MOST_MARGIN_STEPS),
    "signed_distance": (signed_distance, "signed_distance", MOST_DISTANCE_STEPS),
    "lower_bound": (distance_lower_bound, "signed_distance", MOST_DISTANCE_STEPS),
}
"""By name: the function, what gives its truth, and at how many steps."""

JUDGED_BY = {"margin": "", "distance": "apart ", "depth": "overlapping "}
"""The pairs that count, by answer."""

LEAST_EXPECTED = 4
"""Pairs beyond a share that a sample must expect, to tell that there are not more."""


class Sample:
    """Pairs of a scene, and how wrong settings are on them.

    Attributes:
        facts: of the pairs.
        size: how many.
    """

    def __init__(self, box: Box, ellipsoid: Ellipsoid) -> None:
        self.facts: SceneFacts = scene_facts(box, ellipsoid)
        batch = batch_shape(box, ellipsoid)
        if any(
            isinstance(x, jax.core.Tracer) for x in jax.tree.leaves((box, ellipsoid))
        ):
            raise TypeError("sample must be known when a plan is made, got a tracer")
        self.size = math.prod(batch)
        self._fields = [*_flattened(box, batch), *_flattened(ellipsoid, batch)]
        self._longest = plan_errors.longest_length(self._fields[2], self._fields[5])
        self._answers: dict[Any, Any] = {}

    def error(
        self,
        function: str,
        steps: int,
        dtype: str,
        answer: str,
        share: float,
        gradients: bool = False,
    ) -> float:
        """At the share of the pairs, by `plan_errors`; infinite where it is NaN.

        No less than the rounding of the truth, eps of float64 times the spread.

        Args:
            function: a name of FUNCTIONS.
            steps: its knob.
            dtype: of the inputs.
            answer: "margin", "distance" (of pairs apart) or "depth" (of the others).
            share: of the pairs that count, below 1.
            gradients: whether that of the derivatives.

        Raises:
            ValueError: too few pairs that count.
        """
        counts = self._counts(answer, dtype)
        if counts.sum() < least_size(share):
            raise ValueError(
                f"the sample must have at least {least_size(share):,} pairs "
                f"{JUDGED_BY[answer]}to tell a share of {share}, got {counts.sum():,}"
            )
        errors = self._errors(function, steps, dtype, answer, gradients)[counts]
        rounding = float(np.finfo(np.float64).eps) * self.facts.spread
        found = upper_quantile(np.where(np.isnan(errors), np.inf, errors), share)
        return max(found, rounding)

    def _errors(
        self, function: str, steps: int, dtype: str, answer: str, gradients: bool
    ) -> plan_errors.Floats:
        """Of all pairs."""
        found = self._answer(function, steps, dtype, gradients)
        _, exact_by, most = FUNCTIONS[function]
        exact = self._answer(exact_by, most, dtype, gradients, "float64")
        if gradients:
            exact = plan_errors.flat_gradient(exact, self._longest)
            return plan_errors.gradient_error(found, exact, self._longest)
        if answer == "margin":
            return plan_errors.margin_error(found, exact)
        if answer == "depth":
            exact = np.maximum(exact, np.asarray(found, np.float64))
        return plan_errors.distance_error(found, exact, self._longest)

    def false_keeps(self, function: str, steps: int, dtype: str, slack: float) -> float:
        """The share of separated pairs that a filter keeps: not above the slack."""
        found = np.asarray(self._answer(function, steps, dtype))
        _, exact_by, most = FUNCTIONS[function]
        apart = np.asarray(self._answer(exact_by, most, dtype, work="float64")) > 0
        kept = int(np.sum(apart & ~(found > slack)))
        return upper_share(kept, int(np.sum(apart)))

    def _counts(self, answer: str, dtype: str) -> NDArray[np.bool_]:
        """Which pairs an answer is judged by; undecided ones always are."""
        if answer == "margin":
            return np.ones(self.size, bool)
        most = FUNCTIONS["signed_distance"][2]
        distance = self._answer("signed_distance", most, dtype, work="float64")
        apart = np.asarray(distance) > 0
        judged: NDArray[np.bool_] = np.isnan(distance)
        judged |= apart if answer == "distance" else ~apart
        return judged

    def _answer(
        self,
        function: str,
        steps: int,
        dtype: str,
        gradients: bool = False,
        work: str | None = None,
    ) -> Any:
        """What it says of the pairs rounded to `dtype`, reckoned in `work`."""
        key = function, steps, dtype, gradients, work
        if key not in self._answers:
            with float64_allowed():
                pairs = [x.astype(dtype).astype(work or dtype) for x in self._fields]
                bodies = Box.unchecked(*pairs[:3]), Ellipsoid.unchecked(*pairs[3:])
                found = _program(function, steps, gradients)(*bodies)
                self._answers[key] = jax.device_get(found)
        return self._answers[key]


def upper_quantile(errors: plan_errors.Floats, share: float) -> float:
    """The error at a share, of all pairs of which these are a sample."""
    beyond = errors.size * (1 - share)
    worse = max(0, math.floor(beyond - 2 * math.sqrt(beyond)))
    return float(np.partition(errors, -1 - worse)[-1 - worse])


def upper_share(count: int, of: int) -> float:
    """The share of all pairs, if so many of a sample have it; 1 if there is none."""
    return min(1.0, (count + 2 + 2 * math.sqrt(count + 1)) / of) if of else 1.0


def least_size(share: float) -> int:
    """How many pairs a sample needs for a share."""
    return round(LEAST_EXPECTED / (1 - share))


@functools.cache
def _program(function: str, steps: int, gradients: bool) -> Callable[..., Any]:
    call = functools.partial(FUNCTIONS[function][0], steps=steps)
    if gradients:
        return jax.jit(jax.vmap(jax.grad(call, argnums=(0, 1))))
    return jax.jit(call)


def _flattened(body: Box | Ellipsoid, batch: tuple[int, ...]) -> list[np.ndarray]:
    """The fields (n, 3), (n, 3, 3), (n, 3) of a body that broadcasts to the batch."""
    shapes = {name: (3, 3) if name == "axes" else (3,) for name in body.fields()}
    return [
        np.broadcast_to(np.asarray(x), batch + shapes[name]).reshape(-1, *shapes[name])
        for name, x in body.fields().items()
    ]
