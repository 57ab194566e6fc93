"""MJX's private table of collision functions: found, checked, one entry added."""

from __future__ import annotations

import importlib.metadata
import inspect
import re
from typing import Any, cast

from jaxbe.mjx.ellipsoid_box import ellipsoid_box
from jaxbe.mjx.geom_types import BOX, ELLIPSOID
from jaxbe.mjx.warn import warn_caller

OLDEST, NEWEST = (3, 3, 5), (3, 17)
"""The versions of mujoco-mjx that jaxbe was tested with. Newer ones are tried."""


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


SUPPORTED = f"{_dotted(OLDEST)} to {_dotted(NEWEST)}"

PAIR = (ELLIPSOID, BOX)


def register() -> None:
    """Puts jaxbe's function into the table, unless there is one for the pair.

    Warns of a version that is newer than those tested, and where one is there.

    Raises:
        ImportError: there is no mujoco-mjx.
        RuntimeError: its version is too old, or its table is not as expected.
    """
    table = _table()
    entry = table.get(PAIR)
    if entry is None:
        _check_version()
        table[PAIR] = ellipsoid_box
    elif entry is not ellipsoid_box:
        warn_caller(
            "this MJX collides ellipsoids and boxes without jaxbe: its own function "
            "is left in place"
        )


def unregister() -> None:
    """Takes jaxbe's function out of the table; any other entry stays."""
    table = _table()
    if table.get(PAIR) is ellipsoid_box:
        del table[PAIR]


def _table() -> dict[Any, Any]:
    try:
        from mujoco.mjx._src import collision_driver, math
    except ModuleNotFoundError as error:
        raise ImportError("MJX is missing: pip install 'jaxbe[mjx]'") from error
    table = getattr(collision_driver, "_COLLISION_FUNC", None)
    if _is_known(table) and hasattr(math, "make_frame"):
        return cast(dict[Any, Any], table)
    raise RuntimeError(
        "MJX's table of collision functions is not as jaxbe expects: "
        f"mujoco-mjx {SUPPORTED} are supported, got {_version()}"
    )


def _is_known(table: Any) -> bool:
    return isinstance(table, dict) and _is_entry(table.get((ELLIPSOID, ELLIPSOID)))


def _is_entry(function: Any) -> bool:
    """Called as ours will be: with model, data, a key and the geoms."""
    try:
        inspect.signature(function).bind(*range(4))
    except (TypeError, ValueError):
        return False
    return isinstance(getattr(function, "ncon", None), int)


def _check_version() -> None:
    version = _version()
    numbers = tuple(int(x) for x in re.findall(r"\d+", version)[:3])
    if numbers < OLDEST:
        raise RuntimeError(
            f"jaxbe can make mujoco-mjx {SUPPORTED} collide ellipsoids with boxes, "
            f"got {version}"
        )
    if numbers[:2] > NEWEST:
        warn_caller(
            f"mujoco-mjx {version} is newer than {_dotted(NEWEST)}, the last that "
            "jaxbe was tested with: its table of collision functions looks as expected"
        )


def _version() -> str:
    try:
        return importlib.metadata.version("mujoco-mjx")
    except importlib.metadata.PackageNotFoundError:
        return "an unknown version"
