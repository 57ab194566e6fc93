"""Does `jaxbe.plan` keep its word on scenes that its table has not seen?

Run from the repository root, after `benchmarks.frontier`:

    python -m benchmarks.plan_check --throughput results/throughput-cpu.json

For each scene, function and tolerance: the error of the plan's setting there, and its
cost over that of the fastest setting that keeps the tolerance there (costs as measured
by `benchmarks.throughput`, errors here). Once the plan knows the scene's lengths only,
once it has a sample: as many pairs, others of the same scene.
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np

import jaxbe
from benchmarks import (
    accuracy,
    frontier,
    machine,
    margin_scenes,
    report,
    scenes,
    settings,
)
from benchmarks.settings import Setting
from jaxbe.cli import states
from jaxbe.cli.arguments import DEFAULT_SCENE
from jaxbe.mjx import find_pairs, gather

SHARE, PERCENTILE = 0.999, "99.9"
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10)
FALSE_KEEPS = (0.5, 0.1, 0.01, 0.001)
TIMES_FASTEST = 1.3
"""What a plan may cost at most, of the fastest setting that keeps the tolerance."""

SEED = 12345

QUESTIONS: dict[str, tuple[str, str, bool]] = {
    "margin": ("margin", settings.MARGIN, False),
    "margin, gradients": ("margin", settings.MARGIN_GRADIENT, True),
    "signed_distance": ("signed_distance", settings.DISTANCE, False),
    "signed_distance, gradients": (
        "signed_distance",
        settings.DISTANCE_GRADIENT,
        True,
    ),
}
"""What is planned: function, kind of answer, and whether with gradients."""

NEVER = ("never miss", FALSE_KEEPS)
"""And as a filter."""


def shipped(n: int, seed: int) -> scenes.Scene:
    """Pairs of the scene shipped with jaxbe, in random states of its joints."""
    model = mujoco.MjModel.from_xml_path(str(DEFAULT_SCENE))
    pairs = find_pairs(model)
    count = -(-n // len(pairs))
    qpos = states.random_states(model, count, seed).rows(0, count)
    poses = states.Poses(
        np.zeros((count, model.ngeom, 3)), np.zeros((count, model.ngeom, 9))
    )
    states.forward_kinematics(model, mujoco.MjData(model), qpos, poses)
    box, ellipsoid = gather(pairs, model, poses)
    lengths = ((count, len(pairs), 3), box.half_extents, ellipsoid.semi_axes)
    e, a = (np.broadcast_to(x, lengths[0]) for x in lengths[1:])
    fields = (box.center, box.axes, e, ellipsoid.center, ellipsoid.axes, a)
    flat = (np.asarray(x).reshape(-1, *x.shape[2:])[:n] for x in fields)
    return scenes.Scene(*flat)


def _two_sizes(n: int, seed: int) -> scenes.Scene:
    """Boxes three times as large as the ellipsoids, centres normally distributed."""
    pairs = scenes.random(n, seed, low=0.1, high=0.8)
    offset = np.random.default_rng(seed).normal(size=(n, 3)) * 1.5
    return pairs._replace(e=3 * pairs.e, K=pairs.C + offset)


def _mixed(n: int, seed: int) -> scenes.Scene:
    """Nine easy pairs to one of needles."""
    hard = margin_scenes.needles(n // 10, seed)
    easy = scenes.random(n - n // 10, seed, low=1.0)
    return scenes.Scene(*(np.concatenate(x) for x in zip(easy, hard, strict=True)))


HELD_OUT: dict[str, Callable[[int, int], scenes.Scene]] = {
    "the shipped scene": shipped,
    "spread to 7": functools.partial(scenes.random, low=0.1, high=0.7),
    "spread to 80": functools.partial(scenes.random, low=0.01, high=0.8),
    "spread to 400": functools.partial(scenes.random, low=0.01, high=4.0),
    "spread to 3 10^4": functools.partial(scenes.random, low=1e-3, high=30.0),
    "a tenth of needles": _mixed,
    "aligned": lambda n, seed: scenes.axis_aligned(scenes.random(n, seed)),
    "boxes larger": _two_sizes,
    "plates": lambda n, seed: scenes.flattened(scenes.random(n, seed), 1),
    "spheres": lambda n, seed: scenes.spheres(scenes.random(n, seed, low=0.1)),
}
"""Scenes by name, none of which `benchmarks.accuracy` has."""


BASES = ("lengths", "sample")
"""What a plan is made from."""


def measure(
    pairs: int, nanoseconds: dict[tuple[str, str], float], tick: Callable[[], Any]
) -> list[dict[str, Any]]:
    """An entry for each scene, question, tolerance and basis."""
    entries = []
    for name, make in HELD_OUT.items():
        scene = make(pairs, SEED)
        facts = jaxbe.scene_facts(*scene.bodies())
        sample = {"scene": facts, "sample": make(pairs, SEED + 1).bodies()}
        bases = dict(zip(BASES, ({"scene": facts}, sample), strict=True))
        true = {d: accuracy.Truth(scene.astype(d)) for d in settings.DTYPES}
        for question, tolerances in (
            *dict.fromkeys(QUESTIONS, TOLERANCES).items(),
            NEVER,
        ):
            found = _found(question, true, nanoseconds)
            entries += [
                {"scene": name, "spread": facts.upper_spread, "question": question}
                | {"by": by, **_compare(question, basis, tolerance, found)}
                for tolerance in tolerances
                for by, basis in bases.items()
            ]
        tick()
    return entries


Found = dict[tuple[str, str], tuple[float, float]]
"""By setting and dtype: nanoseconds, and the error on this scene."""


def _found(
    question: str,
    true: dict[str, accuracy.Truth],
    nanoseconds: dict[tuple[str, str], float],
) -> Found:
    if question in QUESTIONS:
        return _errors(question, true, nanoseconds)
    return _false_keeps(true, nanoseconds)


def _errors(
    question: str,
    true: dict[str, accuracy.Truth],
    nanoseconds: dict[tuple[str, str], float],
) -> Found:
    function, answer, gradients = QUESTIONS[question]
    mine = [
        s
        for s in settings.JUDGED
        if s.function == function and s.gradients == gradients
    ]
    return {
        (s.name, d): (
            nanoseconds[s.name, d],
            accuracy.judge(s, answer, true[d])["error"][PERCENTILE],
        )
        for s in mine
        for d in settings.DTYPES
    }


def _false_keeps(
    true: dict[str, accuracy.Truth], nanoseconds: dict[tuple[str, str], float]
) -> Found:
    mine = [s for s in settings.JUDGED if s.function == "margin" and not s.gradients]
    return {
        (s.name, d): (
            nanoseconds[s.name, d],
            accuracy.judge(s, settings.VERDICT, true[d])["false_keep_share"],
        )
        for s in mine
        for d in settings.DTYPES
    }


Basis = dict[str, Any]
"""Arguments of the plan."""


def _compare(
    question: str, basis: Basis, tolerance: float, found: Found
) -> dict[str, Any]:
    """What the plan chose, whether it keeps the tolerance, and its cost."""
    good = [cost for cost, error in found.values() if error <= tolerance]
    entry: dict[str, Any] = {"tolerance": tolerance, "possible": bool(good)}
    try:
        name, dtype = planned(question, basis, tolerance)
    except ValueError:
        return entry | {"refused": True}
    cost, error = found[name, dtype]
    entry |= {"refused": False, "setting": name, "dtype": dtype, "error": error}
    entry["kept"] = bool(error <= tolerance)
    entry["times_fastest"] = cost / min(good) if good else None
    return entry


def planned(question: str, basis: Basis, tolerance: float) -> tuple[str, str]:
    """The setting's name and dtype that the plan has."""
    options = basis | {"tolerance": tolerance}
    if question in QUESTIONS:
        function, _, gradients = QUESTIONS[question]
        found = jaxbe.plan(function, share=SHARE, gradients=gradients, **options)
    else:
        function, gradients = "margin", False
        found = jaxbe.plan("overlap", never_miss=True, **options)
    keywords = getattr(found, function)
    setting = Setting(function, ("steps", keywords["steps"]), gradients)
    return setting.name, found.dtype


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    plans = numbers["plans"]
    made = [e for e in plans if not e["refused"]]
    parts = [
        "# Does the plan keep its word?",
        f"{numbers['pairs']:,} pairs of each scene, none of them in the plan's table "
        f"or sample. The tolerance is for {100 * SHARE:g} % of the pairs; where none "
        "may be missed, for the share of separated pairs that margin and slack keep. "
        "Costs are those of the same run of `benchmarks.throughput`.",
        *(_summary(by, [e for e in plans if e["by"] == by]) for by in BASES),
        "## Plans that do not keep the tolerance, or cost more",
        report.table(HEADER, [_row(e) for e in made if not _is_good(e)]),
        "## All plans",
        report.table(HEADER, [_row(e) for e in made]),
        report.machine_lines(numbers["machine"]),
    ]
    return "\n\n".join(parts)


