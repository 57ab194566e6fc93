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
from collections.abc import Callable, Sequence
from typing import Any

import jax
import mujoco
import numpy as np

import jaxbe
from benchmarks import machine, one_core, peer_adapters, report, scenes, timing


def mujoco_loop(pairs: scenes.Scene) -> Callable[[], Any]:
    """`mj_collision` of a model that has these pairs and no others."""
    model, data = peer_adapters.mujoco_model(pairs)
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
    if one_core.done_by_child("benchmarks.contact_speed", arguments):
        return
    numbers = measure(options.pairs, options.peers, options.repeats)
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
