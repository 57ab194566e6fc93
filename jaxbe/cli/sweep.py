"""The three tests on all pairs in all states, a batch at a time."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from jaxbe import METHODS, Box, Ellipsoid, margin, overlap, scaled_distance
from jaxbe.cli.rounding import ratio_rounding
from jaxbe.cli.sample import Sample
from jaxbe.cli.states import Floats, Poses, States, forward_kinematics
from jaxbe.mjx import Pairs, gather

PAIRS_PER_BATCH = 250_000
"""Pairs and states at a time unless the user says otherwise: some 50 MB."""

EXAMPLES = 100
"""So many disagreements between the tests are kept one by one."""

Flags = NDArray[np.bool_]


class Tests(NamedTuple):
    """The compiled programs for one shape of batch.

    Attributes:
        gather: from poses to boxes and ellipsoids.
        overlap: the test of each method.
        scaled_distance: for the comparisons, not timed.
        margin: for the report, not timed.
        compile_seconds: of the test of each method.
    """

    gather: Callable[[Poses], tuple[Box, Ellipsoid]]
    overlap: dict[str, Callable[[Box, Ellipsoid], jax.Array]]
    scaled_distance: Callable[[Box, Ellipsoid], jax.Array]
    margin: Callable[[Box, Ellipsoid], jax.Array]
    compile_seconds: dict[str, float]


@dataclasses.dataclass
class PairResults:
    """What is known of each pair: one entry a pair, a column of the report each.

    Attributes:
        geom: (P, 2) geom ids, [ellipsoid, box].
        overlapping: (P,) in how many states the pair overlaps.
        smallest_scaled_distance: (P,) over the states.
        smallest_margin: (P,) over the states.
        margin_sum: (P,) over the states whose margin is known.
        margins: (P,) how many these are.
    """

    geom: NDArray[np.integer[Any]]
    overlapping: NDArray[np.int64]
    smallest_scaled_distance: Floats
    smallest_margin: Floats
    margin_sum: Floats
    margins: NDArray[np.int64]

    def mean_margin(self) -> Floats:
        """(P,) over the states; NaN for a pair whose margin is nowhere known."""
        return np.where(
            self.margins > 0, self.margin_sum / np.maximum(self.margins, 1), np.nan
        )


class Deepest(NamedTuple):
    """The state with the smallest margin of all, and what overlaps there.

    Attributes:
        state: its number.
        qpos: (nq,).
        pair: the pair with the smallest margin.
        margin: of that pair.
        overlapping: (P,) which pairs overlap.
    """

    state: int
    qpos: Floats
    pair: int
    margin: float
    overlapping: Flags


class Conflict(NamedTuple):
    """A pair in a state on which the three tests differ beyond rounding."""

    state: int
    pair: int
    scaled_distance: float
    answers: dict[str, bool]


@dataclasses.dataclass
class Totals:
    """Sums over all pairs and states.

    Attributes:
        states: how many there were.
        states_overlapping: in how many of them some pair overlaps.
        overlapping: how many pairs in states overlap, by each method.
        differing: on how many the three tests differ at all.
        conflicting: on how many of them beyond rounding.
        conflicts: the first of these.
        kinematics_seconds: forward kinematics, with drawing or reading states.
        gather_seconds: from poses to boxes and ellipsoids.
        test_seconds: of each method, on the device.
    """

    states: int = 0
    states_overlapping: int = 0
    overlapping: dict[str, int] = dataclasses.field(
        default_factory=lambda: dict.fromkeys(METHODS, 0)
    )
    differing: int = 0
    conflicting: int = 0
    conflicts: list[Conflict] = dataclasses.field(default_factory=list)
    kinematics_seconds: float = 0.0
    gather_seconds: float = 0.0
    test_seconds: dict[str, float] = dataclasses.field(
        default_factory=lambda: dict.fromkeys(METHODS, 0.0)
    )


class Batch(NamedTuple):
    """The answers for n states, P pairs each.

    Attributes:
        start: the number of the first state.
        qpos: (n, nq).
        overlapping: (n, P) by each method.
        ratio: (n, P), `scaled_distance`.
        margin: (n, P).
    """

    start: int
    qpos: Floats
    overlapping: dict[str, Flags]
    ratio: Floats
    margin: Floats


class Sweep:
    """Runs the tests and keeps sums, so that memory does not grow with the states.

    Args:
        model: a `mujoco.MjModel`.
        pairs: of the model.
        dtype: what the tests compute in.
        batch: states at a time; the last batch is padded, so that all have one
            shape and each test is compiled once.
        sample: keeps some pairs in states for later.
    """

    def __init__(
        self, model: Any, pairs: Pairs, dtype: str, batch: int, sample: Sample
    ) -> None:
        self.totals = Totals()
        self.pairs = PairResults(
            pairs.geom,
            np.zeros(len(pairs), np.int64),
            np.full(len(pairs), np.inf),
            np.full(len(pairs), np.inf),
            np.zeros(len(pairs)),
            np.zeros(len(pairs), np.int64),
        )
        self.deepest = Deepest(0, model.qpos0, 0, np.inf, np.zeros(len(pairs), bool))
        self.sample = sample
        self._batch = batch
        self._model = model
        self._poses = initial_poses(model, batch, dtype)
        self.tests = compile_tests(pairs, model, self._poses)
        ellipsoid, box = (model.geom_size[pairs.geom[:, i]] for i in range(2))
        self._rounding = ratio_rounding(box, ellipsoid, dtype)

    def run(self, data: Any, states: States) -> Iterator[int]:
        """Does the work; yields how many states are done after every batch.

        Args:
            data: a `mujoco.MjData`, overwritten.
            states: of the model.

        Raises:
            InputError: poses that are not finite.
        """
        for start in range(0, states.total, self._batch):
            stop = min(start + self._batch, states.total)
            began = time.perf_counter()
            qpos = states.rows(start, stop)
            forward_kinematics(self._model, data, qpos, self._poses)
            self.totals.kinematics_seconds += time.perf_counter() - began
            self._add(self._test(start, qpos))
            yield stop

    def _test(self, start: int, qpos: Floats) -> Batch:
        """Tests the poses; leaves out the padding behind the last state."""
        n = len(qpos)
        (box, ellipsoid), seconds = _timed(self.tests.gather, self._poses)
        self.totals.gather_seconds += seconds
        overlapping = {}
        for method, test in self.tests.overlap.items():
            answer, seconds = _timed(test, box, ellipsoid)
            self.totals.test_seconds[method] += seconds
            overlapping[method] = np.asarray(answer)[:n]
        ratio = np.asarray(self.tests.scaled_distance(box, ellipsoid))[:n]
        margins = np.asarray(self.tests.margin(box, ellipsoid))[:n]
        return Batch(start, qpos, overlapping, ratio, margins)

    def _add(self, batch: Batch) -> None:
        overlapping = batch.overlapping[METHODS[0]]
        self.totals.states += len(overlapping)
        self.totals.states_overlapping += int(overlapping.any(axis=1).sum())
        for method, answers in batch.overlapping.items():
            self.totals.overlapping[method] += int(answers.sum())
        self.pairs.overlapping += overlapping.sum(axis=0)
        nearest = np.fmin.reduce(batch.ratio, axis=0)
        smallest = self.pairs.smallest_scaled_distance
        self.pairs.smallest_scaled_distance = np.fmin(smallest, nearest)
        self._add_margins(batch.margin)
        self._compare(batch)
        self._keep_deepest(batch)
        self.sample.add(batch.start, batch.qpos, overlapping, batch.ratio)

    def _add_margins(self, margins: Floats) -> None:
        pairs = self.pairs
        pairs.smallest_margin = np.fmin(pairs.smallest_margin, np.fmin.reduce(margins))
        pairs.margin_sum += np.nansum(margins, axis=0, dtype=np.float64)
        pairs.margins += np.count_nonzero(~np.isnan(margins), axis=0)

    def _compare(self, batch: Batch) -> None:
        answers = np.stack(list(batch.overlapping.values()))
        differ = (answers != answers[0]).any(axis=0)
        self.totals.differing += int(differ.sum())
        beyond = differ & ~(abs(batch.ratio - 1) <= self._rounding)
        self.totals.conflicting += int(beyond.sum())
        room = EXAMPLES - len(self.totals.conflicts)
        for row, pair in np.argwhere(beyond)[:room].tolist():
            by_method = {m: bool(x[row, pair]) for m, x in batch.overlapping.items()}
            ratio = float(batch.ratio[row, pair])
            conflict = Conflict(batch.start + row, pair, ratio, by_method)
            self.totals.conflicts.append(conflict)

    def _keep_deepest(self, batch: Batch) -> None:
        known = np.where(np.isnan(batch.margin), np.inf, batch.margin)
        row, pair = np.unravel_index(np.argmin(known), known.shape)
        deepest = float(known[row, pair])
        if deepest < self.deepest.margin:
            self.deepest = Deepest(
                batch.start + int(row),
                batch.qpos[row],
                int(pair),
                deepest,
                batch.overlapping[METHODS[0]][row],
            )


def batch_size(pairs: int, geoms: int) -> int:
    """States at a time, by the larger of the pairs and the geoms of a state."""
    return max(1, PAIRS_PER_BATCH // max(pairs, geoms))


def initial_poses(model: Any, batch: int, dtype: str) -> Poses:
    """Legal poses to be overwritten: all geoms at the origin, along the axes."""
    identity = np.eye(3, dtype=dtype).ravel()
    return Poses(
        np.zeros((batch, model.ngeom, 3), dtype),
        np.tile(identity, (batch, model.ngeom, 1)),
    )


def compile_tests(pairs: Pairs, model: Any, poses: Poses) -> Tests:
    """Compiles everything for the shape of these poses."""

    def gather_pairs(poses: Poses) -> tuple[Box, Ellipsoid]:
        return gather(pairs, model, poses)

    gathering = jax.jit(gather_pairs).lower(poses).compile()
    bodies = gathering(poses)
    seconds: dict[str, float] = {}
    tests: dict[str, Callable[[Box, Ellipsoid], jax.Array]] = {}
    for method in METHODS:
        test = jax.jit(functools.partial(overlap, method=method))
        began = time.perf_counter()
        tests[method] = test.lower(*bodies).compile()
        seconds[method] = time.perf_counter() - began
        _timed(tests[method], *bodies)  # The first call also loads the program.
    distance = jax.jit(scaled_distance).lower(*bodies).compile()
    margins = jax.jit(margin).lower(*bodies).compile()
    return Tests(gathering, tests, distance, margins, seconds)


def _timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    began = time.perf_counter()
    result = jax.block_until_ready(function(*arguments))  # type: ignore[no-untyped-call]
    return result, time.perf_counter() - began
