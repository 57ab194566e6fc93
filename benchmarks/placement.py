"""Placing ellipsoids among boxes: by the margin's gradient, and by what else there is.

Run from the repository root, with the extra `bench`:

    python -m benchmarks.placement

The tasks: the melon of examples/1_push_out.py out of its shelf's boxes, from random
poses, half of them in a parcel; 20 and 60 fruit into the crate of
examples/2_packing.py, at 60 % of the density where that begins to fail. All methods
have the same instances, the same random starts in the same order, the same proof of
success (`certify` and the proofs of the examples) and the same time, on one core. To
prepare (compile, build) is timed apart.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import importlib
import importlib.metadata
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import (
    machine,
    one_core,
    placement_mujoco,
    placement_report,
    placement_tasks,
    report,
)
from benchmarks.placement_methods import METHODS, ROOMS, Method, by_gradient
from benchmarks.placement_tasks import Problem

SEED = 7
STARTS = 1024
"""Random poses an instance, the first and those for more tries."""


class Kind(NamedTuple):
    """A task.

    Attributes:
        make: an instance with so many starts.
        instances: how many.
        slow_instances: how many of them methods get that are slow on this task.
    """

    make: Callable[[np.random.Generator, int], Problem]
    instances: int
    slow_instances: int


RATES = (0.003, 0.01, 0.03, 0.1)
"""Of Adam, tried on the shelf."""


def crate(fruit: int, fails_at: float) -> Callable[..., Problem]:
    """At 60 % of a density."""
    make = placement_tasks.crate
    return functools.partial(make, fruit=fruit, density=0.6 * fails_at)


KINDS = {
    "shelf": Kind(placement_tasks.shelf, 100, 100),
    "20 fruit": Kind(crate(20, fails_at=0.42), 50, 50),
    "60 fruit": Kind(crate(60, fails_at=0.50), 20, 10),
}
"""Where packing begins to fail is what examples/2_packing.py --measure says."""


def solved(method: Method, problem: Problem, budget: float) -> dict[str, Any]:
    """One method on one instance."""
    began = time.perf_counter()
    run = method.prepare(problem)
    prepared = time.perf_counter() - began
    watch = placement_tasks.Watch(problem, budget)
    with contextlib.suppress(placement_tasks.Finished):
        run(watch)
    assert watch.best is not None
    return {
        "prepared_in": prepared,
        "solved_after": watch.solved_after,
        "tried_for": watch.elapsed(),
        "from_first_start": watch.solved_after is not None and watch.start == 0,
        "clearance": placement_mujoco.least_distance(problem, watch.best),
    }


def available(failures: dict[str, str]) -> dict[str, Method]:
    """The methods whose package is there; why others are left out is noted."""
    found = {}
    for name, method in METHODS.items():
        try:
            importlib.import_module(method.package)
            found[name] = method
        except ImportError as error:
            failures[name] = f"{type(error).__name__}: {error}"
    return found


def versions(methods: Mapping[str, Method]) -> dict[str, str]:
    """Of the packages used, jaxbe apart."""
    used = {"optax", "mujoco", *(method.package for method in methods.values())}
    return {name: importlib.metadata.version(name) for name in sorted(used - {"jaxbe"})}


def problems_of(kind: Kind) -> list[Problem]:
    """All instances."""
    rng = np.random.default_rng(SEED)
    return [kind.make(rng, STARTS) for _ in range(kind.instances)]


def judged(
    kind: Kind, methods: Mapping[str, Method], budget: float, tick: Callable[[], Any]
) -> dict[str, Any]:
    """All methods on all instances of a task, in turn."""
    problems = problems_of(kind)
    first = problems[0]
    judge = placement_tasks.warm_up(first)
    runs: dict[str, Any] = {name: [] for name in methods}
    for number, problem in enumerate(problems):
        for name, method in methods.items():
            if not method.slow or number < kind.slow_instances:
                runs[name].append(solved(method, problem, budget))
        tick()
    return {
        "instances": len(problems),
        "deep": [problem.deep for problem in problems],
        "ellipsoids": len(first.task.semi_axes),
        "wanted_margin": first.wanted,
        "wanted_clearance": statistics.median(p.clearance for p in problems),
        "judge_compiled_in": judge,
        "seconds_of_mujoco": placement_mujoco.seconds(first),
        "runs": runs,
    }


def first_starts(problems: Sequence[Problem], rate: float) -> dict[str, Any]:
    """Which instances Adam solves at a rate from the first start alone."""
    found: dict[str, Any] = {"rate": rate}
    alone = [
        p._replace(starts=jax.tree.map(lambda x: x[:1], p.starts)) for p in problems
    ]
    for name, room in ROOMS.items():
        method = Method(functools.partial(by_gradient, room=room, rate=rate))
        runs = [solved(method, problem, np.inf) for problem in alone]
        found[name] = [run["solved_after"] is not None for run in runs]
    return found


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All tasks, with a progress bar."""
    failures: dict[str, str] = {}
    methods, load = available(failures), machine.OtherLoad()
    numbers: dict[str, Any] = {
        "machine": machine.describe(),
        "versions": versions(methods),
        "budget": options.budget,
        "failures": failures,
        "tasks": {},
    }
    kinds = {name: shortened(kind, options.quick) for name, kind in KINDS.items()}
    with report.progress_bar() as progress:
        for name, kind in kinds.items():
            bar = progress.add_task(name, total=kind.instances)
            tick = functools.partial(progress.advance, bar)
            numbers["tasks"][name] = judged(kind, methods, options.budget, tick)
        bar = progress.add_task("rates", total=len(RATES))
        problems, numbers["rates"] = problems_of(kinds["shelf"]), []
        for rate in RATES:
            numbers["rates"].append(first_starts(problems, rate))
            progress.advance(bar)
    return numbers | {"cores_busy_with_others": load.cores()}


def shortened(kind: Kind, quick: bool) -> Kind:
    """Three instances, if quick."""
    return kind._replace(instances=3, slow_instances=1) if quick else kind


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--budget", type=float, default=30.0, help="seconds a method and instance"
    )
    parser.add_argument(
        "--quick", action="store_true", help="3 instances, 5 s at most: a look"
    )
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the times")
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.budget = min(options.budget, 5.0)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes; in a process of one core."""
    options = parse(arguments)
    if one_core.done_by_child("benchmarks.placement", arguments):
        return
    numbers = measure(options)
    report.write(options, placement_report.text(numbers), numbers)
    if options.figure:
        placement_report.draw(numbers, options.figure)


if __name__ == "__main__":
    main()
