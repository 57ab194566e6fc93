"""Interleaved medians: what to compare is run in turn, so that load hits all alike."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import machine

QUIET_CORES = 0.1
"""A round counts as quiet when other processes use no more of the machine."""

PATIENCE = 5
"""At most so many rounds are run for each that counts."""


class Task(NamedTuple):
    """Something to time.

    Attributes:
        call: returns JAX arrays (waited for) or does its work at once.
        calls: how many calls make one sample.
        pipelined: wait after the last call of a sample only. A GPU runs its queue
            in order, so that this hides the cost of launching from Python. A CPU
            may run queued calls side by side: wait after each there.
    """

    call: Callable[[], Any]
    calls: int = 1
    pipelined: bool = False


class Timing(NamedTuple):
    """Seconds a call: the median and the quartiles of the samples."""

    median: float
    lower: float
    upper: float


class Measurement(NamedTuple):
    """What `interleaved` found, and how quiet the machine was.

    Attributes:
        times: by task.
        rounds: how many were run; the quietest count.
        others: cores that other processes kept busy in the worst round that counts.
    """

    times: dict[str, Timing]
    rounds: int
    others: float


def interleaved(
    tasks: Mapping[str, Task],
    repeats: int,
    tick: Callable[[], Any] = lambda: None,
) -> Measurement:
    """Times all tasks in turn, `repeats` times over, after one call of each.

    Each round has another random order: a task's time depends on what its
    predecessor left in the caches and in the memory allocator. Rounds in which
    other processes are busy are repeated; if that takes too many, the quietest
    count. They are chosen by the load alone, never by the times.

    Args:
        tasks: by name.
        repeats: the number of rounds that count.
        tick: called after each quiet round, for a progress bar.
    """
    for task in tasks.values():
        jax.block_until_ready(task.call())
    rng = np.random.default_rng(0)
    rounds: list[tuple[float, dict[str, float]]] = []
    quiet = 0
    while quiet < repeats and len(rounds) < PATIENCE * repeats:
        others = machine.OtherLoad()
        times = {name: sample(tasks[name]) for name in rng.permutation(list(tasks))}
        rounds.append((others.cores(), times))
        if rounds[-1][0] <= QUIET_CORES:
            quiet += 1
            tick()
    kept = sorted(rounds, key=lambda r: r[0])[:repeats]
    timings = {name: _summary([times[name] for _, times in kept]) for name in tasks}
    return Measurement(timings, len(rounds), kept[-1][0])


def _summary(times: Sequence[float]) -> Timing:
    return Timing(*map(float, np.quantile(times, (0.5, 0.25, 0.75))))


def sample(task: Task) -> float:
    """Seconds a call, over one sample."""
    start = time.perf_counter()
    for _ in range(task.calls):
        result = task.call()
        if not task.pipelined:
            jax.block_until_ready(result)
    jax.block_until_ready(result)
    return (time.perf_counter() - start) / task.calls


def long_enough(task: Task, seconds: float) -> Task:
    """The task with so many calls that a sample takes about that long."""
    jax.block_until_ready(task.call())
    once = min(sample(task) for _ in range(3))
    return task._replace(calls=max(1, math.ceil(seconds / once)))


def seconds(function: Callable[[], Any]) -> tuple[Any, float]:
    """A call's result and how long it took: for what runs only once."""
    start = time.perf_counter()
    result = function()
    return result, time.perf_counter() - start
