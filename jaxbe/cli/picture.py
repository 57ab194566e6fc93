"""A picture of one state: rendered by MuJoCo, or plotted where OpenGL is missing."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxbe.cli.errors import InputError

Color = tuple[float, float, float, float]
Point = NDArray[np.float64]

ON_ELLIPSOID_COLOR = (0.5, 0.0, 0.0, 1.0)
ON_BOX_COLOR = (0.0, 0.1, 0.6, 1.0)
NORMAL_COLOR = (1.0, 0.9, 0.1, 1.0)

RENDER_SECONDS = 120
"""A rendering that takes longer is given up."""

REASON_WIDTH = 120
"""Longer reasons are cut."""


class View(NamedTuple):
    """What to draw.

    Attributes:
        scene: the model's file.
        qpos: the state.
        overlapping: geom ids [ellipsoid, box] of the pairs that overlap.
        focus: those of the pair to look at.
        distance: of this pair, metres; NaN, as what follows, if it is not known.
        normal: unit, from its ellipsoid to its box, world frame.
        on_ellipsoid: its witness point there, world frame, metres.
        on_box: its witness point there.
    """

    scene: str
    qpos: list[float]
    overlapping: list[list[int]]
    focus: list[int]
    distance: float
    normal: list[float]
    on_ellipsoid: list[float]
    on_box: list[float]

    def has_contact(self) -> bool:
        """Whether distance, normal and points are known."""
        numbers = self.distance, *self.normal, *self.on_ellipsoid, *self.on_box
        return all(map(math.isfinite, numbers))

    def caption(self) -> str:
        """The distance, in words."""
        return f"distance {1000 * self.distance:.3g} mm"

    def arrow(self, beyond: float) -> tuple[Point, Point]:
        """Start and end of an arrow along the normal, so far beyond both points."""
        middle = np.add(self.on_ellipsoid, self.on_box) / 2
        half = (abs(self.distance) / 2 + beyond) * np.array(self.normal)
        return middle - half, middle + half

    def pairs(self) -> list[list[int]]:
        """The pairs to colour strongly."""
        return [*self.overlapping, self.focus]

    def highlighted(self) -> set[int]:
        """The geoms of these pairs."""
        return {geom for pair in self.pairs() for geom in pair}


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


def check_writable(path: Path) -> None:
    """Checks that a file can be written, before anything takes long.

    Raises:
        InputError: it cannot.
    """
    existed = path.exists()
    try:
        path.open("ab").close()
        if not existed:
            path.unlink()
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from None


def draw(model: Any, view: View, path: Path) -> Picture:
    """Draws a state.

    Args:
        model: the `mujoco.MjModel`.
        view: what to draw.
        path: the PNG file to write.

    Raises:
        InputError: neither OpenGL nor matplotlib is there.
    """
    failures = []
    for backend in _backends():
        failure = _render(view, path, backend)
        if failure is None:
            return Picture(str(path), f"MuJoCo ({backend or 'default OpenGL'})", "")
        failures.append(f"{backend or 'default OpenGL'}: {failure}")
    why = "MuJoCo could not render: " + "; ".join(failures)
    try:
        from jaxbe.cli.plot import plot
    except ModuleNotFoundError as error:
        raise InputError(
            f"no picture: {why}; and no {error.name}: pip install 'jaxbe[viz]'"
        ) from None
    plot(model, view, path)
    return Picture(str(path), "matplotlib", why)


def _backends() -> list[str]:
    """Values of MUJOCO_GL to try: the user's own, or those that need no screen."""
    if "MUJOCO_GL" in os.environ:
        return [os.environ["MUJOCO_GL"]]
    return ["egl", "osmesa"] if sys.platform == "linux" else [""]


def _render(view: View, path: Path, backend: str) -> str | None:
    """Renders in a process of its own; returns what went wrong, if anything.

    With MUJOCO_GL set and its library missing, even `import mujoco` fails; and a
    broken driver may crash or hang.
    """
    package_root = str(Path(__file__).parents[2])
    search = [package_root, os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {
        "MUJOCO_GL": backend,
        "PYTHONPATH": os.pathsep.join(filter(None, search)),
    }
    try:
        child = subprocess.run(
            [sys.executable, "-m", "jaxbe.cli.render", str(path)],
            input=json.dumps(view),
            env=environment,
            capture_output=True,
            text=True,
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
