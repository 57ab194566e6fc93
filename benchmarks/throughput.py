"""Pairs a second of every setting, against a naive enumeration and a plain copy.

Run from the repository root:

    python -m benchmarks.throughput

What is compared runs in turn, and the medians count, of the rounds in which no
other process disturbed (see `benchmarks.timing`). On a CPU every call is
waited for, and the yardstick is numpy copying 240 MB. On a GPU a queue of calls is
waited for at its end, so that launching from Python does not count, and the
yardstick is the device's own copy of 240 MB. A copy's bandwidth is the bytes read
plus the bytes written; a test reads 30 numbers a pair.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import (
    layouts,
    machine,
    naive,
    reference,
    report,
    scenes,
    settings,
    throughput_report,
    timing,
)

COPY_BYTES = 240_000_000
QUEUE_SECONDS = 0.05
"""A GPU's sample takes about this long."""

GROWTH_SAMPLE_SECONDS = 0.02
"""So does a sample of a small batch, whose calls take microseconds."""

TILE = 1_000_000
"""Larger batches repeat so many pairs: the programs have no branches."""


IN_COMPONENTS = tuple(
    setting
    for setting in settings.SETTINGS
    if setting.function == "overlap"
    or (setting.function in ("margin", "contact") and setting.is_default)
)
"""Measured in the layout (3, N), too."""

GROWN = tuple(
    setting
    for setting in settings.SETTINGS
    if setting.is_default
    and setting.function in ("overlap", "margin", "signed_distance", "contact")
)
"""Measured for all sizes of batches."""

NAIVE = "naive"


class Program(NamedTuple):
    """A compiled function and its arguments.

    Attributes:
        labels: setting, dtype and layout, as the report names them.
        function: the jitted function.
        arguments: on the device.
    """

    labels: dict[str, str]
    function: Callable[..., Any]
    arguments: tuple[Any, ...]

    @property
    def name(self) -> str:
        """One key for dictionaries."""
        return " ".join(self.labels.values())

    def __call__(self) -> Any:
        return self.function(*self.arguments)


def programs(pairs: scenes.Scene) -> Iterator[Program]:
    """Every setting by dtype, some by layout, and the naive test under vmap."""
    for dtype in settings.DTYPES:
        typed = scenes.Scene(*(x.astype(dtype) for x in pairs))
        bodies, turned = typed.bodies(), layouts.component_arrays(typed)
        for setting in settings.SETTINGS:
            labels = {"setting": setting.name, "dtype": dtype, "layout": "vmap"}
            yield Program(labels, settings.under_vmap(setting), bodies)
            if setting in IN_COMPONENTS:
                labels = labels | {"layout": "components"}
                function = layouts.by_components(setting.call)
                yield Program(labels, function, turned)
        labels = {"setting": NAIVE, "dtype": dtype, "layout": "vmap"}
        yield Program(labels, layouts.by_vmap(naive.overlap), bodies)


def compiled_facts(program: Program, pairs: int) -> dict[str, Any]:
    """Seconds to trace and to compile; what XLA says of the program, for a pair."""
    traced, tracing = timing.seconds(lambda: program.function.lower(*program.arguments))
    compiled, compiling = timing.seconds(traced.compile)
    cost, memory = compiled.cost_analysis() or {}, compiled.memory_analysis()
    return {
        "trace_seconds": tracing,
        "compile_seconds": compiling,
        "bytes_accessed_per_pair": cost.get("bytes accessed", float("nan")) / pairs,
        "operations_per_pair": cost.get("flops", float("nan")) / pairs,
        "read_and_written_per_pair": (
            memory.argument_size_in_bytes + memory.output_size_in_bytes
        )
        / pairs,
        "temporary_bytes_per_pair": memory.temp_size_in_bytes / pairs,
        "fusions": compiled.as_text().count(" fusion("),
    }


