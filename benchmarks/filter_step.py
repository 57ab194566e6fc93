"""The filter beside `mjx.step` on the shipped scene: the child of `benchmarks.filter`.

    XLA_FLAGS=--xla_cpu_use_fusion_emitters=false python -m benchmarks.filter_step

prints one JSON object. On a CPU newer versions of XLA make a program of MJX's
kinematics that takes most of a second, unless that flag is set; it slows the filter.
The step is that of a model in which ellipsoids and boxes do not collide (MJX refuses
those pairs), once with all other contacts and once without any.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjx

from benchmarks import filter_scenes, filter_times, timing
from jaxbe.cli.states import random_states

FLAGS = "--xla_cpu_use_fusion_emitters=false"

MODELS = {
    "all other contacts": filter_scenes.without_ellipsoid_box,
    "no contacts": filter_scenes.without_contacts,
}


def in_a_process(environments: int, repeats: int) -> list[dict[str, Any]]:
    """What `measure` finds with the flag that MJX needs."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {FLAGS}".strip()
    command = [sys.executable, "-m", "benchmarks.filter_step"]
    done = subprocess.run(
        [*command, f"--environments={environments}", f"--repeats={repeats}"],
        env=os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        check=True,
    )
    # MJX may say before what it cannot import.
    found: list[dict[str, Any]] = json.loads(done.stdout.splitlines()[-1])
    return found


def measure(environments: int, repeats: int) -> list[dict[str, Any]]:
    """Seconds a call of the step and of the filter, by number of environments."""
    return [
        _measure_one(name, n, repeats)
        for name in MODELS
        for n in sorted({1, min(64, environments), environments})
    ]


def _measure_one(name: str, n: int, repeats: int) -> dict[str, Any]:
    model = MODELS[name](filter_scenes.arm())
    on_device, states = _states(model, n)
    step = jax.jit(jax.vmap(functools.partial(mjx.step, on_device)))
    compiled, seconds = timing.seconds(lambda: step.lower(states).compile())
    after = compiled(states)
    run = filter_times.filtered(
        filter_scenes.arm(), filter_scenes.arm_pairs(), max_pairs=filter_times.MAX_PAIRS
    )
    run = functools.partial(jax.jit(run), after.geom_xpos, after.geom_xmat)
    tasks = {"step": functools.partial(compiled, states), "filter": run}
    return {
        "contacts": name,
        "environments": n,
        "compile_seconds": seconds,
        "finite": bool(jnp.all(jnp.isfinite(after.qpos))),
    } | filter_times.interleaved(tasks, repeats)


def _states(model: Any, n: int) -> tuple[Any, Any]:
    on_device = mjx.put_model(model)
    start = mjx.make_data(on_device)
    qpos = random_states(model, n, 0).rows(0, n).astype(np.float32)
    return on_device, jax.vmap(lambda q: start.replace(qpos=q))(jnp.asarray(qpos))


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints what is measured."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--environments", type=int, default=1024)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args(arguments)
    print(json.dumps(measure(options.environments, options.repeats)))


if __name__ == "__main__":
    main()
