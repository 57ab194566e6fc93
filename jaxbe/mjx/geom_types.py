"""MuJoCo's types of geoms, in words."""

from __future__ import annotations

from typing import Any

import numpy as np

ELLIPSOID = 4
"""`mujoco.mjtGeom.mjGEOM_ELLIPSOID`."""

BOX = 6
"""`mujoco.mjtGeom.mjGEOM_BOX`."""


def a_geom(number: int) -> str:
    """For instance "an ellipsoid"."""
    name = _type_name(number)
    return f"{'an' if name[0] in 'aeiou' else 'a'} {name}"


def _type_name(number: int) -> str:
    """As in MJCF."""
    # Where there is a model there is MuJoCo.
    import mujoco

    return str(mujoco.mjtGeom(int(number)).name).removeprefix("mjGEOM_").lower()


def counts(types: Any) -> str:
    """How many there are of each: "3 boxes, 0 ellipsoids, 4 capsules"."""
    numbers, how_many = np.unique(np.asarray(types), return_counts=True)
    found = dict(zip(numbers.tolist(), how_many.tolist(), strict=True))
    found = {BOX: 0, ELLIPSOID: 0} | found
    return ", ".join(_count(n, _type_name(number)) for number, n in found.items())


def _count(n: int, name: str) -> str:
    if n == 1:
        return f"1 {name}"
    return f"{n} {name}{'es' if name[-1] in 'xh' else 's'}"
