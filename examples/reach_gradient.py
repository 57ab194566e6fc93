"""python examples/reach_gradient.py --output reach-gradient.png  (--quick: shorter).

Gradients through the dynamics of `reach_env.Reach`, in reverse mode, which goes through
`mjx.step` only where its solver does not iterate: the forces of one episode are
optimised with optax, without and with the clearance, a penalty on the margins of all
pairs. Without, the shortest way leads through a box; the margin's gradient, which has
a direction at every depth of an overlap, turns the hand and leads it through the gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from command_line import parser, say
from reach_env import TARGET, Reach
from reach_picture import draw_scene, sweep

START = (-0.45, 0.3, 1.3)
"""Slides (m) and wrist (rad)."""

WANTED = 0.1
"""The margin under which the clearance counts."""


Improver = Callable[[jax.Array, Any, float], tuple[Any, ...]]
COLORS = ("tab:red", "tab:blue")


class Result(NamedTuple):
    """Of one optimisation.

    Attributes:
        loss: (iterations,).
        distance: (iterations,) from grip to target at the end of the episode, in m.
        margin: (iterations,) the smallest of the episode.
        path: (T, 3) slides and wrist with the last forces.
    """

    loss: np.ndarray
    distance: np.ndarray
    margin: np.ndarray
    path: np.ndarray


def loss(
    forces: jax.Array, env: Reach, weight: float
) -> tuple[jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
    """Way left, effort and clearance of the episode with forces (T, 3)."""

    def step(state: Any, force: jax.Array) -> tuple[Any, Any]:
        state = env.step(state, jnp.tanh(force))
        data = state.pipeline_state
        return state, (state.metrics["distance"], env.margins(data), data.qpos)

    start = env.start(jnp.array(START), jnp.array(TARGET))
    _, (distance, margins, path) = jax.lax.scan(step, start, forces)
    short = jax.nn.relu(WANTED - margins)
    cost = distance.mean() + distance[-1] + 1e-3 * jnp.square(forces).mean()
    cost += weight * jnp.square(short).sum(axis=-1).mean()
    return cost, (distance[-1], margins.min(), path)


def improver(env: Reach, optimiser: Any) -> Improver:
    """One step of the optimiser: forces, its memory and the clearance's weight in."""

    @jax.jit
    def improve(forces: jax.Array, memory: Any, weight: float) -> tuple[Any, ...]:
        gradient = jax.value_and_grad(loss, has_aux=True)
        (cost, seen), slope = gradient(forces, env, weight)
        change, memory = optimiser.update(slope, memory)
        return optax.apply_updates(forces, change), memory, (cost, *seen)

    return improve


def optimise(
    improve: Improver, forces: jax.Array, memory: Any, weight: float, iterations: int
) -> Result:
    """Improves the forces (T, 3), and says how it goes."""
    found = []
    for i in range(iterations):
        forces, memory, seen = improve(forces, memory, weight)
        found.append(seen)
        if i % 50 == 0 or i == iterations - 1:
            cost, end, margin, _ = seen
            print(f"{i:4d}  loss {cost:.4f}  end {end:.3f} m  margin {margin:.3f}")
    cost, distance, margin, paths = (np.array(x) for x in zip(*found, strict=True))
    return Result(cost, distance, margin, paths[-1])


def draw(file: Path, results: dict[str, Result], env: Reach) -> None:
    """The curves, and the ways of the hand."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 4.4), layout="constrained")
    curves, *scenes = figure.subplots(1, 1 + len(results))
    for (name, result), color in zip(results.items(), COLORS, strict=True):
        curves.plot(result.distance, "--", color=color, label=f"{name}: way left (m)")
        curves.plot(result.margin, color=color, label=f"{name}: smallest margin")
    curves.axhline(0, color="0.5", lw=0.8)
    curves.set(xlabel="iteration")
    curves.legend()
    for scene, (name, result) in zip(scenes, results.items(), strict=True):
        draw_scene(scene, env)
        sweep(scene, env, result.path, hands=9)
        scene.set_title(f"{name}: smallest margin {result.margin[-1]:.2f}")
    figure.savefig(file, dpi=110)


def main(arguments: Sequence[str] | None = None) -> dict[str, Result]:
    """Optimises twice and draws; returns what was found."""
    options = parser(__doc__, "reach-gradient.png")
    options.add_argument("--iterations", type=int, default=400)
    options.add_argument("--horizon", type=int, default=40, help="steps of the episode")
    options.add_argument("--rate", type=float, default=0.03)
    options.add_argument("--weight", type=float, default=100.0, help="of the clearance")
    options = options.parse_args(arguments)
    if options.quick:
        options.iterations = 40
    env, optimiser, results = Reach(), optax.adam(options.rate), {}
    improve = improver(env, optimiser)
    key = jax.random.key(options.seed)
    forces = 0.01 * jax.random.normal(key, (options.horizon, 3))
    for name, weight in {"without the margin": 0.0, "with it": options.weight}.items():
        print(name)
        memory = optimiser.init(forces)
        results[name] = optimise(improve, forces, memory, weight, options.iterations)
    draw(options.output, results, env)
    last = {
        name: {"left": float(r.distance[-1]), "smallest_margin": float(r.margin[-1])}
        for name, r in results.items()
    }
    words = "; ".join(
        f"{name} {1000 * r['left']:.0f} mm left, smallest margin "
        f"{r['smallest_margin']:.2f}"
        for name, r in last.items()
    )
    say(options, words, iterations=options.iterations, last=last)
    return results


if __name__ == "__main__":
    main()
