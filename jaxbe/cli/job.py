"""The run: scene, states, tests, comparison, picture, report."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Any

import mujoco
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from jaxbe.cli import picture, report
from jaxbe.cli.arguments import Options
from jaxbe.cli.crosscheck import crosscheck
from jaxbe.cli.report import Report
from jaxbe.cli.sample import Sample
from jaxbe.cli.scene import labels, load, pairs_of
from jaxbe.cli.states import States, random_states, states_from_file
from jaxbe.cli.sweep import Sweep, batch_size
from jaxbe.float64 import float64_allowed
from jaxbe.mjx import Pairs
from jaxbe.viz.picture import Picture
from jaxbe.viz.view import Mark, View


def run(options: Options) -> bool:
    """Does everything the command line says and prints the report.

    Returns:
        Whether the tests agree with each other and with MuJoCo C.

    Raises:
        InputError: something the user can mend.
    """
    if options.picture is not None:
        picture.check_writable(options.picture)
    model = load(options.scene)
    pairs = pairs_of(model, options.geoms)
    states = _states(model, options)
    with float64_allowed():
        result = _examine(model, pairs, states, options)
    try:
        if options.picture is not None:
            result.picture = _draw(model, result, options)
    finally:
        report.show(result, options)
    return result.agree()


def _states(model: Any, options: Options) -> States:
    if options.qpos is not None:
        return states_from_file(model, options.qpos)
    return random_states(model, options.states, options.seed)


def _examine(model: Any, pairs: Pairs, states: States, options: Options) -> Report:
    """Runs the tests on all states, then the comparison with MuJoCo C."""
    began = time.perf_counter()
    data = mujoco.MjData(model)
    batch = options.batch or batch_size(len(pairs), model.ngeom)
    sample = Sample(options.sample, options.seed)
    with _progress(states.total, shown=not options.json) as advance:
        # Compiles, for some ten seconds.
        sweep = Sweep(model, pairs, options.dtype, min(batch, states.total), sample)
        for done in sweep.run(data, states):
            advance(done)
    return Report(
        labels=labels(model),
        sweep=sweep,
        crosscheck=crosscheck(model, data, pairs, sample.drawn()),
        seconds=time.perf_counter() - began,
    )


def _draw(model: Any, result: Report, options: Options) -> Picture:
    """Draws the deepest state."""
    assert options.picture is not None
    deepest = result.sweep.deepest
    geom = result.sweep.pairs.geom
    view = View(
        scene=str(options.scene),
        qpos=deepest.qpos.tolist(),
        pairs=geom[deepest.overlapping].tolist(),
        focus=geom[deepest.pair].tolist(),
        marks=[Mark.of(deepest.contact)],
    )
    return picture.draw(model, view, options.picture)


@contextlib.contextmanager
def _progress(total: int, *, shown: bool) -> Iterator[Any]:
    """A bar on standard error, where that is a terminal."""
    bar = Progress(
        TextColumn("states"),
        BarColumn(),
        MofNCompleteColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not (shown and sys.stderr.isatty()),
    )
    with bar:
        task = bar.add_task("states", total=total)
        yield lambda done: bar.update(task, completed=done)
