"""The tests, distances and certificates of all pairs in all states, by batches."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbe import (
    METHODS,
    Box,
    Contact,
    Ellipsoid,
    certify,
    contact,
    margin,
    overlap,
    scaled_distance,
)
from jaxbe.cli.agreement import Agreement, Flags
from jaxbe.cli.pair_results import Integers, PairResults
from jaxbe.cli.rounding import ratio_rounding
from jaxbe.cli.sample import Sample
from jaxbe.cli.states import Floats, Poses, States, forward_kinematics
from jaxbe.mjx import Pairs, gather

PAIRS_PER_BATCH = 250_000
"""Pairs and states at a time unless the user says otherwise: some 100 MB."""

_NOWHERE: Any = np.full(3, np.nan)
NO_CONTACT = Contact(_NOWHERE[0], _NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE)


class Tests(NamedTuple):
    """The compiled programs for one shape of batch.

    Attributes:
        gather: from poses to boxes and ellipsoids.
        timed: the test of each method, "contact" and "certify" (its verdict).
        scaled_distance: for the comparisons, not timed.
        margin: for the report, not timed.
        compile_seconds: of those timed.
    """

    gather: Callable[[Poses], tuple[Box, Ellipsoid]]
    timed: dict[str, Callable[[Box, Ellipsoid], Any]]
    scaled_distance: Callable[[Box, Ellipsoid], jax.Array]
    margin: Callable[[Box, Ellipsoid], jax.Array]
    compile_seconds: dict[str, float]


class Deepest(NamedTuple):
    """The state with the smallest margin of all, and what overlaps there.

    Attributes:
        state: its number.
        qpos: (nq,).
        pair: the pair with the smallest margin.
        margin: of that pair.
        contact: of that pair.
        overlapping: (P,) which pairs overlap.
    """

    state: int
    qpos: Floats
    pair: int
    margin: float
    contact: Contact
    overlapping: Flags


@dataclasses.dataclass
class Totals:
    """Sums over all pairs and states.

    Attributes:
        states: how many there were.
        states_overlapping: in how many of them some pair overlaps.
        overlapping: how many pairs in states overlap, by each method.
        methods: agreement of the three tests.
        certificates: of the certified verdicts with the tests.
        signs: of the signed distance's sign with the tests.
        seconds: of each program, on the device, and of the forward kinematics,
            with drawing or reading states.
    """

    states: int = 0
    states_overlapping: int = 0
    overlapping: dict[str, int] = dataclasses.field(
        default_factory=lambda: dict.fromkeys(METHODS, 0)
    )
    methods: Agreement = dataclasses.field(default_factory=Agreement)
    certificates: Agreement = dataclasses.field(default_factory=Agreement)
    signs: Agreement = dataclasses.field(default_factory=Agreement)
    seconds: dict[str, float] = dataclasses.field(
        default_factory=lambda: dict.fromkeys(
            ("kinematics", "gather", *METHODS, "contact", "certify"), 0.0
        )
    )


class Batch(NamedTuple):
    """The answers for n states, P pairs each.

    Attributes:
        start: the number of the first state.
        qpos: (n, nq).
        overlapping: (n, P) by each method.
        contact: of n times P pairs.
        verdict: (n, P), that of `certify`.
        ratio: (n, P), `scaled_distance`.
        margin: (n, P).
    """

    start: int
    qpos: Floats
    overlapping: dict[str, Flags]
    contact: Contact
    verdict: Integers
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
        self.pairs = PairResults.of_no_states(pairs.geom)
        self.deepest = Deepest(
            0, model.qpos0, 0, np.inf, NO_CONTACT, np.zeros(len(pairs), bool)
        )
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
            self.totals.seconds["kinematics"] += time.perf_counter() - began
            self._add(self._test(start, qpos))
            yield stop

    def _test(self, start: int, qpos: Floats) -> Batch:
        """Tests the poses; leaves out the padding behind the last state."""
        bodies = self._timed("gather", self.tests.gather, self._poses)
        answers = {
            name: self._timed(name, program, *bodies)
            for name, program in self.tests.timed.items()
        }
        answers["ratio"] = self.tests.scaled_distance(*bodies)
        answers["margin"] = self.tests.margin(*bodies)
        answers = jax.tree.map(lambda x: np.asarray(x)[: len(qpos)], answers)
        overlapping: dict[str, Flags] = {m: answers.pop(m) for m in METHODS}
        verdict = answers.pop("certify")
        return Batch(start, qpos, overlapping, verdict=verdict, **answers)

    def _timed(self, name: str, program: Callable[..., Any], *arguments: Any) -> Any:
        result, seconds = _timed(program, *arguments)
        self.totals.seconds[name] += seconds
        return result

    def _add(self, batch: Batch) -> None:
        overlapping = batch.overlapping[METHODS[0]]
        self.totals.states += len(overlapping)
        self.totals.states_overlapping += int(overlapping.any(axis=1).sum())
        for method, answers in batch.overlapping.items():
            self.totals.overlapping[method] += int(answers.sum())
        self.pairs.add(
            overlapping,
            batch.verdict,
            batch.ratio,
            np.asarray(batch.contact.distance),
            batch.margin,
        )
        self._compare(batch)
        self._keep_deepest(batch)
        self.sample.add(batch.start, batch.qpos, overlapping, batch.ratio)

    def _compare(self, batch: Batch) -> None:
        """A pair that no test could decide counts as overlapping: no statement."""
        tests, ratio = batch.overlapping, batch.ratio
        verdict, distance = batch.verdict, np.asarray(batch.contact.distance)
        stated = ~np.isnan(ratio)
        for agreement, also, known in (
            (self.totals.methods, {}, np.True_),
            (
                self.totals.certificates,
                {"certificate": verdict > 0},
                stated & (verdict != 0),
            ),
            (
                self.totals.signs,
                {"signed_distance": distance <= 0},
                stated & ~np.isnan(distance),
            ),
        ):
            agreement.add(batch.start, tests | also, known, ratio, self._rounding)

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
                Contact(*(x[row, pair] for x in batch.contact)),
                batch.overlapping[METHODS[0]][row],
            )


def batch_size(width: int) -> int:
    """States at a time, by the pairs or the geoms of a state, whichever are more."""
    return max(1, PAIRS_PER_BATCH // width)


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

    def verdict(box: Box, ellipsoid: Ellipsoid) -> jax.Array:
        return certify(box, ellipsoid).verdict

    gathering = jax.jit(gather_pairs).lower(poses).compile()
    bodies = gathering(poses)
    programs: dict[str, Callable[[Box, Ellipsoid], Any]] = {
        **{method: functools.partial(overlap, method=method) for method in METHODS},
        "contact": contact,
        "certify": verdict,
    }
    seconds: dict[str, float] = {}
    for name, program in programs.items():
        lowered = jax.jit(program).lower
        began = time.perf_counter()
        programs[name] = lowered(*bodies).compile()
        seconds[name] = time.perf_counter() - began
        _timed(programs[name], *bodies)  # The first call also loads the program.
    ratio = jax.jit(scaled_distance).lower(*bodies).compile()
    margins = jax.jit(margin).lower(*bodies).compile()
    return Tests(gathering, programs, ratio, margins, seconds)


def _timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    began = time.perf_counter()
    result = jax.block_until_ready(function(*arguments))  # type: ignore[no-untyped-call]
    return result, time.perf_counter() - began