def _summary(by: str, plans: list[dict[str, Any]]) -> str:
    made = [e for e in plans if not e["refused"]]
    kept = sum(e["kept"] for e in made)
    costs = [e["times_fastest"] for e in made if e["times_fastest"]]
    within = sum(cost <= TIMES_FASTEST for cost in costs)
    refused = [e for e in plans if e["refused"]]
    wrongly = sum(e["possible"] for e in refused)
    return (
        f"Plans by {by}: of {len(made)} plans {kept} keep the tolerance; {within} of "
        f"{len(costs)} cost at most {TIMES_FASTEST} times the fastest setting that "
        f"keeps it. {len(refused)} tolerances were refused, {wrongly} of which some "
        "setting would have kept."
    )


HEADER = (
    *("scene", "upper spread", "question", "tolerance", "by", "plan", "dtype"),
    *("error there", "x fastest"),
)


def _is_good(entry: dict[str, Any]) -> bool:
    return bool(entry["kept"] and entry["times_fastest"] <= TIMES_FASTEST)


def _row(e: dict[str, Any]) -> tuple[str, ...]:
    return (
        e["scene"],
        f"{e['spread']:.3g}",
        e["question"],
        f"{e['tolerance']:.0e}",
        e["by"],
        e["setting"],
        e["dtype"],
        f"{e['error']:.1e}",
        f"{e['times_fastest']:.2f}" if e["times_fastest"] else "",
    )


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--throughput", type=Path, required=True, metavar="FILE")
    parser.add_argument("--pairs", type=int, default=50_000, help="of each scene")
    parser.add_argument("--quick", action="store_true", help="2000 pairs: no result")
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs = min(options.pairs, 2000)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    rates = frontier.rates_by_setting(json.loads(options.throughput.read_text()))
    nanoseconds = {key: 1e9 / rate for key, rate in rates.items()}
    with report.progress_bar() as progress:
        bar = progress.add_task("plans", total=len(HELD_OUT))
        plans = measure(options.pairs, nanoseconds, lambda: progress.advance(bar))
    numbers = {
        "machine": machine.describe(),
        "pairs": options.pairs,
        "plans": plans,
    }
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
