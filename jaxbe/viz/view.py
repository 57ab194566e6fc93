"""What to draw of a MuJoCo scene, and its colours. Plain numbers: it goes as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

Color = tuple[float, float, float, float]
Point = NDArray[np.float64]

ON_ELLIPSOID_COLOR = (0.5, 0.0, 0.0, 1.0)
ON_BOX_COLOR = (0.0, 0.1, 0.6, 1.0)
NORMAL_COLOR = (1.0, 0.9, 0.1, 1.0)


class Mark(NamedTuple):
    """A contact to draw, world frame, metres; NaN where it is not known.

    Attributes:
        distance: of the pair.
        normal: unit, from the ellipsoid to the box.
        on_ellipsoid: the witness point there.
        on_box: the witness point there.
    """

    distance: float
    normal: list[float]
    on_ellipsoid: list[float]
    on_box: list[float]

    @classmethod
    def of(cls, contact: Any) -> Self:
        """That of a `jaxbe.Contact` of one pair."""
        points = contact.normal, contact.on_ellipsoid, contact.on_box
        return cls(
            float(contact.distance), *(np.asarray(x, float).tolist() for x in points)
        )

    def known(self) -> bool:
        """Whether all its numbers are."""
        numbers = self.distance, *self.normal, *self.on_ellipsoid, *self.on_box
        return all(map(math.isfinite, numbers))

    def caption(self) -> str:
        """The distance, in words."""
        return f"distance {1000 * self.distance:.3g} mm"

    def middle(self) -> Point:
        """Half way between the witness points."""
        return np.add(self.on_ellipsoid, self.on_box) / 2

    def arrow(self, beyond: float) -> tuple[Point, Point]:
        """Start and end of an arrow along the normal, so far beyond both points."""
        half = (abs(self.distance) / 2 + beyond) * np.array(self.normal)
        return self.middle() - half, self.middle() + half


class View(NamedTuple):
    """What to draw.

    Attributes:
        scene: the model's file, .xml or .mjb.
        qpos: the state.
        pairs: geom ids [ellipsoid, box] of the pairs to colour strongly.
        focus: those of the pair to look at, too; none: the whole scene alone.
        marks: contacts to draw, in the close view if there is one.
    """

    scene: str
    qpos: list[float]
    pairs: list[list[int]]
    focus: list[int]
    marks: list[Mark]

    @classmethod
    def from_json(cls, fields: Sequence[Any]) -> Self:
        """What JSON has made lists of."""
        scene, qpos, pairs, focus, marks = fields
        return cls(scene, qpos, pairs, focus, [Mark(*mark) for mark in marks])

    def highlighted(self) -> set[int]:
        """The geoms of the pairs and of the one in focus."""
        return {geom for pair in [*self.pairs, self.focus] for geom in pair}

    def known_marks(self) -> list[Mark]:
        """The contacts that can be drawn."""
        return [mark for mark in self.marks if mark.known()]
