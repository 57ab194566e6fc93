"""The report of `benchmarks.peers` in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks import peer_verdicts, report

OURS = {
    "x float32": "jaxbe.overlap, components, float32",
    "x float32, vmap": "jaxbe.overlap, closest_features, float32",
    "x float64, vmap": "jaxbe.overlap, closest_features, float64",
}
"""Columns: how many times as fast is this function of jaxbe?"""


TARGETS = {
    "ellipsoid-tree, C++": 8,
    "coal.collide": 100,
    "coal.distance": 100,
}
"""How many times as fast float32 `jaxbe.overlap` is meant to be."""


def text(numbers: Mapping[str, Any]) -> str:
    """The whole report."""
    speed, kinds = numbers["speed"], numbers["correctness"]
    names = ", ".join(f"{n} {v}" for n, v in numbers["versions"].items())
    parts = [
        "# jaxbe beside its peers",
        f"Versions: {names}.",
        failures(speed, kinds),
        "## Speed on one core",
        f"The same random pairs for all, of which slow systems get the first; medians "
        f"of {speed['repeats']} interleaved rounds of {speed['rounds']}; others "
        f"kept at most {speed['cores_busy_with_others']:.2f} cores busy. Columns of "
        "factors: how many times as fast `jaxbe.overlap` is. Where Python loops over "
        'the pairs, "less the loop" is without the time of the same calls on two '
        "spheres, an upper estimate of what a loop in C would reach.",
        speed_table(speed["systems"]),
        targets(speed["systems"]),
        "## Wrong verdicts",
        f"{kinds[0]['pairs']:,} pairs of each kind, judged exactly on the floats "
        'given, touching counted as overlap. "3 + 20": 3 wrong outside the band around '
        "touching that the README states for the dtype (float32: |sqrt(q) - 1| up to "
        "1e-5 at spreads to 40, 1e-4 to 1000; float64: 1e-12, 1e-10; in proportion to "
        "larger spreads), 20 within. Many wrong on pairs that touch exactly can be a "
        "convention: that system takes touching for apart.",
        verdict_table(kinds),
        "## Errors of distances",
        "Largest error in metres, of pairs that are apart and found so.",
        distance_table(kinds),
        "## Disagreements, settled by exact arithmetic",
        'Pairs on which two systems differ. "Neither": rounding to float32 moved the '
        "pair across touching; each is right about the floats it was given. Each is "
        "listed in the JSON with its numbers, who said what and the truth.",
        disagreement_table(kinds),
        report.machine_lines(numbers["machine"]),
    ]
    return "\n\n".join(part for part in parts if part)


def failures(speed: Mapping[str, Any], kinds: Sequence[Mapping[str, Any]]) -> str:
    """What was left out, and why; empty if nothing was."""
    lines = [f"- {name}: {why}" for name, why in speed["failures"].items()]
    for kind in kinds:
        lines += [
            f"- {name}, on {kind['kind']}: {why}"
            for name, why in kind["failures"].items()
            if name not in speed["failures"]
        ]
    return "\n".join(["Left out:", "", *lines]) if lines else ""


def speed_table(systems: Mapping[str, Any]) -> str:
    """A row a system, the fastest first."""
    columns = {c: systems[n]["pairs_per_second"] for c, n in OURS.items()}
    header = ["system", "loop", "pairs", "M pairs/s", "less the loop", *columns]
    order = sorted(systems, key=lambda n: -systems[n]["pairs_per_second"])
    rows = []
    for name in order:
        s = systems[name]
        rate, net = s["pairs_per_second"], s.get("pairs_per_second_less_spheres")
        rows.append(
            [_with_dtype(name, s["dtype"]), s["looped_in"], f"{s['pairs']:,}"]
            + [f"{rate / 1e6:.3g}", f"{net / 1e6:.3g}" if net else ""]
            + [f"{ours / rate:.3g}" for ours in columns.values()]
        )
    return report.table(header, rows)


def _with_dtype(name: str, dtype: str) -> str:
    return name if name.endswith(dtype) else f"{name}, {dtype}"


def targets(systems: Mapping[str, Any]) -> str:
    """How many times as fast as certain peers, beside what is wanted."""
    rows = []
    for peer, wanted in TARGETS.items():
        if peer not in systems:
            continue
        rates = [systems[n]["pairs_per_second"] for n in list(OURS.values())[:2]]
        s = systems[peer]
        cells = [f"{rate / s['pairs_per_second']:.0f}" for rate in rates]
        net = s.get("pairs_per_second_less_spheres")
        cells += [f"{rate / net:.0f}" if net else "" for rate in rates]
        rows.append([peer, f"{wanted}", *cells])
    header = ["times as fast as", "target", "components", "vmap"]
    header += ["components, less its loop", "vmap, less its loop"]
    return report.table(header, rows) if rows else ""


def verdict_table(kinds: Sequence[Mapping[str, Any]]) -> str:
    """A row a system, a column a kind."""
    return _by_system(kinds, _wrong)


def distance_table(kinds: Sequence[Mapping[str, Any]]) -> str:
    """The same for those that tell distances."""
    return _by_system(kinds, _error)


def _by_system(kinds: Sequence[Mapping[str, Any]], cell: Any) -> str:
    names = list(dict.fromkeys(name for k in kinds for name in k["systems"]))
    rows = [[n, *(cell(k["systems"].get(n)) for k in kinds)] for n in names]
    rows = [row for row in rows if any(row[1:])]
    return report.table(["system", *(k["kind"] for k in kinds)], rows)


def _wrong(judged: Mapping[str, Any] | None) -> str:
    if judged is None:
        return ""
    outside, within = judged["wrong_outside_band"], judged["wrong_within_band"]
    return f"{outside} + {within}" if within else str(outside)


def _error(judged: Mapping[str, Any] | None) -> str:
    if not judged or not judged.get("distances_compared"):
        return ""
    nan = judged["distances_nan"]
    return f"{judged['largest_distance_error']:.0e}" + (f" ({nan} NaN)" if nan else "")


def disagreement_table(kinds: Sequence[Mapping[str, Any]]) -> str:
    """A row a kind."""
    header = ["kind", "pairs", "disagreements", "a peer wrong", "jaxbe wrong"]
    header += ["outside the band", "neither"]
    rows = [
        [k["kind"], f"{k['pairs']:,}"]
        + [f"{n:,}" for n in peer_verdicts.counts(k).values()]
        for k in kinds
    ]
    return report.table(header, rows)
