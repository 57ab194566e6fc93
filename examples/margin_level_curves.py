"""Level curves of the margin beside those of sqrt(q) - 1, and both gradients.

A slice of the plane z = 0 through a box; the centre of a long, tilted ellipsoid
moves over it. The margin tells depth and the way out everywhere but in the box's
own centre; sqrt(q) - 1 is flat as soon as the ellipsoid's centre is in the box.

    python examples/margin_level_curves.py --output margin-level-curves.png
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

import jaxbe
from jaxbe.viz import draw_slice

LIMITS = ((-3.0, 3.0), (-2.4, 2.4))
HALF_EXTENTS = (1.0, 0.6, 0.5)
SEMI_AXES = (1.3, 0.35, 0.3)
TILT = np.deg2rad(35)
PLACE = (1.75, 0.35, 0.0)


def sqrt_q_minus_one(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """What the tests of the paper compare with zero."""
    return jaxbe.scaled_distance(box, ellipsoid) - 1


def bodies() -> tuple[jaxbe.Box, jaxbe.Ellipsoid]:
    """The box, and the ellipsoid, turned about z, in one of its places."""
    box = jaxbe.Box(np.zeros(3), np.eye(3), HALF_EXTENTS)
    c, s = np.cos(TILT), np.sin(TILT)
    axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return box, jaxbe.Ellipsoid(PLACE, axes, SEMI_AXES)


def draw(file: Path, resolution: int) -> None:
    """Both functions side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.2), layout="constrained")
    functions = {"margin": jaxbe.margin, r"$\sqrt{q}-1$": sqrt_q_minus_one}
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, function) in zip(panels, functions.items(), strict=True):
        style = {"function": function, "limits": LIMITS, "resolution": resolution}
        filled = draw_slice(*bodies(), axes, **style)
        axes.set_title(f"{name}: levels and direction of the gradient", fontsize=11)
    panels[1].set_ylabel("")
    bar = figure.colorbar(
        filled, ax=panels, shrink=0.9, pad=0.015, ticks=filled.levels[::4]
    )
    bar.set_label("negative: overlap, black: touching, positive: apart")
    figure.savefig(file, dpi=110)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draws."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--output", type=Path, default="margin-level-curves.png")
    parser.add_argument("--resolution", type=int, default=501)
    options = parser.parse_args(arguments)
    draw(options.output, options.resolution)


if __name__ == "__main__":
    main()
