"""The report of `benchmarks.filter`."""

from __future__ import annotations

from typing import Any

from benchmarks import report


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    parts = [
        "# The contact filter",
        _missed(numbers["missed"]),
        _needless(numbers["needless"]),
        _throughput(numbers["throughput"], numbers["needless"]["pairs"]),
        _savings(numbers["savings"]),
    ]
    if "step" in numbers:
        parts.append(_step(numbers["step"]))
    return "\n\n".join([*parts, report.machine_lines(numbers["machine"])])


def _missed(kinds: list[dict[str, Any]]) -> str:
    header = ("scene", "steps", "pairs", "missed", "slack used, %", "apart, kept at 0")
    rows = [
        (
            kind["kind"],
            steps,
            f"{kind['pairs']:,}",
            f"{found['missed']:,}",
            f"{100 * found['largest_share_of_slack']:.1f}",
            f"{found['apart_kept']:,}",
        )
        for kind in kinds
        for steps, found in kind["steps"].items()
    ]
    total = sum(kind["pairs"] for kind in kinds)
    near = sum(kind["near"] for kind in kinds)
    overlapping = sum(kind["overlapping"] for kind in kinds)
    dropped = sum(x["overlapping_dropped"] for k in kinds for x in k["steps"].values())
    return f"""\
## Missed pairs

{total:,} pairs (states x pairs) in float32, {near:,} of them within 5 cm of contact, \
{overlapping:,} overlapping. Each has a bound of its own, from 1e-9 to 1e-2 m above \
its distance (of the very floats, in float64), and is missed if it is dropped. "Slack \
used": by how much the bound, before the slack for rounding is subtracted, was above \
the distance at most, in % of the slack. Overlapping pairs dropped at distance 0: \
{dropped:,}. "Apart, kept at 0": needlessly; the random ones nearly touch.

{report.table(header, rows)}{_by_mujoco(kinds)}"""


def _by_mujoco(kinds: list[dict[str, Any]]) -> str:
    found = [kind["mujoco"] for kind in kinds if "mujoco" in kind]
    if not found:
        return ""
    return f"""

Not counted as missed: {sum(x["dropped"] for x in found):,} pairs that overlap at the \
poses that MuJoCo C has in float64, by {max(x["largest_depth"] for x in found):.1e} m \
at most, and do not at those that MJX has in float32 (distance 0, one step)."""


def _needless(found: dict[str, Any]) -> str:
    needed = found["kept_a_state"]["needed"]
    rows = [
        (name, *(_with_excess(kept[b], needed[b]) for b in needed))
        for name, kept in found["kept_a_state"].items()
    ]
    return f"""\
## Kept needlessly

Pairs kept a state, of {found["pairs"]} of the shipped scene in {found["states"]:,} \
random states, by distance in metres; in brackets those that are not nearer, in % of \
those that are.

{report.table(("filter", *needed), rows)}"""


def _with_excess(kept: float, needed: float) -> str:
    if kept == needed or not needed:
        return f"{kept:.3f}"
    return f"{kept:.3f} (+{100 * (kept / needed - 1):.3g} %)"


def _throughput(points: list[dict[str, Any]], pairs: int) -> str:
    names = list(points[0]["seconds"])
    rows = [
        (
            f"{point['environments']:,}",
            *(_per_environment(point, name) for name in names),
            f"{pairs * point['environments'] / _median(point, names[0]) / 1e6:.1f}",
            f"{point['cores_busy_with_others']:.2f}",
        )
        for point in points
    ]
    header = ("environments", *names, "M pairs/s, first", "others' cores")
    return f"""\
## Throughput

Microseconds an environment of {pairs} pairs, float32, under vmap and jit; medians of \
interleaved runs. "Others' cores": kept busy by other processes.

{report.table(header, rows)}"""


def _savings(found: dict[str, Any]) -> str:
    rows = [(name, _per_environment(found, name)) for name in found["seconds"]]
    return f"""\
## What is saved

Microseconds an environment, {found["environments"]:,} environments; \
{found["pairs"]} pairs may collide, {found["every_pair"]} are all ellipsoids against \
all boxes, {found["pairs_of_fixed_boxes"]} have a box that never moves. Others kept \
{found["cores_busy_with_others"]:.2f} cores busy. That boxes never move is not made \
use of by the filter: it reads all poses from the state.

{report.table(("what", "microseconds"), rows)}"""


def _step(points: list[dict[str, Any]]) -> str:
    rows = [
        (
            point["contacts"],
            f"{point['environments']:,}",
            _per_environment(point, "step"),
            _per_environment(point, "filter"),
            f"{100 * _median(point, 'filter') / _median(point, 'step'):.2f}",
            f"{point['compile_seconds']:.0f}",
            f"{point['cores_busy_with_others']:.2f}",
        )
        for point in points
    ]
    header = (
        *("step with", "environments", "step, us", "filter, us", "share, %"),
        *("compile step, s", "others' cores"),
    )
    return f"""\
## Share of a step

Microseconds an environment of one `mjx.step` of the shipped scene, in which \
ellipsoids and boxes do not collide (MJX refuses them), and of the filter, both with \
XLA's flag --xla_cpu_use_fusion_emitters=false.

{report.table(header, rows)}"""


def _median(point: dict[str, Any], name: str) -> float:
    return float(point["seconds"][name]["median"])


def _per_environment(point: dict[str, Any], name: str) -> str:
    return f"{1e6 * _median(point, name) / point['environments']:.2f}"
