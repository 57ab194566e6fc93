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

from jaxbe.cli import picture
from jaxbe.cli.arguments import Options
from jaxbe.cli.as_object import as_json
from jaxbe.cli.as_text import crosscheck_text, picture_text, sweep_text
from jaxbe.cli.crosscheck import crosscheck
from jaxbe.cli.errors import InputError, one_line
from jaxbe.cli.memory import room_for
from jaxbe.cli.output import complain, write
from jaxbe.cli.report import Report
from jaxbe.cli.sample import Sample
from jaxbe.cli.scene import check_sizes, labels, load, pairs_of
from jaxbe.cli.states import States, random_states, states_from_file
from jaxbe.cli.sweep import Sweep, batch_size
from jaxbe.float64 import float64_allowed
from jaxbe.mjx import Pairs
from jaxbe.viz.mujoco_log import warnings_to
from jaxbe.viz.picture import Picture
from jaxbe.viz.view import Mark, View


def run(options: Options) -> bool:
    """Does everything the command line says and prints the report.

    Returns:
        Whether the tests agree with each other and with MuJoCo C.

    Raises:
        InputError: something the user can mend.
        OutputError: the report cannot be printed.
    """
    with _words_of_mujoco():
        if options.picture is not None:
            picture.check_writable(options.picture)
        model = load(options.scene)
        pairs = pairs_of(model, options.geoms)
        check_sizes(model, pairs, options.dtype)
        states = _states(model, options)
        if options.picture is not None:
            inputs = options.scene, options.qpos
            picture.check_no_input(options.picture, inputs, model)
        with float64_allowed():
            return _examine(model, pairs, states, options)


def _states(model: Any, options: Options) -> States:
    if options.qpos is not None:
        return states_from_file(model, options.qpos)
    return random_states(model, options.states, options.seed)


def _examine(model: Any, pairs: Pairs, states: States, options: Options) -> bool:
    """Sweep, comparison, picture: each is printed before the next, which may fail."""
    began = time.perf_counter()
    width = max(len(pairs), model.ngeom)
    batch = min(options.batch or batch_size(width), states.total)
    data, sample = mujoco.MjData(model), Sample(options.sample, options.seed)
    with room_for(batch, width):
        # Compiles, for some ten seconds.
        sweep = Sweep(model, pairs, options.dtype, batch, sample)
    found = Report(labels(model), sweep, states.total, began)
    with _object_at_the_end(found, options):
        with room_for(batch, width):
            _run_sweep(found, data, states, options)
        found.crosscheck = crosscheck(model, data, pairs, sample.drawn())
        found.tick()
        _print(crosscheck_text(found), options)
        if options.picture is not None:
            found.picture = _draw(model, found, options)
            _print(picture_text(found.picture), options)
    return bool(found.agree())


def _run_sweep(found: Report, data: Any, states: States, options: Options) -> None:
    """Runs the tests on all states and prints what they found, up to an error if any.

    Not up to Ctrl-C: it may come while a batch is being added.
    """
    try:
        with _progress(states.total, shown=not options.json) as advance:
            for done in found.sweep.run(data, states):
                advance(done)
    except Exception:
        _end_sweep(found, options)
        raise
    _end_sweep(found, options)


def _end_sweep(found: Report, options: Options) -> None:
    found.swept = found.sweep.totals.states > 0
    found.tick()
    if found.swept:
        _print(sweep_text(found, options), options)


def _print(text: str, options: Options) -> None:
    if not options.json:
        write(text)


@contextlib.contextmanager
def _object_at_the_end(found: Report, options: Options) -> Iterator[None]:
    """With `--json` prints all that was found, also if something fails."""
    try:
        yield
    finally:
        if options.json and found.swept:
            write(as_json(found, options) + "\n")


@contextlib.contextmanager
def _words_of_mujoco() -> Iterator[None]:
    """Its warnings on standard error, and its fatal errors as bad input.

    It calls fatal what a model asks for and cannot have, like memory.
    """
    try:
        with warnings_to(lambda text: complain(f"warning: MuJoCo: {one_line(text)}")):
            yield
    except mujoco.FatalError as error:
        raise InputError(f"MuJoCo: {error}") from None


def _draw(model: Any, found: Report, options: Options) -> Picture:
    """Draws the deepest state."""
    assert options.picture is not None
    deepest = found.sweep.deepest
    geom = found.sweep.pairs.geom
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
        disable=not (shown and sys.stderr is not None and sys.stderr.isatty()),
    )
    with bar:
        task = bar.add_task("states", total=total)
        yield lambda done: bar.update(task, completed=done)
