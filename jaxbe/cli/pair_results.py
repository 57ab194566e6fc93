"""What is known of each pair over the states: the columns of the report."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxbe.cli.agreement import Flags
from jaxbe.cli.states import Floats

Integers = NDArray[np.integer[Any]]


@dataclasses.dataclass
class PairResults:
    """One entry a pair. NaN, for what could not be computed, is left out.

    Attributes:
        geom: (P, 2) geom ids, [ellipsoid, box].
        overlapping: (P,) in how many states the pair overlaps.
        proved_overlapping: (P,) in how many that is certified.
        proved_separated: (P,) in how many the contrary is.
        undecided: (P,) in how many neither is.
        smallest_scaled_distance: (P,) over the states.
        smallest_distance: (P,) over the states, metres, negative where they overlap.
        smallest_margin: (P,) over the states.
        margin_sum: (P,) over the states whose margin is known.
        margins: (P,) how many these are.
    """

    geom: Integers
    overlapping: Integers
    proved_overlapping: Integers
    proved_separated: Integers
    undecided: Integers
    smallest_scaled_distance: Floats
    smallest_distance: Floats
    smallest_margin: Floats
    margin_sum: Floats
    margins: Integers

    @classmethod
    def of_no_states(cls, geom: Integers) -> PairResults:
        """Before any state was seen."""
        none, infinite = np.zeros(len(geom), np.int64), np.full(len(geom), np.inf)
        return cls(
            geom,
            overlapping=none.copy(),
            proved_overlapping=none.copy(),
            proved_separated=none.copy(),
            undecided=none.copy(),
            smallest_scaled_distance=infinite.copy(),
            smallest_distance=infinite.copy(),
            smallest_margin=infinite.copy(),
            margin_sum=np.zeros(len(geom)),
            margins=none.copy(),
        )

    def add(
        self,
        overlapping: Flags,
        verdict: Integers,
        ratio: Floats,
        distance: Floats,
        margin: Floats,
    ) -> None:
        """Adds n states: the answers, (n, P) each."""
        self.overlapping += overlapping.sum(axis=0)
        self.proved_overlapping += (verdict > 0).sum(axis=0)
        self.proved_separated += (verdict < 0).sum(axis=0)
        self.undecided += (verdict == 0).sum(axis=0)
        for smallest, values in (
            (self.smallest_scaled_distance, ratio),
            (self.smallest_distance, distance),
            (self.smallest_margin, margin),
        ):
            np.fmin(smallest, np.fmin.reduce(values), out=smallest)
        self.margin_sum += np.nansum(margin, axis=0, dtype=np.float64)
        self.margins += np.count_nonzero(~np.isnan(margin), axis=0)

    def mean_margin(self) -> Floats:
        """(P,) over the states; NaN for a pair whose margin is nowhere known."""
        return np.where(
            self.margins > 0, self.margin_sum / np.maximum(self.margins, 1), np.nan
        )
