"""The margin's gradient is continuous: its jumps fall linearly with the step.

Run from the repository root:

    python -m benchmarks.margin_continuity

Ellipsoids move along straight lines over the box, from contact with a face to an
edge and on to a vertex, in float64. The largest difference of the gradients (in all
30 numbers) at neighbouring points is compared with their distance; beside it the
same for sqrt(q), whose gradient jumps where the centre enters the box.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import machine, report, scenes
from jaxbe.contact_normal import contact_normal
from jaxbe.growth import growth_bounds
from jaxbe.margin import DEFAULT_STEPS
from jaxbe.pose import canonical_pair

CONTACTS = {1: "face", 2: "edge", 3: "vertex"}
COLORS = {"face": "#E8F1F8", "edge": "#FBEFD5", "vertex": "#DDF0E8"}
FUNCTIONS = {"margin": jaxbe.margin, "sqrt(q)": jaxbe.scaled_distance}
STYLES = {"margin": "#0072B2", "sqrt(q)": "#D55E00"}
DRAWN_POINTS = 2001


class Path3(NamedTuple):
    """A body each, and the line of the ellipsoid's centres over t in [0, 1]."""

    box: jaxbe.Box
    ellipsoid: jaxbe.Ellipsoid
    start: np.ndarray
    end: np.ndarray

    def bodies(self, t: jax.Array) -> tuple[jaxbe.Box, jaxbe.Ellipsoid]:
        """The pair at t."""
        center = self.start + t * (self.end - self.start)
        ellipsoid = jaxbe.Ellipsoid.unchecked(
            center, self.ellipsoid.axes, self.ellipsoid.semi_axes
        )
        return self.box, ellipsoid


def path(seed: int) -> Path3:
    """From a face's inner side, past it, over an edge to a vertex."""
    pair = scenes.random(1, seed, low=0.4, high=1.2)
    U, e, V, a = (x[0] for x in (pair.U, pair.e, pair.V, pair.a))
    reach = e + scenes.half_widths(pair.U, pair.V, pair.a)[0]
    box = jaxbe.Box.unchecked(np.zeros(3), U, e)
    start = U @ (np.array([0.3, -0.2, 0.5]) * e)
    end = U @ (np.array([1.2, 1.1, 1.3]) * reach)
    return Path3(box, jaxbe.Ellipsoid.unchecked(start, V, a), start, end)


@functools.partial(jax.jit, static_argnums=1)
def gradients(path: Path3, function: Callable[..., Any], t: jax.Array) -> jax.Array:
    """The 30 derivatives (len(t), 30) along the path."""
    gradient = jax.grad(function, argnums=(0, 1))

    def at(t: jax.Array) -> jax.Array:
        leaves = jax.tree.leaves(gradient(*path.bodies(t)))
        return jnp.concatenate([x.reshape(-1) for x in leaves])

    return jax.vmap(at)(t)


@jax.jit
def active_axes(path: Path3, t: jax.Array) -> jax.Array:
    """In how many axes the contact normal has a component; 2 on an edge."""

    def at(t: jax.Array) -> jax.Array:
        pair = canonical_pair(*path.bodies(t))
        n = contact_normal(pair, growth_bounds(pair, DEFAULT_STEPS)[0]).n
        return sum((abs(x) > 1e-9).astype(int) for x in n)

    return jax.vmap(at)(t)


def contacts(path: Path3, t: np.ndarray) -> list[str]:
    """The box's feature in contact when both bodies are grown to touch."""
    return [CONTACTS[int(count)] for count in active_axes(path, t)]


