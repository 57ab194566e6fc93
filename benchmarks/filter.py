"""The contact filter: what it misses, keeps needlessly, takes, and saves.

Run from the repository root:

    python -m benchmarks.filter

Missed: in float32, every pair of random states of the shipped scene (poses by MJX) and
of random near-touching pairs gets a bound of its own, from 1e-9 to 1e-2 m above its
distance in float64 (that of the very floats), and must be kept. Kept needlessly: at
fixed distances, beside bounding spheres. Times: of `filter_contacts` under vmap, by the
number of environments; of `mjx.step` in a process of its own (see
`benchmarks.filter_step`).
"""

from __future__ import annotations

import argparse
import functools
import types
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from benchmarks import (
    filter_report,
    filter_scenes,
    filter_step,
    filter_times,
    machine,
    report,
)
from benchmarks.filter_scenes import PAIRS_A_STATE, Sample
from jaxbe.lower_bound import ROUNDINGS
from jaxbe.mjx import filter_contacts
from jaxbe.mjx.bounds import pair_distances

CHUNK = 1000
"""States at a time."""

ABOVE = (-9, -2)
"""Powers of ten of metres between which bounds lie above the distances."""

NEAR = 0.05
"""Metres: a pair nearer than this, or less deep, counts as near contact."""

BOUNDS = (0.0, 0.01, 0.05, 0.2)
STEPS = (0, 1, 2)
ARM = "arm and shelf"
LOWS = {"random, spread to 40": 0.05, "random, spread to 1000": 0.002}


def sample_of(kind: str, start: int, stop: int, seed: int) -> Sample:
    """Some states of a kind."""
    if kind == ARM:
        return filter_scenes.arm_states(start, stop, seed)
    return filter_scenes.near_touching(stop - start, seed + start, LOWS[kind])


def measure_missed(
    kind: str, states: int, seed: int, tick: Callable[[], Any]
) -> dict[str, Any]:
    """The counts of a kind, over all chunks of its states."""
    parts = []
    for start in range(0, states, CHUNK):
        sample = sample_of(kind, start, min(start + CHUNK, states), seed)
        parts.append(_missed_in(sample, seed + start))
        tick()
    return {"kind": kind} | _merged(parts)


def _missed_in(sample: Sample, seed: int) -> dict[str, Any]:
    scene = sample.scene()
    truth = filter_scenes.distance(scene)
    # The depth found is not always the least: what overlaps counts as touching.
    above = 10 ** np.random.default_rng(seed).uniform(*ABOVE, truth.size)
    distance = (np.maximum(truth, 0) + above).reshape(len(sample.position), -1)
    lower = {steps: _run(sample, distance, steps) for steps in STEPS}
    slack = _slack(scene)
    counts = {
        "pairs": truth.size,
        "near": int(np.sum(abs(truth) < NEAR)),
        "overlapping": int(np.sum(truth < 0)),
        "steps": {
            str(steps): _by_steps(missed, found, truth, slack)
            for steps, (missed, found) in lower.items()
        },
    }
    if sample.qpos.size:
        counts["mujoco"] = _by_mujoco(sample, truth, lower[1][1])
    return counts


def _run(sample: Sample, distance: np.ndarray, steps: int) -> tuple[int, np.ndarray]:
    """How many pairs the filter drops; and the lower bounds, one after the other."""
    arguments = sample.model.geom_size, sample.position, sample.axes, distance
    kept, lower = _compiled(sample.pairs, steps)(*arguments)
    return distance.size - int(kept), np.asarray(lower, np.float64).ravel()


@functools.cache
def _compiled(pairs: Any, steps: int) -> Callable[..., Any]:
    def run(size: Any, position: Any, axes: Any, distance: Any) -> Any:
        model = types.SimpleNamespace(geom_size=size)
        data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        candidates = filter_contacts(pairs, model, data, distance=distance, steps=steps)
        return candidates.valid.sum(), pair_distances(pairs, model, data, steps)

    return jax.jit(run)


def _slack(scene: Any) -> np.ndarray:
    size = np.sum(abs(scene.K - scene.C) + scene.e + scene.a, axis=1, dtype=float)
    return ROUNDINGS * float(np.finfo(scene.K.dtype).eps) * size


