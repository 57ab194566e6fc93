"""python examples/reach_ppo.py --output reach-ppo.png  (--quick: too short to learn).

Brax's PPO on `reach_env.Reach`: the return of episodes of 60 steps before, during and
after the training, and the paths of the hand with what it has learned. 3 to 5 minutes
on two busy cores, most of them compiling.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.agents.ppo import networks, train
from command_line import parser, say
from reach_env import Reach
from reach_picture import draw_scene, sweep

EPISODE = 60
Metrics = dict[str, Any]
Policy = Callable[[jax.Array, jax.Array], tuple[jax.Array, Any]]


def learn(env: Reach, options: argparse.Namespace) -> tuple[Policy, list[Metrics]]:
    """The trained policy, and the metrics of each evaluation."""
    curve: list[Metrics] = []
    make_policy, parameters, _ = train.train(
        env,
        num_timesteps=options.timesteps,
        num_envs=options.envs,
        episode_length=EPISODE,
        unroll_length=10,
        batch_size=options.envs,
        num_minibatches=4,
        num_updates_per_batch=4,
        learning_rate=1e-3,
        entropy_cost=1e-3,
        discounting=0.97,
        normalize_observations=True,
        network_factory=functools.partial(
            networks.make_ppo_networks,
            policy_hidden_layer_sizes=(64, 64),
            value_hidden_layer_sizes=(64, 64),
        ),
        num_evals=options.evaluations,
        num_eval_envs=options.envs,
        deterministic_eval=True,
        seed=options.seed,
        progress_fn=functools.partial(note, curve, time.monotonic()),
    )
    return make_policy(parameters, deterministic=True), curve


def note(curve: list[Metrics], start: float, steps: int, metrics: Metrics) -> None:
    """Keeps and prints the metrics of an evaluation."""
    found = {
        "steps": steps,
        "seconds": time.monotonic() - start,
        "return": float(metrics["eval/episode_reward"]),
        "spread": float(metrics["eval/episode_reward_std"]),
        "touched": float(metrics["eval/episode_touched"]),
        "length": float(metrics["eval/avg_episode_length"]),
    }
    curve.append(found)
    print("  ".join(f"{name} {value:.4g}" for name, value in found.items()), flush=True)


class Episodes(NamedTuple):
    """Episodes played with a policy; where the hand touches a box it stays.

    Attributes:
        path: (episodes, EPISODE, 3) slides and wrist.
        distance: (episodes, EPISODE) from grip to target, in m.
        touched: (episodes, EPISODE) 1 from the first touch on.
    """

    path: np.ndarray
    distance: np.ndarray
    touched: np.ndarray


def play(env: Reach, policy: Policy, seed: int, count: int) -> Episodes:
    """New episodes, from starts that were not trained on."""

    def step(state: Any, key: jax.Array) -> tuple[Any, tuple[jax.Array, ...]]:
        moved = env.step(state, policy(state.obs, key)[0])
        after = jax.tree.map(lambda x, y: jnp.where(state.done, x, y), state, moved)
        seen = after.pipeline_state.qpos, after.metrics["distance"], after.done
        return after, seen

    def episode(key: jax.Array) -> tuple[jax.Array, ...]:
        return jax.lax.scan(step, env.reset(key), jax.random.split(key, EPISODE))[1]

    keys = jax.random.split(jax.random.key(seed), count)
    return Episodes(*(np.asarray(x) for x in jax.jit(jax.vmap(episode))(keys)))


def draw(file: Path, curve: list[Metrics], played: Episodes, env: Reach) -> None:
    """The learning curve beside the scene."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps, mean, spread = (
        np.array([point[name] for point in curve])
        for name in ("steps", "return", "spread")
    )
    left.fill_between(steps, mean - spread, mean + spread, alpha=0.2)
    left.plot(steps, mean, "o-", ms=3)
    left.set(xlabel="steps of the environment", ylabel="return")
    left.set_title("mean and deviation of the episodes")
    draw_scene(right, env)
    for path in played.path[:16]:
        right.plot(*path[:, :2].T, color="0.6", lw=0.8)
    sweep(right, env, played.path[0])
    right.set_title("trained: a hand, and the palms of 16")
    figure.savefig(file, dpi=120)


def main(arguments: Sequence[str] | None = None) -> list[Metrics]:
    """Trains and draws; returns the learning curve."""
    options = parser(__doc__, "reach-ppo.png")
    options.add_argument("--timesteps", type=int, default=1_000_000)
    options.add_argument("--envs", type=int, default=64)
    options.add_argument("--evaluations", type=int, default=21)
    options = options.parse_args(arguments)
    if options.quick:
        options.timesteps, options.evaluations = 10_000, 2
    env = Reach()
    policy, curve = learn(env, options)
    played = play(env, policy, options.seed + 1, count=256)
    left = np.percentile(played.distance[:, -1], [50, 95, 100]).tolist()
    text = "{episodes} new episodes: {touched} touch a box; left, median, 95 %, most: "
    found = {"episodes": len(played.path), "touched": int(played.touched[:, -1].sum())}
    say(options, text + "{left} m", left=left, **found, curve=curve)
    draw(options.output, curve, played, env)
    return curve


if __name__ == "__main__":
    main()
