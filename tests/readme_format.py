"""How the README writes figures: in digits, or in words that are about right."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

WORDS = {
    "a fiftieth": 1 / 50,
    "a tenth": 1 / 10,
    "a sixth": 1 / 6,
    "a fifth": 1 / 5,
    "a quarter": 1 / 4,
    "a third": 1 / 3,
    "half": 1 / 2,
    "twice": 2,
    "four times": 4,
    "five times": 5,
    "six times": 6,
}
NUMBERS = (
    "no",
    "one",
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
)


class About(NamedTuple):
    """A figure in words or round numbers, right to a sixth."""

    value: float

    def __eq__(self, figure: object) -> bool:
        """Whether the words mean this."""
        try:
            read = WORDS.get(str(figure)) or float(str(figure))
        except ValueError:
            return False
        return abs(read / self.value - 1) < 1 / 6

    def __str__(self) -> str:
        return f"[about {self.value:.3g}]"


def millions(rate: float) -> str:
    """Pairs a second in millions, two digits or more."""
    return f"{rate / 1e6:.0f}" if rate >= 9.95e6 else f"{rate / 1e6:.2g}"


def power(x: float) -> str:
    """One digit: 7e-7."""
    return re.sub(r"e([+-])0*(\d+)", r"e\1\2", f"{x:.0e}").replace("e+0", "")


def ceiling(x: float) -> str:
    """What x is at most, with two digits: 5.1e-7."""
    unit = 10.0 ** (math.floor(math.log10(x)) - 1)
    digits = math.ceil(x / unit - 1e-9)
    return re.sub(r"e-0*", "e-", f"{digits * unit:.1e}")


def percent(share: float) -> str:
    """Two digits from one per cent on, below that one."""
    x = 100 * share
    return f"{x:.2g} %" if x >= 1 else f"{x:.1g} %" if x else "none"


def none(count: int) -> str:
    """The word for 0."""
    return f"{count:,}" if count else "none"


def only(rows: Sequence[dict[str, Any]], **what: Any) -> dict[str, Any]:
    """The one row that has these values."""
    (row,) = (r for r in rows if all(r[k] == v for k, v in what.items()))
    return row
