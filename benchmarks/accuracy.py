"""How wrong every setting is, by kind of scene: percentiles, and wrong verdicts.

Run from the repository root:

    python -m benchmarks.accuracy

The truth is that of the very (rounded) numbers given: verdicts by proofs and exact
arithmetic (`tests.truth`); margins and distances in extended precision along the
direction that most steps find in float64; gradients by most steps in float64. Errors
of margins are relative to max(1, growth distance); of distances, to the longest length
of the pair, the distance included; of gradients, of all 30 numbers with lengths in
units of the longest, to the size of the true one. Distances and their gradients are
those of pairs apart; of overlapping ones the depth is compared with the least known.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import (
    accuracy_report,
    machine,
    margin_scenes,
    reference,
    report,
    scenes,
    settings,
)
from benchmarks.settings import Setting
from jaxbe import plan_errors
from jaxbe.distance import MAX_STEPS as MOST_DISTANCE_STEPS
from jaxbe.growth import MAX_STEPS as MOST_MARGIN_STEPS
from tests import truth

PERCENTILES = {"50": 50, "99": 99, "99.9": 99.9, "max": 100}

LOWEST = {
    "random to 2": 1.0,
    "random to 4": 0.5,
    "random to 12": 0.17,
    "random to 40": 0.05,
    "random to 120": 0.017,
    "random to 1000": 0.002,
    "random to 10^4": 2e-4,
    "random to 10^5": 2e-5,
}
"""Random pairs by their largest spread, and their smallest length; the largest is 2."""

KINDS: dict[str, Callable[[int, int], scenes.Scene]] = {
    "spheres": lambda n, seed: scenes.spheres(scenes.random(n, seed)),
    **{k: functools.partial(scenes.random, low=low) for k, low in LOWEST.items()},
    "near touching": margin_scenes.KINDS["near touching, 0.001"],
    "needles": margin_scenes.needles,
    "plates": margin_scenes.plates,
}
"""Kinds of scenes: functions of size and seed."""

MOST = {
    settings.MARGIN_GRADIENT: Setting("margin", ("steps", MOST_MARGIN_STEPS), True),
    settings.DISTANCE_GRADIENT: Setting(
        "signed_distance", ("steps", MOST_DISTANCE_STEPS), True
    ),
}
"""What the truth of a gradient is taken from."""


DISTANCES = (settings.DISTANCE, settings.DEPTH)


class Truth:
    """What the settings are judged against, on one scene of one dtype.

    Attributes:
        scene: the pairs.
        answers: by kind of answer; those of gradients by `most`, or else `MOST`.
    """

    def __init__(
        self, scene: scenes.Scene, most: Mapping[str, Setting] | None = None
    ) -> None:
        self.scene = scene
        exact = scene.astype(np.float64)
        self.answers: dict[str, np.ndarray] = {
            settings.VERDICT: truth.overlaps(scene),
            settings.MARGIN: margin_scenes.truth(scene),
        }
        self.answers |= dict.fromkeys(DISTANCES, _distance(exact))
        for name, setting in (MOST if most is None else most).items():
            _, gradients = settings.under_vmap(setting)(*exact.bodies())
            self.answers[name] = plan_errors.flat_gradient(gradients, _longest(scene))

    def judged(self, answer: str) -> np.ndarray:
        """Which pairs count."""
        apart = self.answers[settings.DISTANCE] > 0
        if answer in (settings.DISTANCE, settings.DISTANCE_GRADIENT):
            return apart
        return ~apart if answer == settings.DEPTH else np.ones_like(apart)


def _distance(scene: scenes.Scene) -> np.ndarray:
    """The signed distance, of overlapping pairs the least depth known."""
    contacts = (_most_contact()(*scene.bodies()), _few_contact()(*scene.bodies()))
    values = [reference.value_along(scene, np.asarray(c.normal)) for c in contacts]
    return np.maximum(*values)


@functools.cache
def _most_contact() -> Callable[..., Any]:
    return settings.under_vmap(Setting("contact", ("steps", MOST_DISTANCE_STEPS)))


@functools.cache
def _few_contact() -> Callable[..., Any]:
    return settings.under_vmap(Setting("contact", ("steps", 3)))


def _longest(scene: scenes.Scene) -> np.ndarray:
    return plan_errors.longest_length(scene.e, scene.a)


def judge(setting: Setting, answer: str, true: Truth) -> dict[str, Any]:
    """Percentiles of errors, or counts of wrong verdicts."""
    found = settings.under_vmap(setting)(*true.scene.bodies())
    exact = true.answers[answer]
    if answer == settings.VERDICT:
        kept = _kept(setting, found, true.scene)
        return _wrong_verdicts(_as_verdicts(setting, found), exact) | {
            "false_keep_share": _share(kept & ~exact, ~exact)
        }
    error = _error(setting, answer, found, true)[true.judged(answer)]
    return {
        "nan": int(np.isnan(error).sum()),
        "error": {
            name: float(np.nanpercentile(error, p)) for name, p in PERCENTILES.items()
        },
    }


def _error(setting: Setting, answer: str, found: Any, true: Truth) -> np.ndarray:
    exact, longest = true.answers[answer], _longest(true.scene)
    if setting.gradients:
        return plan_errors.gradient_error(found[1], exact, longest)
    if answer == settings.MARGIN:
        return plan_errors.margin_error(found, exact)
    return plan_errors.distance_error(found, exact, longest)


def _as_verdicts(setting: Setting, found: Any) -> np.ndarray:
    """True where a user who may not miss a contact has to say "overlap"."""
    if setting.function == "certify":
        return np.asarray(found.verdict) >= 0
    found = np.asarray(found)
    return found if found.dtype == bool else ~(found > 0)


def _wrong_verdicts(found: np.ndarray, exact: np.ndarray) -> dict[str, Any]:
    false_overlap = int(np.sum(found & ~exact))
    missed = int(np.sum(~found & exact))
    return {
        "false_overlap": false_overlap,
        "missed": missed,
        "wrong_share": (false_overlap + missed) / len(exact),
        "false_overlap_share": _share(found & ~exact, ~exact),
    }


def _kept(setting: Setting, found: Any, scene: scenes.Scene) -> np.ndarray:
    """What a filter keeps that may lose no pair: the margin up to its slack."""
    if setting.function != "margin":
        return _as_verdicts(setting, found)
    slack = jaxbe.rounding_slack(scene.a.dtype, float(scene.spread.max()))
    return ~(np.asarray(found) > slack)


def _share(some: np.ndarray, of: np.ndarray) -> float:
    return float(np.sum(some)) / max(1.0, float(np.sum(of)))


def measure(pairs: int, seed: int, tick: Callable[[], Any]) -> list[dict[str, Any]]:
    """One entry for each kind of scene, dtype, setting and answer."""
    entries = []
    for kind, make in KINDS.items():
        scene = make(pairs, seed)
        spread = jaxbe.scene_facts(*scene.bodies()).upper_spread
        for dtype in settings.DTYPES:
            true = Truth(scene.astype(dtype))
            labels = {"scene": kind, "spread": spread, "dtype": dtype}
            entries += [
                labels
                | {"setting": setting.name, "answer": answer}
                | judge(setting, answer, true)
                for setting in settings.JUDGED
                for answer in setting.answers
            ]
            tick()
    return entries


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=100_000, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--quick", action="store_true", help="2000 pairs: a look, no result"
    )
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs = min(options.pairs, 2000)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {
        "machine": machine.describe(),
        "pairs": options.pairs,
        "seed": options.seed,
    }
    with report.progress_bar() as progress:
        bar = progress.add_task("accuracy", total=len(KINDS) * len(settings.DTYPES))
        numbers["errors"] = measure(
            options.pairs, options.seed, lambda: progress.advance(bar)
        )
    report.write(options, accuracy_report.text(numbers), numbers)


if __name__ == "__main__":
    main()
