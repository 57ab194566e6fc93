"""Some pairs in some states, for the comparison with MuJoCo C."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxbe.cli.states import Floats


class Drawn(NamedTuple):
    """Pairs in states, one entry each.

    Attributes:
        key: (n,) the draw's order; the smallest are kept.
        state: (n,) numbers of states.
        pair: (n,) numbers of pairs.
        qpos: (n, nq).
        overlapping: (n,) the answer of Closest-Features.
        ratio: (n,) `scaled_distance`.
    """

    key: Floats
    state: NDArray[np.int64]
    pair: NDArray[np.int64]
    qpos: Floats
    overlapping: NDArray[np.bool_]
    ratio: Floats


class Sample:
    """A sample without replacement, half of it overlapping, near ones preferred.

    Pairs are weighted by 1 / |ratio - 1|: it is near touching that tests could
    differ. If there are not enough of one half the other fills up.

    Args:
        size: how many to draw.
        seed: of the draw.

    Source:
        P. Efraimidis, P. Spirakis, "Weighted random sampling with a reservoir",
        2006: the smallest of exponential numbers over weights.
    """

    def __init__(self, size: int, seed: int) -> None:
        self._size = size
        self._rng = np.random.default_rng(seed)
        self._kept: dict[bool, Drawn | None] = {True: None, False: None}

    def add(
        self,
        start: int,
        qpos: Floats,
        overlapping: NDArray[np.bool_],
        ratio: Floats,
    ) -> None:
        """Offers all pairs of a batch.

        Args:
            start: the number of the first state.
            qpos: (n, nq).
            overlapping: (n, P).
            ratio: (n, P).
        """
        keys = self._rng.exponential(size=ratio.shape) * abs(ratio - 1)
        for half in (True, False):
            rows, pairs = np.nonzero(overlapping == half)
            best = _smallest(keys[rows, pairs], self._size)
            rows, pairs = rows[best], pairs[best]
            new = Drawn(
                keys[rows, pairs],
                start + rows,
                pairs,
                qpos[rows],
                overlapping[rows, pairs],
                ratio[rows, pairs],
            )
            self._kept[half] = _merge(self._kept[half], new, self._size)

    def drawn(self) -> Drawn:
        """The sample, in the order of the states.

        Raises:
            ValueError: nothing was added.
        """
        yes, no = self._kept[True], self._kept[False]
        if yes is None or no is None:
            raise ValueError("the sample is empty: add batches first")
        n_yes = min(len(yes.key), max(self._size // 2, self._size - len(no.key)))
        both = _merge(_take(yes, slice(n_yes)), _take(no, slice(self._size - n_yes)))
        return _take(both, np.lexsort((both.pair, both.state)))


def _smallest(keys: Floats, n: int) -> NDArray[np.intp]:
    """Where the n smallest are."""
    if len(keys) <= n:
        return np.arange(len(keys))
    return np.argpartition(keys, n)[:n]


def _merge(old: Drawn | None, new: Drawn, n: int | None = None) -> Drawn:
    """Both, in the order of the keys; the first n if n is given."""
    if old is not None:
        columns: list[Any] = [np.concatenate(x) for x in zip(old, new, strict=True)]
        new = Drawn(*columns)
    return _take(new, np.argsort(new.key, kind="stable")[:n])


def _take(drawn: Drawn, which: NDArray[np.intp] | slice) -> Drawn:
    columns: list[Any] = [x[which] for x in drawn]
    return Drawn(*columns)
