"""What this machine can do at best, and what share of it each function reaches.

Run from the repository root:

    python -m benchmarks.limit --throughput results/throughput-cpu.json

The machine: bytes a second of a plain copy and of a sum that only reads; arithmetic by
programs of JAX that stay in registers, one operation of each kind after another. The
functions: rates, bytes and operations as `benchmarks.throughput` found them (operations
as XLA counts them: a division or a root is one, like an addition).
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import machine, report, settings, throughput, timing

BYTES = 240_000_000
"""Read by the copy and by the sum."""

NUMBERS = 1_000_000
"""Of the arithmetic programs; what they read and write is no part of their time."""

CHAIN = 256
"""Operations after each other on each number."""

OPERATIONS: dict[str, tuple[int, Callable[[jax.Array, jax.Array], jax.Array]]] = {
    "multiply and add": (2, lambda x, y: x * y + y),
    "add": (1, lambda x, y: x + y),
    "divide and add": (2, lambda x, y: y / x + y),
    "square root and add": (2, lambda x, y: jnp.sqrt(x) + y),
}
"""By name: how many operations they are, and what they do."""


def chain(name: str) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """The operation, CHAIN times over, four chains side by side."""
    _, operation = OPERATIONS[name]

    def run(x: jax.Array, y: jax.Array) -> jax.Array:
        lanes = [x, x + 1, x + 2, x + 3]
        for _ in range(CHAIN // len(lanes)):
            lanes = [operation(lane, y) for lane in lanes]
        return functools.reduce(jnp.add, lanes)

    return jax.jit(run)


def tasks(dtype: str) -> tuple[dict[str, timing.Task], dict[str, float]]:
    """What is timed for a dtype, and how many bytes or operations each is."""
    size = np.dtype(dtype).itemsize
    source = jnp.asarray(np.random.default_rng(0).random(BYTES // size), dtype)
    total = jax.jit(jnp.sum)
    timed = {
        # The yardstick of the throughput: on a CPU into memory that is there already.
        "copy": list(throughput.copies().values())[-1],
        "read": _task(lambda: total(source)),
    }
    amounts = {"copy": 2.0 * throughput.COPY_BYTES, "read": 1.0 * BYTES}
    x = jnp.asarray(np.random.default_rng(1).uniform(0.9, 1.1, NUMBERS), dtype)
    for name, (count, _) in OPERATIONS.items():
        compiled = chain(name).lower(x, x).compile()
        timed[name] = _task(functools.partial(compiled, x, x))
        amounts[name] = float(count * CHAIN * NUMBERS)
    return timed, amounts


def _task(call: Callable[[], Any]) -> timing.Task:
    """As `benchmarks.throughput` times programs: on a GPU in a queue."""
    if not throughput.on_accelerator():
        return timing.Task(call)
    task = timing.Task(call, pipelined=True)
    return timing.long_enough(task, throughput.QUEUE_SECONDS)


def measure(repeats: int, tick: Callable[[], Any]) -> dict[str, dict[str, float]]:
    """Bytes and operations a second by dtype."""
    rates: dict[str, dict[str, float]] = {}
    for dtype in settings.DTYPES:
        timed, amounts = tasks(dtype)
        measured = timing.interleaved(timed, repeats, tick)
        rates[dtype] = {
            name: amounts[name] / time.median for name, time in measured.times.items()
        }
        rates[dtype]["cores_busy_with_others"] = measured.others
    return rates


def shares(
    rates: dict[str, dict[str, float]], measured: dict[str, Any]
) -> list[dict[str, Any]]:
    """For each program the shares of the bandwidth and of the arithmetic rate."""
    return [
        {
            "setting": p["setting"],
            "dtype": p["dtype"],
            "layout": p["layout"],
            "pairs_per_second": p["pairs_per_second"],
            "bandwidth": _share(p, "read_and_written_per_pair", rates, "copy"),
            "arithmetic": _share(p, "operations_per_pair", rates, "add"),
        }
        for p in measured["throughput"]["programs"]
    ]


def _share(
    program: dict[str, Any], amount: str, rates: dict[str, dict[str, float]], limit: str
) -> float:
    return (
        program[amount] * program["pairs_per_second"] / rates[program["dtype"]][limit]
    )


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    parts = [
        "# The machine's limits, and the shares reached",
        "Giga bytes a second of a copy (read plus written) and of a sum (read); giga "
        "operations a second of chains that stay in registers.",
        _machine_table(numbers["rates"]),
    ]
    if numbers["shares"]:
        parts += [
            "## Shares",
            "Of the copy's bandwidth: inputs read and results written. Of the rate of "
            "additions: all operations that XLA counts, divisions and roots among "
            "them. A fused kernel can do both at once; what is near one in neither "
            "column waits for divisions, roots and comparisons, or for arrays kept "
            "between its loops.",
            report.table(
                ("setting", "dtype", "layout", "M pairs/s", "bandwidth", "arithmetic"),
                [_share_row(s) for s in numbers["shares"]],
            ),
        ]
    return "\n\n".join([*parts, report.machine_lines(numbers["machine"])])


def _machine_table(rates: dict[str, dict[str, float]]) -> str:
    names = next(iter(rates.values()))
    rows = [
        (name, *(f"{rates[dtype][name] / 1e9:.1f}" for dtype in rates))
        for name in names
        if name != "cores_busy_with_others"
    ]
    busy = max(r["cores_busy_with_others"] for r in rates.values())
    table = report.table(("", *rates), rows)
    return f"{table}\n\nOthers kept at most {busy:.2f} cores busy."


def _share_row(share: dict[str, Any]) -> tuple[str, ...]:
    return (
        share["setting"],
        share["dtype"],
        share["layout"],
        f"{share['pairs_per_second'] / 1e6:.1f}",
        f"{share['bandwidth']:.2f}",
        f"{share['arithmetic']:.2f}",
    )


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--throughput", type=Path, metavar="FILE")
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument("--quick", action="store_true", help="3 repeats: no result")
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.repeats = min(options.repeats, 3)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    with report.progress_bar() as progress:
        bar = progress.add_task("limit", total=len(settings.DTYPES) * options.repeats)
        rates = measure(options.repeats, lambda: progress.advance(bar))
    measured = options.throughput and json.loads(options.throughput.read_text())
    numbers = {
        "machine": machine.describe(),
        "rates": rates,
        "shares": shares(rates, measured) if measured else [],
    }
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
