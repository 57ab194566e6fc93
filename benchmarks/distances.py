"""Distances and depths beside MuJoCo C's, and depths beside the least of many descents.

Run from the repository root, with MuJoCo 4:

    python -m benchmarks.distances

Everything is float64. A depth is a local minimum over directions, so an upper bound of
the least: here the least is that of `DESCENTS` descents from random directions.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks import machine, report, scenes
from jaxbe.pose import canonical_pair
from jaxbe.tangent import depth, improved, search
from tests import distance_reference as dr

STEPS = (3, 5)
"""The default, and more."""

DESCENTS = 300
STEPS_OF_A_DESCENT = 7

TIGHT = (1e-10, 200)
"""MuJoCo's tolerance and iterations, for more digits than by default."""

SAME = 1e-6
"""Depths that differ by less (metres; as a share of the least) are the same."""

QUICK = (400, 60)

TWO_GEOMS = """
<mujoco>
  <worldbody>
    <body mocap="true"><geom type="ellipsoid" size="1 1 1"/></body>
    <body mocap="true"><geom type="box" size="1 1 1"/></body>
  </worldbody>
</mujoco>
"""


def of_mujoco(
    scene: scenes.Scene, settings: tuple[float, int] | None = None
) -> tuple[np.ndarray, float]:
    """`mj_geomDistance` of every pair, and its tolerance.

    Args:
        scene: the pairs.
        settings: tolerance and iterations; None for MuJoCo's own.
    """
    model = mujoco.MjModel.from_xml_string(TWO_GEOMS)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if settings is not None:
        model.opt.ccd_tolerance, model.opt.ccd_iterations = settings
    found = []
    for C, U, e, K, V, a in zip(*scene, strict=True):
        model.geom_size[:] = a, e
        model.geom_rbound[:] = np.max(a), np.linalg.norm(e)
        data.geom_xpos[:] = K, C
        data.geom_xmat[:] = V.ravel(), U.ravel()
        found.append(mujoco.mj_geomDistance(model, data, 0, 1, 1e10, None))
    return np.array(found), float(model.opt.ccd_tolerance)


def longer(ours: np.ndarray, theirs: np.ndarray) -> float:
    """The share of overlapping pairs whose depth is longer than theirs."""
    return float(np.mean((ours < theirs - SAME)[ours <= 0]))


def least_depths(scene: scenes.Scene, seed: int = 64) -> np.ndarray:
    """Of overlapping pairs, the least depth of jaxbe and of descents from anywhere."""
    pair = jax.jit(canonical_pair)(*scene.bodies())

    @jax.jit
    def descend(u: Any) -> jax.Array:
        for _ in range(STEPS_OF_A_DESCENT):
            u = improved(search(pair), u)
        F, length = depth(search(pair), u)
        return F / length / pair.per_unit

    rng = np.random.default_rng(seed)
    least = -dr.found(scene).distance
    for _ in range(DESCENTS):
        n = rng.normal(size=(3, scene.size))
        n /= np.linalg.norm(n, axis=0)
        least = np.minimum(least, np.asarray(descend(tuple(map(jnp.asarray, n)))))
    return least


def depth_row(scene: scenes.Scene, least: np.ndarray, steps: int) -> dict[str, float]:
    """Depths over the least, and how far the value along the normal is from them."""
    found = dr.found(scene, steps)
    ratio = -found.distance / least
    return {
        "steps": steps,
        "least": float(np.mean(ratio <= 1 + SAME)),
        "99.9 %": float(np.percentile(ratio, 99.9)),
        "largest": float(np.max(ratio)),
        "way_out_errs_by": float(
            np.max(abs(found.distance - dr.value_along(scene, found.normal)))
        ),
    }


def apart_row(
    scene: scenes.Scene, ours: np.ndarray, settings: tuple[float, int] | None
) -> dict[str, float]:
    """The largest difference from MuJoCo of pairs that are apart."""
    theirs, tolerance = of_mujoco(scene, settings)
    apart = ours > 0
    return {
        "tolerance": tolerance,
        "pairs": int(apart.sum()),
        "largest_difference": float(np.max(abs(theirs - ours)[apart])),
        "share_within_1e-12": float(np.mean((abs(theirs - ours) <= 1e-12)[apart])),
    }


def measure(
    pairs: int, overlapping: int, tick: Callable[[], Any]
) -> dict[str, list[dict[str, float]]]:
    """Rows of pairs apart, of overlapping pairs beside MuJoCo, and of depths."""
    scene = scenes.random(pairs, seed=90)
    ours = dr.found(scene).distance
    apart = [apart_row(scene, ours, settings) for settings in (None, TIGHT)]
    tick()
    theirs, _ = of_mujoco(scene, TIGHT)
    found = {steps: dr.found(scene, steps).distance for steps in STEPS}
    beside = [
        {"steps": k, "pairs": int(np.sum(x <= 0)), "longer": longer(x, theirs)}
        for k, x in found.items()
    ]
    tick()
    deep = dr.random_overlapping(overlapping, 63)
    least = least_depths(deep)
    depths = [depth_row(deep, least, steps) for steps in STEPS]
    tick()
    return {"apart": apart, "beside_mujoco": beside, "depths": depths}


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    apart = [
        [f"{r['tolerance']:g}", f"{r['pairs']:,}", f"{r['largest_difference']:.1e}"]
        for r in numbers["apart"]
    ]
    depths = [
        [
            str(r["steps"]),
            f"{100 * r['least']:.2f}",
            f"{r['99.9 %']:.3f}",
            f"{r['largest']:.3f}",
            f"{100 * b['longer']:.2f}",
            f"{r['way_out_errs_by']:.1e}",
        ]
        for r, b in zip(numbers["depths"], numbers["beside_mujoco"], strict=True)
    ]
    least = "least, % of pairs", "over the least, 99.9 %", "at most"
    header = "steps", *least, "longer than MuJoCo's, %", "the way out errs by, m"
    return "\n\n".join(
        [
            "# Distances and depths",
            f"Beside MuJoCo {numbers['mujoco']}'s `mj_geomDistance`, of random pairs "
            "that are apart:",
            report.table(("its tolerance", "pairs", "largest difference, m"), apart),
            f"{numbers['overlapping']:,} random pairs that overlap; the least depth is "
            f"that of {DESCENTS} descents from random directions. Beside MuJoCo "
            f"(tolerance {TIGHT[0]:g}): {numbers['beside_mujoco'][0]['pairs']:,} pairs "
            f"that overlap. The way out errs by what the value along the normal, in "
            "extended precision, differs from the depth.",
            report.table(header, depths),
            report.machine_lines(numbers["machine"]),
        ]
    )


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=20_000, help="beside MuJoCo")
    parser.add_argument("--overlapping", type=int, default=1500, help="of least depth")
    parser.add_argument("--quick", action="store_true", help="few pairs")
    report.add_output_options(parser)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    pairs, overlapping = (
        QUICK if options.quick else (options.pairs, options.overlapping)
    )
    with report.progress_bar() as progress:
        task = progress.add_task("measuring", total=3)
        rows = measure(pairs, overlapping, lambda: progress.advance(task))
    about = {"machine": machine.describe(), "mujoco": mujoco.__version__}
    numbers = {**about, "overlapping": overlapping, **rows}
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
