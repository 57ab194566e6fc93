"""jaxbe beside a hand-written C loop for the exact test, on the same arrays.

Run from the repository root:

    python -m benchmarks.against_c

Float32, as many threads as there are cores. The loop (`benchmarks/c_loop.c`) is built
with the system's compiler and reads the very arrays that JAX reads, component after
component. All run in turn (see `benchmarks.timing`), twice: as the C library's
allocator comes, which maps fresh memory for every large result so that the kernel's
page faults count, and with freed memory kept for the next call.
"""

from __future__ import annotations

import argparse
import functools
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import c_loop, layouts, machine, reference, report, scenes, timing
from benchmarks.margin_speed import keep_freed_memory, value_and_gradients

FUNCTIONS: dict[str, tuple[Callable[..., Any], dict[str, float]]] = {
    "overlap": (jaxbe.overlap, {"components": 0.5, "vmap": 0.45}),
    "margin": (jaxbe.margin, {"components": 0.15, "vmap": 0.15}),
    "margin and gradients": (
        value_and_gradients(jaxbe.margin),
        {"components": 0.08, "vmap": 0.08},
    ),
    "contact": (jaxbe.contact, {"components": 0.06, "vmap": 0.06}),
}
"""What is measured, and the share of the C loop's rate that it is meant to reach."""

WIDE = {"xla_cpu_prefer_vector_width": 512}
"""gcc fills vectors as wide as the processor's; XLA takes 256 bits if nobody asks."""

AS_IT_COMES, KEPT = "allocator as it comes", "freed memory kept"


def c_tasks(
    pairs: scenes.Scene, folder: Path, threads: Sequence[int]
) -> tuple[dict[str, timing.Task], dict[str, Any]]:
    """The loop by number of threads, and facts; no tasks where it cannot be built."""
    try:
        loop = c_loop.build(folder)
    except c_loop.BuildError as error:
        return {}, {"reason": str(error)}
    # Views of JAX's buffers: both read the same memory.
    arrays = [np.asarray(x) for x in layouts.component_arrays(pairs)]
    expected = reference.scaled_distance(pairs) <= 1
    facts = {
        "compiler": c_loop.version(c_loop.compiler()),
        "flags": " ".join(c_loop.FLAGS),
        "wrong_verdicts": int(np.sum(loop(arrays, threads[-1]) != expected)),
    }
    tasks = {
        c_name(t): timing.Task(functools.partial(loop, arrays, t)) for t in threads
    }
    return tasks, facts


def c_name(threads: int) -> str:
    """How the tables name the loop."""
    return f"C loop, {threads} thread{'s' if threads > 1 else ''}"


def jax_tasks(
    pairs: scenes.Scene, tick: Callable[[], Any]
) -> tuple[dict[str, timing.Task], dict[str, float]]:
    """The functions of jaxbe in both layouts, and the seconds each took to compile."""
    tasks, seconds = {}, {}
    for name, (function, _) in FUNCTIONS.items():
        for layout, (program, arguments) in layouts.programs(function, pairs).items():
            lowered = program.lower(*arguments)
            compiled, seconds[f"{name}, {layout}"] = timing.seconds(lowered.compile)
            call = functools.partial(compiled, *arguments)
            tasks[f"{name}, {layout}"] = timing.Task(call)
            tick()
            if layout == "vmap":
                call = functools.partial(lowered.compile(WIDE), *arguments)
                tasks[f"{name}, {layout}, 512 bits"] = timing.Task(call)
    return tasks, seconds


def measure(n: int, repeats: int, folder: Path, tick: Callable[[], Any]) -> dict:
    """Times the loop and jaxbe's functions on n float32 pairs."""
    pairs = scenes.random(n).astype(np.float32)
    threads = sorted({1, len(os.sched_getaffinity(0))})
    loops, facts = c_tasks(pairs, folder, threads)
    programs, compile_seconds = jax_tasks(pairs, tick)
    run = functools.partial(timing.interleaved, loops | programs, repeats, tick)
    passes = {AS_IT_COMES: run()}
    if keep_freed_memory():
        passes[KEPT] = run()
    return {
        "pairs": n,
        "repeats": repeats,
        "threads": threads[-1],
        "c_loop": facts,
        "compile_seconds": compile_seconds,
        "passes": {name: summary(m, n, threads[-1]) for name, m in passes.items()},
    }


def summary(measured: timing.Measurement, pairs: int, threads: int) -> dict[str, Any]:
    """Rates, and their shares of the C loop's with all threads."""
    rates = {name: pairs / t.median for name, t in measured.times.items()}
    yardstick = rates.get(c_name(threads))
    return {
        "rounds": measured.rounds,
        "cores_busy_with_others": measured.others,
        "seconds": {name: t._asdict() for name, t in measured.times.items()},
        "pairs_per_second": rates,
        "share_of_c_loop": {name: r / yardstick for name, r in rates.items()}
        if yardstick
        else {},
    }


def target(name: str) -> float | None:
    """The share that a row of the table is meant to reach."""
    function, _, layout = name.rpartition(", ")
    return FUNCTIONS[function][1][layout] if function in FUNCTIONS else None


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    facts, passes = numbers["c_loop"], numbers["passes"]
    if "reason" in facts:
        loop = f"The C loop is left out: {facts['reason']}."
    else:
        loop = (
            f"The C loop was built by {facts['compiler']} with `{facts['flags']}`; "
            f"{facts['wrong_verdicts']} of its verdicts differ from the reference's."
        )
    busy = "; ".join(
        f"{name}: {p['rounds']} rounds, others kept at most "
        f"{p['cores_busy_with_others']:.2f} cores busy in those that count"
        for name, p in passes.items()
    )
    header = ["", "target"]
    for name in passes:
        header += [f"M/s, {name}", "share"]
    rows = [_row(name, passes) for name in passes[AS_IT_COMES]["pairs_per_second"]]
    parts = [
        "# Beside a hand-written C loop",
        f"{numbers['pairs']:,} float32 pairs, {numbers['threads']} threads, medians of "
        f"{numbers['repeats']} interleaved rounds; shares are of the C loop's rate on "
        f'all threads. {loop} "512 bits": with '
        "`compiler_options={'xla_cpu_prefer_vector_width': 512}`.",
        report.table(header, rows),
        f"{busy}.",
        report.machine_lines(numbers["machine"]),
    ]
    return "\n\n".join(parts)


def _row(name: str, passes: dict[str, Any]) -> list[str]:
    wanted = target(name)
    cells = [name, f"{wanted:.2f}" if wanted else ""]
    for measured in passes.values():
        share = measured["share_of_c_loop"].get(name)
        cells += [
            f"{measured['pairs_per_second'][name] / 1e6:.1f}",
            f"{share:.2f}" if share else "",
        ]
    return cells


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="100,000 pairs and 5 repeats at most: a look, no result",
    )
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs = min(options.pairs, 100_000)
        options.repeats = min(options.repeats, 5)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    with report.progress_bar() as progress, tempfile.TemporaryDirectory() as folder:
        total = 2 * len(FUNCTIONS) + 2 * options.repeats
        bar = progress.add_task("against C", total=total)
        tick = functools.partial(progress.advance, bar)
        measured = measure(options.pairs, options.repeats, Path(folder), tick)
    numbers = {"machine": machine.describe()} | measured
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
