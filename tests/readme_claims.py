"""The README's measured answers by sentence, and how results files give them.

Each function reads the results named and yields a sentence with {} for its figures,
then the figures; `python -m tests.readme_figures` compares. A figure that is no string
is one in words: `About`. What was timed is in `tests.readme_speeds`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxbe
from benchmarks import extremes_report
from tests.readme_figures import Claims, of
from tests.readme_format import NUMBERS, About, ceiling, none, only, percent, power

DTYPES = ("float32", "float64")
METHODS = ("closest_features", "all_features", "minkowski")


# The margin


KNOB_ROWS = {0: None, 1: None, 2: None, 3: None, 5: 3, 7: 5}
"""Steps, and those of the row above that may be "the same"."""


@of("margin-knob")
def knob(results: dict[str, Any]) -> Claims:
    def error(steps: int, dtype: str, aspect: str = "40") -> dict[str, Any]:
        scene = f"random, aspect to {aspect}"
        return only(results["errors"], steps=steps, dtype=dtype, scene=scene)

    def rate(steps: int, dtype: str) -> str:
        row = only(results["rates"], steps=steps, dtype=dtype)
        return f"{row['pairs_per_second'] / 1e6:.0f} M/s"

    def each(steps: int, level: str) -> tuple[float, float]:
        both = (error(steps, dtype)["error"][level] for dtype in DTYPES)
        return tuple(both)

    def cell(steps: int, level: str, joined: str, before: int | None) -> str:
        single, double = each(steps, level)
        if before is not None and np.allclose(
            each(before, level), each(steps, level), rtol=0.15
        ):
            return "the same"
        if math.isclose(single, double, rel_tol=1e-3):
            return power(single)
        return joined.format(power(single), power(double))

    yield "adds the upper one. {} random pairs with spreads", f"{results['pairs']:,}"
    for steps, before in KNOB_ROWS.items():
        label = "5 (default)" if steps == 5 else str(steps)
        yield (
            f"| {label} |" + " {} |" * 6,
            *(rate(steps, dtype) for dtype in DTYPES),
            cell(steps, "99", "{} in float32, {} in float64", before),
            cell(steps, "max", "{}, {}", before),
            power(error(steps, "float64", "1000")["error"]["max"]),
            percent(error(steps, "float32")["false_overlap"]),
        )


@of("one-sided")
def one_sided(results: dict[str, Any]) -> Claims:
    steps = [s for band in results["bands"] for s in band["steps"]]
    yield (
        "loses no pair: {} of {} overlapping float32 pairs within 1e-8 to 1e-3 of "
        "touching, at any count, where the largest margin was {} of the slack (`python "
        "-m benchmarks.one_sided --pairs {}`)",
        none(sum(s["count"]["dropped"] for s in steps)),
        f"{sum(band['count']['overlapping'] for band in results['bands']):,}",
        About(max(s["largest"]["slack"] for s in steps)),
        str(results["pairs"]),
    )


# Metres, contacts and proofs


@of("accuracy")
def distance_errors(results: dict[str, Any]) -> Claims:
    def error(scene: str, steps: int, dtype: str, level: str = "max") -> float:
        setting = f"signed_distance, {steps} steps"
        what = {"scene": scene, "setting": setting, "dtype": dtype}
        return only(results["errors"], **what, answer="distance")["error"][level]

    near, far = "random to 40", "random to 1000"
    yield (
        "Of {} pairs with spreads to 40, errors relative to the longest length or the "
        "distance: in float32 at most {}, in float64 {} of the distances",
        f"{results['pairs']:,}",
        *(ceiling(error(near, 3, dtype)) for dtype in DTYPES),
    )
    within = all(error(far, 3, d, "99.9") <= error(near, 3, d) for d in DTYPES)
    yield (
        "with spreads to 1000 {} in 99.9 %, at most {} at the default 3 steps and {} "
        "({}) at 5",
        "the same" if within else "more",
        ceiling(max(error(far, 3, dtype) for dtype in DTYPES)),
        *(ceiling(error(far, 5, dtype)) for dtype in DTYPES),
    )


@of("distances")
def distances(results: dict[str, Any]) -> Claims:
    default, tight = results["apart"]
    yield (
        "`mj_geomDistance` is within {} m of it on {} pairs apart at its tolerance of "
        "{}, and within {} m by default",
        ceiling(tight["largest_difference"]),
        f"{tight['pairs']:,}",
        power(tight["tolerance"]),
        ceiling(default["largest_difference"]),
    )
    three, five = results["depths"]
    yield (
        "that takes them apart: of {} random pairs the shortest known one in {} %, {} "
        "times its length at the 99.9th percentile and {} times at most; at 5 steps, "
        "which look from more sides, {} and {} times",
        f"{results['overlapping']:,}",
        f"{math.floor(100 * three['least'])}",
        *(f"{row[k]:.1f}" for row in (three, five) for k in ("99.9 %", "largest")),
    )
    longer = only(results["beside_mujoco"], steps=3)["longer"]
    yield "and 1.4 times. {} % are longer than MuJoCo C's", f"{100 * longer:.1f}"


@of("certificates")
def certificates(results: dict[str, Any]) -> Claims:
    rows = results["rows"]

    def undecided(dtype: str) -> str:
        mine = [r for r in rows if r["dtype"] == dtype]
        return percent(
            sum(r["undecided"] for r in mine) / sum(r["pairs"] for r in mine)
        )

    yield (
        "of {} pairs, a tenth of them within 1e-6 of touching, {} got a false one; in "
        "float32 {} were undecided, in float64 {} (",
        f"{sum(r['pairs'] for r in rows):,}",
        none(sum(r["false"] for r in rows)),
        undecided("float32"),
        undecided("float64"),
    )


# The plan


@of()
def printed_plan() -> Claims:
    parcel = jaxbe.Box(np.zeros(3), np.eye(3), np.array([0.3, 0.2, 0.1]))
    fruit = jaxbe.Ellipsoid(np.zeros(3), np.eye(3), np.array([0.4, 0.1, 0.1]))
    facts = jaxbe.scene_facts(parcel, fruit)
    plan = jaxbe.plan("margin", "overlap", scene=facts, tolerance=1e-3)
    first, second = str(plan).splitlines()[:2]
    written = second.partition(" a pair on ")[0].strip()
    yield "# {} # {} a pair on", first.strip(), written


@of("plan")
def plan(results: dict[str, Any]) -> Claims:
    plans = [p for p in results["plans"] if not p["refused"]]
    by = {name: [p for p in plans if p["by"] == name] for name in ("lengths", "sample")}
    counts = {
        name: (
            str(sum(p["kept"] for p in made)),
            str(len(made)),
            str(sum(p["times_fastest"] <= 1.3 for p in made)),
        )
        for name, made in by.items()
    }
    yield (
        "On {} scenes that its table has not seen, in {} of {} plans 99.9 % of {} "
        "pairs keep the tolerance; {} cost at most 1.3 times",
        NUMBERS[len({p["scene"] for p in plans})],
        *counts["lengths"][:2],
        f"{results['pairs']:,}",
        counts["lengths"][2],
    )
    yield "pairs of those scenes {} of {} plans keep it, and {} cost", *counts["sample"]


# Scenes and MJX


@of("scene-fish", "scene-dog-v2", "scene-arm-and-shelf")
def scenes(*results: dict[str, Any]) -> Claims:
    (states,) = {r["states"] for r in results}
    (sample,) = {r["mujoco"]["checked"] for r in results}
    (seed,) = {r["seed"] for r in results}
    yield (
        "models, {} random states each, {} pairs of each",
        f"{states:,}",
        f"{sample:,}",
    )
    yield "--states {} --sample {} --seed {} --json`", *map(str, (states, sample, seed))
    names = "`suite/fish.xml`", "`dog_v2/dog.xml`", "the scene shipped here"
    checks = "between_methods", "certificates", "distance_signs"
    for name, result in zip(names, results, strict=True):
        inside = result["mujoco"]["differing"] - len(result["mujoco"]["disagreements"])
        yield (
            f"| {name} | {{}} M | {{}} | {{}} | {{}} | {{}} |",
            f"{result['between_methods']['compared'] / 1e6:.3g}",
            str(sum(result[check]["differing"] for check in checks)),
            str(result["certificates"]["undecided"]),
            str(len(result["mujoco"]["disagreements"])),
            str(inside),
        )


@of("filter")
def what_filters_keep(results: dict[str, Any]) -> Claims:
    missed, needless = results["missed"], results["needless"]
    yield (
        "Of {} float32 pairs, {} of them within 5 cm of contact, each with a distance "
        "of its own just above its float64 one, {} was lost.",
        f"{sum(r['pairs'] for r in missed):,}",
        f"{round(sum(r['near'] for r in missed), -5):,}",
        none(sum(s["missed"] for r in missed for s in r["steps"].values())),
    )
    kept = needless["kept_a_state"]
    yield (
        "it keeps what is needed, {} pairs a state at distance 0, where bounding "
        "spheres keep {} (",
        f"{kept['steps=1']['0.0']:.2g}",
        f"{kept['bounding spheres']['0.0']:.0f}",
    )


# Examples


@of("example-reach-ppo")
def reach_ppo(results: dict[str, Any]) -> Claims:
    first, *_, last = (point["return"] for point in results["curve"])
    yield (
        "the return of an episode grows from {} to {}; of {} new episodes {} touches a "
        "box and all end within {} cm of the target",
        f"{first:.1f}",
        f"{last:.0f}",
        str(results["episodes"]),
        none(results["touched"]),
        f"{math.ceil(100 * results['left'][-1])}",
    )


@of("example-reach-gradient")
def reach_gradient(results: dict[str, Any]) -> Claims:
    without, with_it = results["last"].values()
    yield (
        "needs no policy: {} steps of optax on the forces",
        str(results["iterations"]),
    )
    yield (
        "(smallest margin {}), with it through the gap ({}), both to within {} mm of "
        "the target",
        *(f"{x['smallest_margin']:.2f}" for x in (without, with_it)),
        f"{math.ceil(1000 * max(without['left'], with_it['left']))}",
    )


@of("example-packing", "example-second-order", "example-trajectory")
def placing(packing: Any, second_order: Any, trajectory: Any) -> Claims:
    yield (
        "`2_packing.py`: {} fruit into a crate among parcels, {} random starts at once",
        *(f"{packing[name]:,}" for name in ("fruit", "starts")),
    )
    steps = {k: v["steps, median"] for k, v in second_order["methods"].items()}
    yield (
        "Newton and Gauss-Newton against first order: {} of the steps, but a Hessian "
        "costs {} gradients",
        About(steps["Newton"] / steps["L-BFGS"]),
        f"{second_order['hessian_by_gradient']:.0f}",
    )
    yield (
        "through two slots, {} way point proved {} cm clear",
        "each" if trajectory["proved"] == trajectory["points"] else "not every",
        f"{100 * trajectory['clearance']:.0f}",
    )


# The paper and the verdicts


@of("published")
def published(results: dict[str, Any]) -> Claims:
    everything, *bands = (results["bands"][b] for b in ("all", "1-2", "2-10", "10-40"))
    pairs = everything["separated"] + everything["overlapping"]
    yield "On {} random pairs, half extents", f"{pairs + results['left_out']:,}"
    rows = {
        f"{name}, as published": [f"{name}, published"]
        for name in ("All-Features", "Closest-Features", "Minkowski")
    }
    rows["jaxbe, all three"] = [f"jaxbe {m}" for m in METHODS]
    for label, tests in rows.items():
        cells = (wrong(band, tests) for band in (everything, *bands))
        yield f"| {label} |" + " {} |" * 4, *cells


def wrong(band: dict[str, Any], tests: Sequence[str]) -> str:
    """False positives and negatives in per cent, of the worst of the tests."""

    def rate(kind: str, of: str) -> str:
        count = max(band[kind][test] for test in tests)
        return f"{100 * count / band[of]:.1f}" if count else "0"

    positives = rate("false_positives", "separated")
    return f"{positives} / {rate('false_negatives', 'overlapping')}"


@of("verdicts")
def verdicts(results: dict[str, Any]) -> Claims:
    def cell(aspect: str, dtype: str, names: Sequence[str]) -> str:
        rows = [r for r in results["rows"] if r["scene"] in names]
        rows = [r for r in rows if (r["aspect"], r["dtype"]) == (aspect, dtype)]
        found = [r[m] for r in rows for m in METHODS]
        furthest = max(f["furthest"] for f in found)
        return f"{furthest:.1e}".replace("e-0", "e-") if furthest else "none wrong"

    one = [r for r in results["rows"] if (r["aspect"], r["dtype"]) == ("40", "float32")]
    near = [r["scene"] for r in one if r["scene"].startswith("near touching")]
    rest = [r["scene"] for r in one if r["scene"] not in ("random", *near)]
    labels = {
        "{} random pairs": ["random"],
        "{} near touching (1e-9, 1e-6, 1e-4)": near,
        "{} flat, spheres, aligned, 1e-15 m, 1e15 m, near touching": rest,
    }
    for label, names in labels.items():
        yield (
            f"| {label} |" + " {} |" * 4,
            f"{sum(r['pairs'] for r in one if r['scene'] in names):,}",
            *(cell(a, d, names) for d in DTYPES for a in ("40", "1000")),
        )


@of("extremes")
def extremes(results: dict[str, Any]) -> Claims:
    cells = extremes_report.cells(results)
    worst = {
        row: max(c.ratio for c in cells if c.row == row)
        for row in ("overlap", "scaled_distance", "margin")
    }
    lost = sum(c.lost for c in cells if c.row != "overlap")
    yield (
        "the few wrong verdicts are at {} or less of what rounding the inputs decides, "
        "`scaled_distance` and `margin` lose at most {} times what that rounding must "
        "lose, and {} answer or derivative is NaN",
        About(worst["overlap"]),
        f"{max(worst['scaled_distance'], worst['margin']):.0f}",
        "no" if not lost else str(lost),
    )
