"""What is reported, and when."""

from __future__ import annotations

import dataclasses
import time

from jaxbe.cli.crosscheck import Crosscheck
from jaxbe.cli.sweep import Sweep
from jaxbe.viz.picture import Picture


@dataclasses.dataclass
class Report:
    """All that is reported; what is not known yet is None.

    Attributes:
        labels: a name for every geom, as it is: not fit for a terminal.
        sweep: the tests on all states.
        states: how many there are to test.
        began: by `time.perf_counter`.
        seconds: wall time of the sweep, and of the comparison when that is known.
        swept: whether the sums of the sweep are whole, over some states at least.
        crosscheck: the comparison with MuJoCo C.
        picture: what was drawn, if anything.
    """

    labels: list[str]
    sweep: Sweep
    states: int
    began: float
    seconds: float = 0.0
    swept: bool = False
    crosscheck: Crosscheck | None = None
    picture: Picture | None = None

    def tick(self) -> None:
        """Something took its time."""
        self.seconds = time.perf_counter() - self.began

    def agree(self) -> bool | None:
        """Whether nothing differs beyond the tolerances; None: so far nothing does."""
        totals = self.sweep.totals
        within = totals.methods, totals.certificates, totals.signs
        if any(agreement.conflicting for agreement in within):
            return False
        if self.crosscheck is None:
            return None
        return not self.crosscheck.disagreements

    def compared(self) -> int:
        """How many pairs in states each test answered."""
        return self.sweep.totals.states * len(self.sweep.pairs.geom)

    def names(self, pair: int) -> tuple[str, str]:
        """The labels of a pair's ellipsoid and box."""
        ellipsoid, box = self.sweep.pairs.geom[pair]
        return self.labels[ellipsoid], self.labels[box]
