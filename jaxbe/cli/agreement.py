"""Do several answers about the same pairs agree, beyond rounding?"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxbe.cli.states import Floats

EXAMPLES = 100
"""So many disagreements are kept one by one."""

Flags = NDArray[np.bool_]


class Conflict(NamedTuple):
    """A pair in a state on which answers differ beyond rounding."""

    state: int
    pair: int
    scaled_distance: float
    answers: dict[str, bool]


@dataclasses.dataclass
class Agreement:
    """Sums over all pairs and states.

    Attributes:
        compared: how many pairs in states have all the answers.
        differing: on how many of them the answers differ at all.
        conflicting: on how many of these beyond rounding.
        conflicts: the first of these.
    """

    compared: int = 0
    differing: int = 0
    conflicting: int = 0
    conflicts: list[Conflict] = dataclasses.field(default_factory=list)

    def add(
        self,
        start: int,
        answers: dict[str, Flags],
        known: Flags | np.bool_,
        ratio: Floats,
        rounding: Floats,
    ) -> None:
        """Compares the answers of a batch.

        Args:
            start: the number of the first state.
            answers: whether they overlap, (n, P) by the name of each answer.
            known: (n, P) or one flag: where all of them are answers.
            ratio: (n, P) `scaled_distance`.
            rounding: (P,) how near 1 it must be for rounding to decide.
        """
        together = np.stack(list(answers.values()))
        known = np.broadcast_to(known, ratio.shape)
        differ = (together != together[0]).any(axis=0) & known
        beyond = differ & ~(abs(ratio - 1) <= rounding)
        self.compared += int(known.sum())
        self.differing += int(differ.sum())
        self.conflicting += int(beyond.sum())
        room = EXAMPLES - len(self.conflicts)
        for row, pair in np.argwhere(beyond)[:room].tolist():
            said = {name: bool(x[row, pair]) for name, x in answers.items()}
            conflict = Conflict(start + row, pair, float(ratio[row, pair]), said)
            self.conflicts.append(conflict)

    def as_object(self) -> dict[str, Any]:
        """The sums as JSON's types."""
        return {
            "compared": self.compared,
            "differing": self.differing,
            "beyond_rounding": self.conflicting,
            "examples": [conflict._asdict() for conflict in self.conflicts],
        }