def copies() -> dict[str, timing.Task]:
    """The yardsticks by name; the last one counts."""
    source = np.random.default_rng(0).random(COPY_BYTES // 8)
    target = np.empty_like(source)
    tasks = {"numpy": timing.Task(lambda: np.copyto(target, source))}
    if on_accelerator():
        on_device, copy = jnp.asarray(source, jnp.float32), jax.jit(jnp.copy)
        on_device = jnp.concatenate([on_device, on_device])
        task = timing.Task(lambda: copy(on_device), pipelined=True)
        tasks["device"] = timing.long_enough(task, QUEUE_SECONDS)
    return tasks


def on_accelerator() -> bool:
    """Whether JAX computes elsewhere than on the CPU."""
    return jax.default_backend() != "cpu"


def measure(n: int, repeats: int, tick: Callable[[], Any]) -> dict[str, Any]:
    """Times all programs on n pairs, in turn with the copies.

    Args:
        n: the number of pairs.
        repeats: the number of rounds.
        tick: called after each compilation and each round.

    Returns:
        `copy_bandwidth` in bytes/s by name, `yardstick`, the name of the one that
        counts, and `programs`: one dictionary of numbers each.
    """
    pairs = scenes.random(n)
    expected = reference.scaled_distance(pairs) <= 1
    entries, tasks = {}, {}
    for program in programs(pairs):
        facts = compiled_facts(program, n)
        entries[program.name] = program.labels | facts | _wrong(program, expected)
        tasks[program.name] = _task(program)
        tick()
    yardsticks = copies()
    times, rounds, others = timing.interleaved(tasks | yardsticks, repeats, tick)
    bandwidth = {name: 2 * COPY_BYTES / times[name].median for name in yardsticks}
    yardstick = list(yardsticks)[-1]
    for name, entry in entries.items():
        baseline = times[f"{NAIVE} {entry['dtype']} vmap"].median
        entry["times_naive"] = baseline / times[name].median
        entry |= _rates(n, entry, times[name], bandwidth[yardstick])
    return {
        "pairs": n,
        "repeats": repeats,
        "rounds": rounds,
        "cores_busy_with_others": others,
        "copy_bandwidth": bandwidth,
        "yardstick": yardstick,
        "programs": list(entries.values()),
    }


def _wrong(program: Program, expected: np.ndarray) -> dict[str, int]:
    """How many verdicts are wrong, of a program that gives bools."""
    found = jax.tree.leaves(program())[0]
    if not jnp.issubdtype(found.dtype, bool):
        return {}
    return {"wrong_verdicts": int(np.sum(np.asarray(found) != expected))}


def _task(program: Program) -> timing.Task:
    task = timing.Task(program, pipelined=on_accelerator())
    return timing.long_enough(task, QUEUE_SECONDS) if on_accelerator() else task


def _rates(
    n: int, entry: dict[str, Any], time: timing.Timing, bandwidth: float
) -> dict[str, Any]:
    moved = entry["read_and_written_per_pair"]
    return {
        "seconds": time._asdict(),
        "pairs_per_second": n / time.median,
        "share_of_copy": n * moved / time.median / bandwidth,
    }


def measure_growth(
    sizes: Sequence[int], repeats: int, tick: Callable[[], Any]
) -> list[dict[str, Any]]:
    """Times some settings on so many float32 pairs each, a call at a time."""
    pool = scenes.random(min(max(sizes), TILE)).astype(np.float32)
    points = []
    for n in sizes:
        bodies = scenes.Scene(*(np.resize(x, (n, *x.shape[1:])) for x in pool)).bodies()
        tasks = {s.name: _growth_task(s, bodies) for s in GROWN}
        times, _, others = timing.interleaved(tasks, repeats)
        points += [
            {
                "pairs": n,
                "setting": name,
                "seconds": t._asdict(),
                "cores_busy_with_others": others,
            }
            for name, t in times.items()
        ]
        tick()
    return points


def _growth_task(setting: settings.Setting, bodies: tuple[Any, ...]) -> timing.Task:
    call = functools.partial(settings.under_vmap(setting), *bodies)
    return timing.long_enough(timing.Task(call), GROWTH_SAMPLE_SECONDS)


def _powers_of_ten(largest: int) -> list[int]:
    return [10**p for p in range(len(str(largest)))]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1_000_000)
    parser.add_argument(
        "--largest",
        type=int,
        default=10_000_000,
        metavar="PAIRS",
        help="the largest batch of the growth table",
    )
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="100,000 pairs at most and 5 repeats: a look, no result",
    )
    report.add_output_options(parser)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw both tables")
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs = min(options.pairs, 100_000)
        options.largest = min(options.largest, 100_000)
        options.repeats = min(options.repeats, 5)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {"machine": machine.describe()}
    with report.progress_bar() as progress:
        count = len(settings.SETTINGS) + len(IN_COMPONENTS) + 1
        steps = len(settings.DTYPES) * count + options.repeats
        bar = progress.add_task("throughput", total=steps)
        numbers["throughput"] = measure(
            options.pairs, options.repeats, lambda: progress.advance(bar)
        )
        bar = progress.add_task("growth", total=len(_powers_of_ten(options.largest)))
        numbers["growth"] = measure_growth(
            _powers_of_ten(options.largest),
            options.repeats,
            lambda: progress.advance(bar),
        )
    report.write(options, throughput_report.text(numbers), numbers)
    if options.figure:
        throughput_report.draw(numbers, options.figure)


if __name__ == "__main__":
    main()
