"""The README's speeds by sentence, and how results files give them.

As `tests.readme_claims`; `python -m tests.readme_figures` compares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from benchmarks import growth
from jaxbe import METHODS
from tests.readme_figures import Claims, of
from tests.readme_format import About, millions, only, power

DTYPES = ("float32", "float64")


def of_setting(
    throughput: dict[str, Any], dtype: str = "float32", layout: str = "vmap"
) -> dict[str, float]:
    """Pairs a second."""
    programs = throughput["throughput"]["programs"]
    rows = (p for p in programs if (p["dtype"], p["layout"]) == (dtype, layout))
    return {p["setting"]: p["pairs_per_second"] for p in rows}


def loops(against_c: dict[str, Any]) -> dict[str, float]:
    """Pairs a second of the first pass."""
    return against_c["passes"]["allocator as it comes"]["pairs_per_second"]


@of("throughput", "margin-speed", "peers")
def margin_speed(throughput: Any, speed: Any, peers: Any) -> Claims:
    rates = of_setting(throughput)
    yield (
        "The margin runs at {} of the speed of `overlap`; value and all 30 gradients "
        "take {} times as long as the value",
        About(rates["margin, 5 steps"] / rates["overlap, closest_features"]),
        f"{rates['margin, 5 steps'] / rates['margin and gradients, 5 steps']:.1f}",
    )
    yield (
        "The gradient of the margin costs some {} its value",
        About(rates["margin, 5 steps"] / rates["margin and gradients, 5 steps"]),
    )
    fast = speed["float32"]["passes"]["allocator as it comes"]["pairs_per_second"]
    times = fast["margin and gradients"] / fast["27 candidates and gradients"]
    yield "are {} times as fast as plain autodiff of an enumeration", f"{times:.0f}"
    systems = peers["speed"]["systems"]
    margin, coal = (
        systems[n]["pairs_per_second"]
        for n in ("jaxbe.margin, float64", "coal.collide")
    )
    yield (
        "in float64 on one core it is {} times as fast as coal",
        f"{margin / coal:.0f}",
    )


@of("contact-speed", "against-c")
def contact_speed(results: dict[str, Any], against_c: dict[str, Any]) -> Claims:
    rates = results["pairs_per_second"]
    yield (
        "a float32 contact takes {} of the time of MuJoCo C's `mj_collision` in "
        "float64, which skips pairs whose bounding spheres are apart: {} M/s against "
        "{} M/s",
        About(rates["mj_collision"] / rates["contact"]),
        *(f"{rates[name] / 1e6:.2g}" for name in ("contact", "mj_collision")),
    )
    yield "It compiles in {} seconds.", f"{results['compile_seconds']['contact']:.0f}"
    fast = loops(against_c)
    times = (
        fast[f"{name}, vmap, 512 bits"] / fast[f"{name}, vmap"]
        for name in ("contact", "margin")
    )
    yield "is {} times as fast, a margin {} times", *(f"{x:.1f}" for x in times)


@of("throughput", "accuracy")
def advice(throughput: dict[str, Any], accuracy: dict[str, Any]) -> Claims:
    rates = of_setting(throughput)
    margin, distance = rates["margin, 5 steps"], rates["signed_distance, 3 steps"]
    yield (
        "a verdict costs {} of a margin, a margin {} of a distance, a bound of the "
        "distance (what the MJX filter goes by) {} of it",
        About(margin / rates["overlap, closest_features"]),
        About(distance / margin),
        About(distance / rates["lower_bound, 1 step"]),
    )
    here = [
        e
        for e in accuracy["errors"]
        if e["scene"] == "random to 40" and e["dtype"] == "float32"
    ]
    settings = {"margin": "margin, 4 steps", "distance": "signed_distance, 2 steps"}
    errors = [
        only(here, setting=setting, answer=answer)["error"]["99.9"]
        for answer, setting in settings.items()
    ]
    yield (
        "have no error left but rounding ({}), but depths want five. Take float64 only "
        "for less than {}, at {} the price",
        *[power(max(errors))] * 2,
        About(margin / of_setting(throughput, "float64")["margin, 5 steps"]),
    )


@of("filter")
def contact_filter(results: dict[str, Any]) -> Claims:
    each = {
        r["environments"]: 1e6
        * r["seconds"]["filter, 16 places"]["median"]
        / r["environments"]
        for r in results["throughput"]
    }
    many = [x for n, x in each.items() if n >= 64]
    pairs = results["needless"]["pairs"]
    yield (
        "On the scene shipped here {} pairs take {} to {} µs an environment (64 to {} "
        "environments: {} to {} M pairs/s; {} µs for one alone)",
        str(pairs),
        f"{math.floor(min(many))}",
        f"{math.ceil(max(many))}",
        str(max(each)),
        *(f"{pairs / x:.0f}" for x in (max(many), min(many))),
        f"{each[1]:.0f}",
    )
    steps = {
        name: list(shares(results, name))
        for name in ("all other contacts", "no contacts")
    }
    with_contacts, without = steps.values()
    yield (
        "for one alone), {} to {} % of an `mjx.step` with all other contacts and {} to "
        "{} % of one without any",
        *(f"{100 * f(with_contacts):.1g}" for f in (min, max)),
        *(f"{100 * f(without):.2g}" for f in (min, max)),
    )
    seconds = {k: v["median"] for k, v in results["savings"]["seconds"].items()}
    fixed = "boxes that never move, from {} state".format
    yield (
        "Pairs that cannot collide and spheres of known size save {} and {} %, boxes "
        "that never move {} %",
        *(
            f"{100 * (1 - seconds[less] / seconds[more]):.0f}"
            for less, more in (
                ("pairs that may collide", "every ellipsoid and box"),
                ("spheres, known", "spheres, sizes an argument"),
                (fixed("one"), fixed("every")),
            )
        ),
    )


def shares(results: dict[str, Any], contacts: str) -> Iterator[float]:
    """Of the filter, of a step with these contacts."""
    for row in results["step"]:
        if row["contacts"] == contacts:
            times = row["seconds"]
            yield times["filter"]["median"] / times["step"]["median"]


@of(
    *("example-push-out", "example-packing", "example-second-order"),
    *("example-trajectory", "example-largest-ellipsoid"),
)
def placing_takes(*results: dict[str, Any]) -> Claims:
    minutes = math.ceil(max(r["seconds"] for r in results) / 60)
    yield "each takes under {} min on two cores", str(minutes)


@of("example-reach-ppo", "example-reach-gradient")
def reaching_takes(*results: dict[str, Any]) -> Claims:
    policy, forces = (About(r["seconds"] / 60) for r in results)
    yield "of the target. {} minutes on two busy cores, mostly compiling", policy
    yield "of the target, in {} min for both (`bench", forces


SPEED_ROWS = {
    "`overlap`, closest_features": "overlap, closest_features",
    "`overlap`, minkowski": "overlap, minkowski",
    "`overlap`, all_features": "overlap, all_features",
    "`margin`": "margin, 5 steps",
    "`margin` and 30 gradients": "margin and gradients, 5 steps",
    "`certify`": "certify",
    "`signed_distance`": "signed_distance, 3 steps",
    "`contact`": "contact, 3 steps",
    "naive enumeration in JAX": "naive",
}


@of("throughput")
def speed(results: dict[str, Any]) -> Claims:
    measured = results["throughput"]
    programs = measured["programs"]
    yield (
        "## Speed {} pairs, two cores of an AMD EPYC, medians of {} interleaved runs",
        f"{measured['pairs']:,}",
        str(measured["rounds"]),
    )

    def cells(program: dict[str, Any]) -> tuple[str, str]:
        return (
            f"{millions(program['pairs_per_second'])} M/s",
            f"{program['share_of_copy']:.2f}",
        )

    for label, setting in SPEED_ROWS.items():
        rows = [p for p in programs if p["setting"] == setting]
        single = only(rows, dtype="float32", layout="vmap")
        double = only(rows, dtype="float64", layout="vmap")
        parts = [
            p for p in rows if (p["dtype"], p["layout"]) == ("float32", "components")
        ]
        middle = " {} | {} |" if parts else " | |"
        yield (
            f"| {label} | {{}} | {{}} |{middle} {{}} | {{}} |",
            *cells(single),
            *(x for part in parts for x in cells(part)),
            cells(double)[0],
            f"{single['trace_seconds'] + single['compile_seconds']:.1f} s",
        )
    ours = [p for p in programs if p["setting"] != "naive" and p["dtype"] == "float32"]
    most = max(p["temporary_bytes_per_pair"] for p in ours)
    yield "keeps at most {} bytes a pair between them", f"{most:.0f}"


@of("against-c")
def beside_c(results: dict[str, Any]) -> Claims:
    fast = loops(results)
    loop = fast[f"C loop, {results['threads']} threads"]
    share = {name: rate / loop for name, rate in fast.items()}
    yield "C loop for the verdict ({} M/s on both cores", f"{loop / 1e6:.0f}"
    names = "overlap", "margin", "margin and gradients", "contact"
    overlap, margin, gradients, contact = (
        [share[f"{name}, {layout}"] for layout in ("vmap", "components")]
        for name in names
    )
    yield (
        "`overlap` is {} times as fast (components {}), `margin` {} of it, with all "
        "gradients {} ({}), `contact` {} ({}).",
        *(f"{x:.1f}" for x in overlap),
        f"{margin[0]:.2f}",
        *(f"{x:.2f}" for x in gradients),
        *(f"{x:.3f}" for x in contact),
    )


PEER_ROWS = {
    "`jaxbe.overlap`, float32": "jaxbe.overlap, closest_features, float32",
    "`jaxbe.overlap`, float64": "jaxbe.overlap, closest_features, float64",
    "`jaxbe.margin`, float32": "jaxbe.margin, float32",
    "`jaxbe.contact`, float32": "jaxbe.contact, float32",
    "ellipsoid-tree, C++": "ellipsoid-tree, C++",
    "MuJoCo C, `mj_collision`": "MuJoCo mj_collision",
    "python-fcl, `collide`": "python-fcl collide",
    "coal, `collide`": "coal.collide",
    "mujoco-warp, CPU": "mujoco-warp, CPU",
    "qpax": "qpax, float64",
    "naive JAX, float32": "naive JAX, float32",
}


@of("peers")
def peers(results: dict[str, Any]) -> Claims:
    kinds, systems = results["correctness"], results["speed"]["systems"]
    judged = f"{sum(k['pairs'] for k in kinds):,}"
    yield "of {} pairs of {} kinds", judged, str(len(kinds))
    yield "| wrong of {} |", judged
    first, *_ = PEER_ROWS.values()
    for label, name in PEER_ROWS.items():
        rate = systems[name]["pairs_per_second"]
        times = systems[first]["pairs_per_second"] / rate
        yield (
            f"| {label} |" + " {} |" * 3,
            f"{rate / 1e6:.3g}",
            f"{times:.3g}",
            str(sum(k["systems"][name]["wrong_outside_band"] for k in kinds)),
        )


@of("limitations")
def limitations(results: dict[str, Any]) -> Claims:
    furthest = max(
        row[method]["furthest"] for row in results["floors"] for method in METHODS
    )
    yield "gave wrong verdicts up to {} from touching", f"{furthest:.0e}"
    yield (
        "further apart than some {} of the largest semi-axis, too",
        f"{results['furthest']['signed_distance']:.0e}",
    )
    times = results["short_last_axis"]
    yield (
        "cost {} (a verdict) to {} times (a distance) as much",
        *(f"{times[name]:.1f}" for name in ("overlap", "signed_distance")),
    )
    *_, below, above = results["expressions"]
    yield (
        "eight steps of the margin in one, {} operations, take {} times as long as "
        "six, {}.",
        f"{above['operations']:,}",
        f"{above['nanoseconds'] / below['nanoseconds']:.0f}",
        f"{below['operations']:,}",
    )


@of("peers")
def python_takes(results: dict[str, Any]) -> Claims:
    systems = results["speed"]["systems"]
    shares = (
        systems[name]["pairs_per_second"] / systems[name]["spheres_per_second"]
        for name in ("python-fcl collide", "coal.collide")
    )
    yield (
        "python-fcl and coal are called from Python, which takes {} and {} % of their",
        *(f"{100 * share:.0f}" for share in shares),
    )


@of("growth")
def cost_by_batch(results: dict[str, Any]) -> Claims:
    names = (
        "overlap, closest_features",
        "margin, 5 steps",
        "margin and gradients, 5 steps",
        "contact, 3 steps",
    )
    changes = [
        f"{100 * growth.furthest(growth.costs_of(name, points)):.0f}"
        for points in results["passes"].values()
        for name in names
    ]
    yield (
        "changes from 10^4 to 10^7 by {} % for a verdict, {} % for a margin (with its "
        "gradients {} %) and {} % for a contact; with freed memory kept for the next "
        "results by {}, {} ({}) and {} %",
        *changes,
    )
