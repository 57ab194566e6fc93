"""`contact` on one core, beside MuJoCo C's `mj_collision` on the same pairs.

Run from the repository root:

    python -m benchmarks.contact_speed

Float32 for jaxbe, MuJoCo computes in float64. MuJoCo gets a model with all pairs as
explicit contact pairs, so that its loop is in C, and drops those whose bounding spheres
are apart. Runs in a child process, which XLA's flags leave one core.
"""

from __future__ import annotations

import argparse
import functools
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import jax
import mujoco
import numpy as np

import jaxbe
from benchmarks import machine, report, scenes, timing
from benchmarks.margin_one_core import pin_to_one_core
from benchmarks.margin_speed import ONE_CORE_FLAGS

CHILD = "JAXBE_BENCHMARK_ON_ONE_CORE"


def mujoco_loop(pairs: scenes.Scene) -> Callable[[], Any]:
    """`mj_collision` of a model that has these pairs and no others."""
    spec = mujoco.MjSpec()
    for i, (C, U, e, K, V, a) in enumerate(zip(*pairs, strict=True)):
        for kind, center, axes, lengths in (
            ("BOX", C, U, e),
            ("ELLIPSOID", K, V, a),
        ):
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, axes.ravel())
            spec.worldbody.add_body(pos=center, quat=quaternion).add_geom(
                name=f"{kind}{i}",
                type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"),
                size=lengths,
                contype=0,
                conaffinity=0,
            )
        spec.add_pair(geomname1=f"ELLIPSOID{i}", geomname2=f"BOX{i}")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return functools.partial(mujoco.mj_collision, model, data)


def measure(pairs: int, peers: int, repeats: int) -> dict[str, Any]:
    """Pairs a second, and seconds to compile."""
    scene = scenes.random(pairs)
    bodies = scene.astype(np.float32).bodies()
    tasks, facts = {}, {}
    for name in ("signed_distance", "contact", "margin"):
        function = jax.jit(jax.vmap(getattr(jaxbe, name)))
        lower = lambda f=function: f.lower(*bodies).compile()  # noqa: E731
        compiled, facts[name] = timing.seconds(lower)
        tasks[name] = timing.Task(functools.partial(compiled, *bodies))
    tasks["mj_collision"] = timing.Task(mujoco_loop(scene.part(slice(peers))))
    measured = timing.interleaved(tasks, repeats)
    counts = {name: peers if name == "mj_collision" else pairs for name in tasks}
    rates = {name: counts[name] / t.median for name, t in measured.times.items()}
    return {
        "machine": machine.describe(),
        "mujoco": mujoco.__version__,
        "compile_seconds": facts,
        "pairs_per_second": rates,
        "cores_busy_with_others": measured.others,
    }


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    rates = numbers["pairs_per_second"]
    rows = [
        [
            name,
            f"{rate / 1e6:.3g}",
            f"{rate / rates['mj_collision']:.1f}",
            f"{numbers['compile_seconds'].get(name, 0):.1f}",
        ]
        for name, rate in rates.items()
    ]
    header = ["function", "M pairs/s, one core", "x mj_collision", "compile, s"]
    return "\n\n".join(
        [
            "# Contacts on one core",
            f"Float32 against MuJoCo {numbers['mujoco']}; others kept at most "
            f"{numbers['cores_busy_with_others']:.2f} cores busy.",
            report.table(header, rows),
            report.machine_lines(numbers["machine"]),
        ]
    )


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=200_000)
    parser.add_argument("--peers", type=int, default=2000, help="pairs for MuJoCo")
    parser.add_argument("--repeats", type=int, default=11)
    report.add_output_options(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes; in a process of one core."""
    options = parse(arguments)
    if CHILD not in os.environ:
        command = [sys.executable, "-m", "benchmarks.contact_speed"]
        given = sys.argv[1:] if arguments is None else list(arguments)
        flags = " ".join((os.environ.get("XLA_FLAGS", ""), *ONE_CORE_FLAGS)).strip()
        environment = os.environ | {"XLA_FLAGS": flags, CHILD: "1"}
        environment["JAX_PLATFORMS"] = "cpu"
        subprocess.run([*command, *given], env=environment, check=True)
        return
    pin_to_one_core()
    numbers = measure(options.pairs, options.peers, options.repeats)
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
