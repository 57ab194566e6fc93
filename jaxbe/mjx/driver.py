"""MJX's private table of collision functions: found, checked, one entry added."""

from __future__ import annotations

import importlib.metadata
import re
import warnings
from typing import Any

from jaxbe.mjx.ellipsoid_box import ellipsoid_box
from jaxbe.mjx.pairs import BOX, ELLIPSOID

OLDEST, NEWEST = (3, 3, 5), (3, 17)
"""The supported versions of mujoco-mjx: `README.md` says which were tested."""

SUPPORTED = " to ".join(".".join(map(str, version)) for version in (OLDEST, NEWEST))

PAIR = (ELLIPSOID, BOX)


def register() -> None:
    """Puts jaxbe's function into the table, unless there is one for the pair.

    Raises:
        ImportError: there is no mujoco-mjx.
        RuntimeError: its version is not supported, or its table is not as expected.
    """
    table = _table()
    entry = table.get(PAIR)
    if entry is None:
        _check_version()
        table[PAIR] = ellipsoid_box
    elif entry is not ellipsoid_box:
        warnings.warn(
            "this MJX collides ellipsoids and boxes without jaxbe: its own function "
            "is left in place",
            stacklevel=2,
        )


def unregister() -> None:
    """Takes jaxbe's function out of the table; any other entry stays."""
    table = _table()
    if table.get(PAIR) is ellipsoid_box:
        del table[PAIR]


def _table() -> dict[Any, Any]:
    try:
        from mujoco.mjx._src import collision_driver
    except ModuleNotFoundError as error:
        raise ImportError("MJX is missing: pip install 'jaxbe[mjx]'") from error
    table = getattr(collision_driver, "_COLLISION_FUNC", None)
    if not isinstance(table, dict) or not _is_entry(table.get((ELLIPSOID, ELLIPSOID))):
        raise RuntimeError(
            "MJX's table of collision functions is not as jaxbe expects: "
            f"mujoco-mjx {SUPPORTED} are supported, got {_version()}"
        )
    return table


def _is_entry(function: Any) -> bool:
    return callable(function) and isinstance(getattr(function, "ncon", None), int)


def _check_version() -> None:
    version = _version()
    numbers = tuple(int(x) for x in re.findall(r"\d+", version)[:3])
    if numbers < OLDEST or numbers[:2] > NEWEST:
        raise RuntimeError(
            f"jaxbe can make mujoco-mjx {SUPPORTED} collide ellipsoids with boxes, "
            f"got {version}"
        )


def _version() -> str:
    try:
        return importlib.metadata.version("mujoco-mjx")
    except importlib.metadata.PackageNotFoundError:
        return "an unknown version"
