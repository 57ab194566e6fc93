"""Pictures of a pair, of many bodies, of the margin in a plane, of a MuJoCo scene.

Needs the extra `viz` (matplotlib), for `render` also `mjx`; nothing else in jaxbe
imports it but the command line. Each part is loaded when it is first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxbe.viz.bodies import draw_bodies
    from jaxbe.viz.pair import draw_pair
    from jaxbe.viz.scene import render
    from jaxbe.viz.slices import draw_slice

__all__ = ["draw_bodies", "draw_pair", "draw_slice", "render"]

_HOMES = {
    "draw_bodies": "jaxbe.viz.bodies",
    "draw_pair": "jaxbe.viz.pair",
    "draw_slice": "jaxbe.viz.slices",
    "render": "jaxbe.viz.scene",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(importlib.import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        extra = "mjx" if error.name == "mujoco" else "viz"
        raise ModuleNotFoundError(
            f"jaxbe.viz.{name} needs {error.name}: pip install 'jaxbe[{extra}]'",
            name=error.name,
        ) from None