def largest_jumps(
    path: Path3, function: Callable[..., Any], steps: Sequence[int]
) -> list[float]:
    """Between neighbours of `steps` + 1 points on the path, in any derivative."""
    finest = max(steps)
    g = np.asarray(gradients(path, function, np.linspace(0, 1, finest + 1)))
    return [float(np.max(abs(np.diff(g[:: finest // n], axis=0)))) for n in steps]


def measure(
    paths: int, steps: Sequence[int], tick: Callable[[], Any]
) -> dict[str, Any]:
    """The largest jump over all paths, by function and step size."""
    jumps = {name: np.zeros(len(steps)) for name in FUNCTIONS}
    crossed = {}
    for seed in range(paths):
        for name, function in FUNCTIONS.items():
            found = largest_jumps(path(seed), function, steps)
            jumps[name] = np.maximum(jumps[name], found)
        crossed[seed] = _crossed(path(seed))
        tick()
    return {
        "steps": list(steps),
        "jumps": {name: values.tolist() for name, values in jumps.items()},
        "slopes": {name: _slope(steps, values) for name, values in jumps.items()},
        "contacts": crossed,
    }


def _slope(steps: Sequence[int], jumps: Sequence[float]) -> float:
    """The exponent of the step size in the jump, over the finer half."""
    half = len(steps) // 2
    return float(-np.polyfit(np.log(steps[half:]), np.log(jumps[half:]), 1)[0])


def _crossed(path: Path3) -> list[str]:
    """The features in contact, in the order of the path."""
    found = contacts(path, np.linspace(0, 1, DRAWN_POINTS))
    return [c for i, c in enumerate(found) if i == 0 or c != found[i - 1]]


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    rows = [
        (
            f"{1 / count:.1e}",
            *(f"{numbers['jumps'][name][i]:.2e}" for name in FUNCTIONS),
        )
        for i, count in enumerate(numbers["steps"])
    ]
    slopes = ", ".join(
        f"{name} {round(s, 3) + 0.0:.3f}" for name, s in numbers["slopes"].items()
    )
    return f"""\
# The margin's gradient along paths

{len(numbers["contacts"])} straight paths of the ellipsoid's centre, from inside the \
box over contact with a face and an edge to a vertex; float64. The largest difference \
of any of the 30 derivatives between neighbouring points. Slopes in the log-log plot, \
over the finer half: {slopes} (1: continuous and piecewise smooth; 0: a jump).

{report.table(("step", *FUNCTIONS), rows)}

{report.machine_lines(numbers["machine"])}"""


def draw(numbers: dict[str, Any], file: Path) -> None:
    """The gradient along a path that meets all contacts, and jumps over step size."""
    # Here, so that the table does not need matplotlib.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    crossed = numbers["contacts"]
    _draw_path(left, path(max(crossed, key=lambda seed: len(set(crossed[seed])))))
    _draw_jumps(right, numbers)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=160)


def _draw_path(axes: Any, path: Path3) -> None:
    """The three derivatives in the centre, over bands of one contact each."""
    t = np.linspace(0, 1, DRAWN_POINTS)
    for name, function in FUNCTIONS.items():
        by_center = gradients(path, function, t)[:, 15:18]
        style = {"color": STYLES[name], "lw": 1.6 if name == "margin" else 1.0}
        axes.plot(t, by_center, **style, ls="-" if name == "margin" else "--")
        axes.plot([], [], **style, label=f"gradient of {name}")
    _draw_bands(axes, t, contacts(path, t))
    axes.set_xlim(0, 1)
    axes.set_xlabel("along the path of the ellipsoid's centre")
    axes.set_ylabel("derivatives in the ellipsoid's centre, 1/m")
    axes.set_title("one path: the box's feature in contact", fontsize=10)
    axes.legend(frameon=False, fontsize=8)


def _draw_bands(axes: Any, t: np.ndarray, found: list[str]) -> None:
    changes = [i for i in range(1, len(t)) if found[i] != found[i - 1]]
    for first, last in zip([0, *changes], [*changes, len(t) - 1], strict=True):
        axes.axvspan(t[first], t[last], color=COLORS[found[first]], zorder=0, lw=0)
        axes.annotate(
            found[first],
            ((t[first] + t[last]) / 2, 0.02),
            xycoords=("data", "axes fraction"),
            ha="center",
            fontsize=8,
            color="#555555",
        )


def _draw_jumps(axes: Any, numbers: dict[str, Any]) -> None:
    step = 1 / np.array(numbers["steps"])
    for name, jumps in numbers["jumps"].items():
        slope = round(numbers["slopes"][name], 2) + 0.0  # no "-0.00"
        label = f"{name}, slope {slope:.2f}"
        axes.loglog(step, jumps, "o-", ms=4, color=STYLES[name], label=label)
    below = 0.4 * numbers["jumps"]["margin"][0] * step / step[0]
    axes.loglog(step, below, ":", color="#888888", lw=1, label="slope 1")
    axes.set_xlabel("step along the path")
    axes.set_ylabel("largest jump of any of 30 derivatives")
    axes.set_title(f"{len(numbers['contacts'])} paths", fontsize=10)
    axes.grid(color="#e4e4e4", lw=0.6)
    axes.legend(frameon=False, fontsize=8)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--paths", type=int, default=20)
    parser.add_argument(
        "--finest", type=int, default=17, help="2^-N is the finest step"
    )
    report.add_output_options(parser)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw it")
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    steps = [2**p for p in range(6, options.finest + 1)]
    with report.progress_bar() as progress:
        bar = progress.add_task("paths", total=options.paths)
        tick = functools.partial(progress.advance, bar)
        numbers = measure(options.paths, steps, tick)
    numbers["machine"] = machine.describe()
    report.write(options, text(numbers), numbers)
    if options.figure:
        draw(numbers, options.figure)


if __name__ == "__main__":
    main()
