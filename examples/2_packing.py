"""python examples/2_packing.py --output 2_packing.png  (--quick; --measure; --help).

Packs fruit, ellipsoids of all shapes, into a crate among parcels: a thousand random
starts in one vmap, all positions and quaternions moved at once by the gradient of the
margins that are missing. What is found is proved: fruit against parcels by
`jaxbe.certify`, fruit against the crate and each other by what `fruit.py` says.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import optax
from command_line import parser, say
from crate import Instance, draw, instance, random_poses
from fruit import loss, proved
from placing import Pose, ellipsoid_at
from rich.progress import track

WANTED = 0.02
"""The margin aimed at; the proofs want more than none."""

AT_ONCE = 64
"""Starts in one vmap: what fits the cache of two cores best; a GPU takes them all."""

DENSITIES = np.arange(0.42, 0.581, 0.02)


class Packed(NamedTuple):
    """Of all starts: poses, the loss on the way (starts, T), whether it is proved."""

    pose: Pose
    loss: np.ndarray
    proved: np.ndarray


def packer(iterations: int) -> Any:
    """Poses (starts, N) and an instance to better poses and losses (starts, T)."""
    optimiser = optax.adam(optax.cosine_decay_schedule(0.03, iterations))
    gradient = jax.value_and_grad(loss)

    def pack(pose: Pose, task: Instance) -> tuple[Pose, jax.Array]:
        def step(carry: Any, _: None) -> Any:
            pose, memory = carry
            value, slope = gradient(pose, task, WANTED)
            change, memory = optimiser.update(slope, memory)
            return (optax.apply_updates(pose, change), memory), value

        start = pose, optimiser.init(pose)
        (pose, _), values = jax.lax.scan(step, start, length=iterations)
        return pose, values

    return jax.jit(jax.vmap(pack, in_axes=(0, None)))


def solve(pack: Any, task: Instance, start: Pose) -> Packed:
    """Packs from all starts (starts, N) and proves what it can."""
    pose, values = pack(start, task)
    fruit = jax.tree.map(np.asarray, place(pose, task.semi_axes))
    each = range(len(values))
    ok = [proved(jax.tree.map(lambda x, i=i: x[i], fruit), task) for i in each]
    return Packed(pose, np.asarray(values), np.array(ok))


place = jax.jit(ellipsoid_at)


def measure(options: argparse.Namespace) -> float:
    """Finds where packing begins to fail; returns its success at 60 % of that."""
    rng = np.random.default_rng(options.seed)
    pack, rows = packer(options.iterations), []

    def success(density: float, instances: int) -> float:
        found = []
        for _ in track(range(instances), description=f"density {density:.2f}"):
            task = instance(rng, options.fruit, density)
            start = random_poses(rng, (AT_ONCE, options.fruit))
            found.append(solve(pack, task, start).proved)
        some, each = float(np.mean(np.any(found, axis=1))), float(np.mean(found))
        rows.append({"density": density, "instances": some, "starts": each})
        print(f"{density:.3f}: {some:.0%} of {instances} instances, ", end="")
        print(f"{each:.0%} of their {AT_ONCE} starts each")
        return some

    counts = (2, 3) if options.quick else (20, 100)
    ladder = DENSITIES[::4] if options.quick else DENSITIES
    ladder = [float(d) for d in ladder]
    fails = next((d for d in ladder if success(d, counts[0]) < 1), ladder[-1])
    some = success(0.6 * fails, counts[1])
    text = "begins to fail at {fails:.2f}; at 60 % of that {success:.0%} succeed"
    say(options, text, fails=fails, success=some, of=counts, rows=rows)
    return some


def main(arguments: Sequence[str] | None = None) -> float:
    """Packs one instance, or measures; returns the share of successes."""
    options = parser(__doc__, "2_packing.png")
    options.add_argument("--fruit", type=int, default=60, help="50 to 200")
    options.add_argument("--density", type=float, default=0.44, help="of free volume")
    options.add_argument("--starts", type=int, default=1024)
    options.add_argument("--iterations", type=int, default=400)
    options.add_argument("--measure", action="store_true", help="success by density")
    options = options.parse_args(arguments)
    if options.quick:
        options.fruit, options.starts, options.iterations = 20, AT_ONCE, 200
        options.density = 0.36
    if options.measure:
        return measure(options)
    rng = np.random.default_rng(options.seed)
    task, pack = (
        instance(rng, options.fruit, options.density),
        packer(options.iterations),
    )
    start = random_poses(rng, (options.starts, options.fruit))
    began, parts = time.perf_counter(), []
    for i in track(range(0, options.starts, AT_ONCE), description="pack"):
        part = jax.tree.map(lambda x, i=i: x[i : i + AT_ONCE], start)
        parts.append(solve(pack, task, part))
    packed = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    text = """\
{fruit} fruit fill {density:.0%} of the free volume: {proved} of {starts} starts end in
a proved packing, {pack_seconds:.0f} s with proofs and compilation"""
    numbers = {name: vars(options)[name] for name in ("fruit", "density", "starts")}
    numbers["pack_seconds"] = time.perf_counter() - began
    say(options, text, proved=int(packed.proved.sum()), **numbers)
    draw(options.output, task, start, *packed)
    return float(packed.proved.mean())


if __name__ == "__main__":
    main()
