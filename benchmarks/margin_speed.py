"""The margin's speed: its value, its gradients, what compiling costs; and coal.

Run from the repository root:

    python -m benchmarks.margin_speed

Programs run in turn on the same float32 arrays (see `benchmarks.timing`), twice: as
the C library's allocator comes, which maps fresh memory for every large result so
that the kernel's page faults count, and with freed memory kept for the next call.
Float64 on one core runs in a child process (`benchmarks.margin_one_core`).
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import machine, margin_speed_report, naive, report, scenes, timing
from jaxbe.margin import DEFAULT_STEPS

PLAIN_PAIRS = 20_000
"""Plain autodiff is so slow that it gets so many pairs only; rates are compared."""

FEW_STEPS = 3
COMPILED_PAIRS = 1000
ONE_CORE_FLAGS = (
    "--xla_cpu_multi_thread_eigen=false",
    "intra_op_parallelism_threads=1",
)

M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4
"""Parameters of the C library's `mallopt`."""

Function = Callable[..., Any]


class Program(NamedTuple):
    """A function of one pair, to be mapped over `pairs` pairs."""

    function: Function
    pairs: int


def programs(pairs: int) -> dict[str, Program]:
    """What is compared, by name."""
    few = functools.partial(jaxbe.margin, steps=FEW_STEPS)
    plain = Program(value_and_gradients(naive_minimum), min(pairs, PLAIN_PAIRS))
    return {
        "overlap": Program(jaxbe.overlap, pairs),
        f"margin, {FEW_STEPS} steps": Program(few, pairs),
        "margin": Program(jaxbe.margin, pairs),
        "margin and gradients": Program(value_and_gradients(jaxbe.margin), pairs),
        "27 candidates and gradients": plain,
    }


def value_and_gradients(function: Function) -> Function:
    """The value and its derivatives in all 30 numbers of a pair."""
    return jax.value_and_grad(function, argnums=(0, 1))


def naive_minimum(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """The quadratic that `benchmarks.naive` compares with 1; plainly differentiable."""
    k = box.axes.T @ (ellipsoid.center - box.center)
    R = box.axes.T @ ellipsoid.axes
    N = (R / (ellipsoid.semi_axes**2)[None, :]) @ R.T
    candidates = (naive.value(s, k, box.half_extents, N) for s in naive.ACTIVE_SETS)
    return functools.reduce(jnp.minimum, candidates)


def compiled_facts(program: Program, scene: scenes.Scene) -> tuple[dict[str, Any], Any]:
    """Compile time (tracing included), traffic and fusions; and the program."""
    bodies = scene.part(slice(program.pairs)).bodies()
    function = jax.jit(jax.vmap(program.function))
    lower = lambda: function.lower(*bodies).compile()  # noqa: E731
    compiled, seconds = timing.seconds(lower)
    cost = compiled.cost_analysis() or {}
    facts = {
        "pairs": program.pairs,
        "compile_seconds": seconds,
        "fusions": compiled.as_text().count(" fusion("),
        "bytes_accessed_per_pair": cost.get("bytes accessed", np.nan) / program.pairs,
    }
    return facts, functools.partial(compiled, *bodies)


def measure(pairs: int, repeats: int, tick: Callable[[], Any]) -> dict[str, Any]:
    """Compiles and times all programs, with either behaviour of the allocator."""
    scene = scenes.random(pairs).astype(np.float32)
    facts, tasks = {}, {}
    for name, program in programs(pairs).items():
        facts[name], call = compiled_facts(program, scene)
        tasks[name] = timing.Task(call)
        tick()
    passes = {"allocator as it comes": timing.interleaved(tasks, repeats, tick)}
    if keep_freed_memory():
        passes["freed memory kept"] = timing.interleaved(tasks, repeats, tick)
    return {
        "pairs": pairs,
        "repeats": repeats,
        "programs": facts,
        "passes": {name: _summary(m, facts) for name, m in passes.items()},
    }


def _summary(
    measured: timing.Measurement, facts: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    times = {
        name: t.median / facts[name]["pairs"] for name, t in measured.times.items()
    }
    return {
        "rounds": measured.rounds,
        "cores_busy_with_others": measured.others,
        "seconds": {name: t._asdict() for name, t in measured.times.items()},
        "pairs_per_second": {name: 1 / t for name, t in times.items()},
    }


def keep_freed_memory() -> bool:
    """Tells the allocator, for good, to reuse memory; whether it can (glibc only)."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(M_MMAP_MAX, 0) and mallopt(M_TRIM_THRESHOLD, 2**31 - 1))


def compile_times(tick: Callable[[], Any]) -> dict[str, float]:
    """Seconds to trace and compile value, gradients and Hessian, under vmap."""
    functions = {
        "value": jaxbe.margin,
        "gradients": value_and_gradients(jaxbe.margin),
        "hessian": jax.hessian(jaxbe.margin, argnums=(0, 1)),
    }
    scene = scenes.random(COMPILED_PAIRS).astype(np.float32)
    seconds = {}
    for name, function in functions.items():
        # A number of pairs of its own, so that no program is compiled already.
        program = Program(function, COMPILED_PAIRS - len(seconds) - 1)
        seconds[name] = compiled_facts(program, scene)[0]["compile_seconds"]
        tick()
    return seconds


def one_core(pairs: int, coal_pairs: int, repeats: int) -> dict[str, Any]:
    """What `benchmarks.margin_one_core` measures, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.margin_one_core"]
    sizes = (f"--{name}={n}" for name, n in (
        ("pairs", pairs), ("coal-pairs", coal_pairs), ("repeats", repeats),
    ))  # fmt: skip
    flags = " ".join((os.environ.get("XLA_FLAGS", ""), *ONE_CORE_FLAGS))
    environment = os.environ | {"XLA_FLAGS": flags.strip(), "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [*command, *sizes], env=environment, stdout=subprocess.PIPE, check=True
    )
    return json.loads(done.stdout)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1_000_000)
    parser.add_argument("--coal-pairs", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=21)
    report.add_output_options(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {
        "machine": machine.describe(),
        "default_steps": DEFAULT_STEPS,
        "few_steps": FEW_STEPS,
    }
    with report.progress_bar() as progress:
        total = 3 + len(programs(1)) + 2 * options.repeats
        bar = progress.add_task("float32", total=total)
        tick = functools.partial(progress.advance, bar)
        numbers["compile_seconds"] = compile_times(tick)
        numbers["float32"] = measure(options.pairs, options.repeats, tick)
    numbers["one_core"] = one_core(options.pairs, options.coal_pairs, options.repeats)
    report.write(options, margin_speed_report.text(numbers), numbers)


if __name__ == "__main__":
    main()