def _by_steps(
    missed: int, lower: np.ndarray, truth: np.ndarray, slack: np.ndarray
) -> dict[str, Any]:
    apart = truth > 0
    used = 1 + (lower - truth)[apart] / slack[apart]
    return {
        "missed": missed,
        "overlapping_dropped": int(np.sum((lower > 0) & ~apart)),
        "apart_kept": int(np.sum(~(lower > 0) & apart)),
        "largest_share_of_slack": float(np.max(used, initial=-1)),
    }


def _by_mujoco(sample: Sample, truth: np.ndarray, lower: np.ndarray) -> dict[str, Any]:
    """Pairs dropped that overlap at MuJoCo C's own poses, in float64."""
    doubtful = np.flatnonzero((lower > 0) & (truth < 1e-4))
    which = np.stack(np.divmod(doubtful, len(sample.pairs)), axis=1)
    depth = -filter_scenes.distances_by_mujoco(sample, which)
    overlapping = depth[depth > 0]
    return {
        "dropped": int(overlapping.size),
        "largest_depth": float(np.max(overlapping, initial=0)),
    }


def _merged(parts: Sequence[Any]) -> Any:
    """Sums, and maxima of what is called largest."""
    first = parts[0]
    if not isinstance(first, dict):
        return sum(parts)
    return {
        key: max(p[key] for p in parts)
        if key.startswith("largest")
        else _merged([p[key] for p in parts])
        for key in first
    }


def measure_needless(states: int, seed: int, tick: Callable[[], Any]) -> Any:
    """Pairs a state that are kept at fixed distances, and those that must be."""
    parts = []
    for start in range(0, states, CHUNK):
        sample = sample_of(ARM, start, min(start + CHUNK, states), seed)
        scene = sample.scene()
        found = {"needed": filter_scenes.distance(scene)}
        found["bounding spheres"] = filter_scenes.between_spheres(*scene.bodies())
        every = np.full((len(sample.position), len(sample.pairs)), np.inf)
        for steps in STEPS:
            found[f"steps={steps}"] = _run(sample, every, steps)[1]
        parts.append(
            {
                name: {str(b): int(np.sum(~(np.asarray(x) > b))) for b in BOUNDS}
                for name, x in found.items()
            }
        )
        tick()
    total = _merged(parts)
    return {
        "states": states,
        "pairs": len(sample.pairs),
        "kept_a_state": {
            name: {bound: n / states for bound, n in counts.items()}
            for name, counts in total.items()
        },
    }


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--states", type=int, default=20_000, help="of the scene")
    parser.add_argument(
        "--random-states",
        type=int,
        default=42_000,
        help=f"of each kind of random pairs, {PAIRS_A_STATE} a state",
    )
    parser.add_argument("--environments", type=int, default=8192, help="the most")
    parser.add_argument("--step-environments", type=int, default=1024, help="the most")
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument("--seed", type=int, default=0)
    report.add_output_options(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {"machine": machine.describe()}
    states = {ARM: options.states} | dict.fromkeys(LOWS, options.random_states)
    with report.progress_bar() as progress:
        total = sum(-(-n // CHUNK) for n in states.values())
        tick = _bar(progress, "missed", total)
        numbers["missed"] = [
            measure_missed(kind, n, options.seed, tick) for kind, n in states.items()
        ]
        few = min(options.states, 2 * CHUNK)
        tick = _bar(progress, "kept needlessly", -(-few // CHUNK))
        numbers["needless"] = measure_needless(few, options.seed + 1, tick)
        counts = filter_times.counts(options.environments)
        tick = _bar(progress, "throughput", len(counts))
        numbers["throughput"] = filter_times.measure_throughput(
            counts, options.repeats, tick
        )
        tick = _bar(progress, "savings", 1)
        numbers["savings"] = filter_times.measure_savings(
            min(4096, options.environments), options.repeats
        )
        tick()
    if options.step_environments:
        numbers["step"] = filter_step.in_a_process(
            options.step_environments, options.repeats
        )
    report.write(options, filter_report.text(numbers), numbers)


def _bar(progress: Any, name: str, total: int) -> Callable[[], Any]:
    return functools.partial(progress.advance, progress.add_task(name, total=total))


if __name__ == "__main__":
    main()
