"""A picture of one state: rendered by MuJoCo, or plotted where OpenGL is missing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any, NamedTuple

from jaxbe.viz.view import View

RENDER_SECONDS = 120
"""A rendering that takes longer is given up."""

REASON_WIDTH = 120
"""Longer reasons are cut."""


class Picture(NamedTuple):
    """What was drawn.

    Attributes:
        path: the file.
        drawn_by: MuJoCo and its OpenGL, or matplotlib.
        why: why MuJoCo could not, if it could not.
    """

    path: str
    drawn_by: str
    why: str


def draw(model: Any, view: View, path: Path) -> Picture:
    """Draws a state.

    Args:
        model: the `mujoco.MjModel`.
        view: what to draw.
        path: the PNG file to write.

    Returns:
        What was drawn, and by what.

    Raises:
        ModuleNotFoundError: neither OpenGL nor matplotlib is there.
    """
    failures = []
    for backend in _backends():
        failure = _render(view, path, backend)
        if failure is None:
            return Picture(str(path), f"MuJoCo ({backend or 'default OpenGL'})", "")
        failures.append(f"{backend or 'default OpenGL'}: {failure}")
    why = "MuJoCo could not render: " + "; ".join(failures)
    try:
        from jaxbe.viz.plot import plot
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"no picture: {why}; and no {error.name}: pip install 'jaxbe[viz]'",
            name=error.name,
        ) from None
    plot(model, view, path)
    return Picture(str(path), "matplotlib", why)


def _backends() -> list[str]:
    """Values of MUJOCO_GL to try: the user's own, or those that need no screen."""
    if "MUJOCO_GL" in os.environ:
        return [os.environ["MUJOCO_GL"]]
    return ["egl", "osmesa"] if sys.platform == "linux" else [""]


def _search_path() -> str:
    """PYTHONPATH with this package, and without relative entries.

    To Python they, and empty ones, are of the current folder, where a `mujoco.py` may
    lie beside a scene.
    """
    given = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    absolute = filter(os.path.isabs, given)
    return os.pathsep.join([str(Path(__file__).parents[2]), *absolute])


def _render(view: View, path: Path, backend: str) -> str | None:
    """Renders in a process of its own; returns what went wrong, if anything.

    With MUJOCO_GL set and its library missing, even `import mujoco` fails; and a
    broken driver may crash or hang.
    """
    environment = os.environ | {"MUJOCO_GL": backend, "PYTHONPATH": _search_path()}
    try:
        child = subprocess.run(
            # -P: else Python looks for modules in the current folder first.
            [sys.executable, "-P", "-m", "jaxbe.viz.offscreen", str(path)],
            input=json.dumps(view),
            env=environment,
            capture_output=True,
            encoding="utf-8",
            errors="backslashreplace",
            timeout=RENDER_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {RENDER_SECONDS} s"
    if child.returncode == 0:
        return None
    lines = child.stderr.strip().splitlines()
    reason = lines[-1] if lines else f"exit status {child.returncode}"
    return textwrap.shorten(reason, REASON_WIDTH, placeholder=" ...")
