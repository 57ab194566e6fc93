r"""The margin in float64 on one core, against coal: the child of `margin_speed`.

    XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1" \
        python -m benchmarks.margin_one_core

prints one JSON object. The margin runs with the fewest steps whose largest error
is at most 1e-8. coal (`pip install coal`) gets its objects ready-made; the time of
its Python binding is estimated by the same loop over two spheres.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import json
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from benchmarks import margin_scenes, scenes, timing
from jaxbe.growth import MAX_STEPS

TOLERANCE = 1e-8


def pin_to_one_core() -> None:
    """Leaves this process one of the cores it has; Linux only."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def fewest_steps(pairs: scenes.Scene) -> tuple[int, float]:
    """The steps that reach the tolerance, and the largest error then."""
    truth = margin_scenes.truth(pairs)
    for steps in range(MAX_STEPS + 1):
        difference = abs(margin_scenes.margin(pairs, steps) - truth)
        error = float(np.max(difference / np.maximum(1, truth + 1)))
        if error <= TOLERANCE:
            break
    return steps, error


def coal_loops(pairs: scenes.Scene) -> dict[str, Callable[[], list[float]]]:
    """Distances by coal of every pair, and of two spheres as often; {} without coal."""
    try:
        coal = importlib.import_module("coal")
    except ImportError:
        return {}
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    bodies = [_coal_pair(coal, *fields) for fields in zip(*pairs, strict=True)]
    ball = coal.Sphere(0.1)
    spheres = [(ball, T_box, ball, T) for _, T_box, _, T in bodies]

    def loop(calls: list[tuple[Any, ...]]) -> list[float]:
        distances = []
        for call in calls:
            # Else the smallest distance so far is kept, and no other is computed.
            result.clear()
            distances.append(coal.distance(*call, request, result))
        return distances

    return {
        "coal": functools.partial(loop, bodies),
        "coal, spheres": functools.partial(loop, spheres),
    }


def _coal_pair(
    coal: Any,
    C: np.ndarray,
    U: np.ndarray,
    e: np.ndarray,
    K: np.ndarray,
    V: np.ndarray,
    a: np.ndarray,
) -> tuple[Any, ...]:
    return (
        coal.Box(*(2 * e)),
        coal.Transform3s(scenes.proper(U), C),
        coal.Ellipsoid(*a),
        coal.Transform3s(scenes.proper(V), K),
    )


def measure(n: int, coal_pairs: int, repeats: int) -> dict[str, Any]:
    """Rates in pairs a second, of the margin and of coal."""
    pairs = scenes.random(n)
    steps, error = fewest_steps(pairs)
    margin = functools.partial(margin_scenes.compiled(steps), *pairs.bodies())
    loops = coal_loops(pairs.part(slice(coal_pairs)))
    sizes = {"margin": n} | dict.fromkeys(loops, min(n, coal_pairs))
    tasks = {name: timing.Task(call) for name, call in loops.items()}
    times = timing.interleaved({"margin": timing.Task(margin)} | tasks, repeats)
    return _disagreements(loops, margin) | {
        "pairs": n,
        "steps": steps,
        "largest_error": error,
        "cores": len(os.sched_getaffinity(0)),
        "cores_busy_with_others": times.others,
        "pairs_per_second": {
            name: sizes[name] / time.median for name, time in times.times.items()
        },
    }


def _disagreements(loops: dict[str, Callable[[], list[float]]], margin: Any) -> Any:
    """How many of coal's signs differ from the margin's; {} without coal."""
    if not loops:
        return {}
    distances = np.array(loops["coal"]())
    signs = np.asarray(margin())[: distances.size] <= 0
    return {"coal_disagrees": int(np.sum((distances <= 0) != signs))}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1_000_000)
    parser.add_argument("--coal-pairs", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=21)
    options = parser.parse_args(arguments)
    pin_to_one_core()
    jax.config.update("jax_enable_x64", True)
    print(json.dumps(measure(options.pairs, options.coal_pairs, options.repeats)))


if __name__ == "__main__":
    main()
