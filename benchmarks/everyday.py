"""The largest errors in scenes as people build them: round, aligned, on a lattice.

Run from the repository root:

    python -m benchmarks.everyday

Every function at its default steps. Errors of margins are relative to max(1, growth
distance); those of distances and contacts to the pair's reach, its longest length plus
the distance of the centres; those of gradients as `benchmarks.accuracy` has them. A
contact's contract is that on_box - on_ellipsoid is distance times normal.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

import jaxbe
from benchmarks import accuracy, machine, report, scenes, settings
from benchmarks.settings import Setting

KINDS: dict[str, Callable[[scenes.Scene], scenes.Scene]] = {
    "random": lambda s: s,
    **scenes.ROUND_OR_ALIGNED,
}

JUDGED = {
    setting: setting.answers[0]
    for setting in settings.JUDGED
    if setting.is_default
    and (setting.function == "margin" or setting.name.startswith("signed_distance,"))
}
"""What `accuracy.judge` judges here, and as what."""

MOST = {k: v for k, v in accuracy.MOST.items() if k in JUDGED.values()}
"""What the truth of a gradient is taken from."""


def measure(pairs: int, seed: int, tick: Callable[[], Any]) -> list[dict[str, Any]]:
    """One entry for each kind of scene and dtype."""
    entries = []
    for kind, bend in KINDS.items():
        scene = bend(scenes.random(pairs, seed))
        for dtype in settings.DTYPES:
            errors = _errors(scene.astype(dtype))
            entries.append({"scene": kind, "dtype": dtype, **errors})
            tick()
    return entries


def _errors(scene: scenes.Scene) -> dict[str, Any]:
    """By column: a count, and the largest error of each kind."""
    true = accuracy.Truth(scene, MOST)
    overlap = Setting("overlap", ("method", jaxbe.METHODS[0]))
    verdicts = accuracy.judge(overlap, settings.VERDICT, true)
    wrong = {"wrong verdicts": verdicts["false_overlap"] + verdicts["missed"]}
    largest = {
        answer: accuracy.judge(setting, answer, true)["error"]["max"]
        for setting, answer in JUDGED.items()
    }
    return wrong | largest | _contract_errors(scene)


def _contract_errors(scene: scenes.Scene) -> dict[str, float]:
    found = settings.under_vmap(Setting("contact", ("steps", settings.DISTANCE_STEPS)))(
        *scene.bodies()
    )
    contact = jaxbe.Contact(*(np.asarray(x, np.float64) for x in found))
    between = contact.on_box - contact.on_ellipsoid
    rest = between - contact.distance[:, None] * contact.normal
    error = np.linalg.norm(rest, axis=1) / reach(scene)
    apart = contact.distance > 0
    return {
        "contract, apart": float(np.max(error[apart], initial=0)),
        "overlapping": float(np.max(error[~apart], initial=0)),
    }


def reach(scene: scenes.Scene) -> np.ndarray:
    """The longest length plus the distance of the centres, (n,)."""
    scene = scene.astype(np.float64)
    longest = np.max(np.concatenate([scene.e, scene.a], axis=1), axis=1)
    return longest + np.linalg.norm(scene.K - scene.C, axis=1)


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    header = tuple(numbers["errors"][0])
    rows = [tuple(map(_cell, e.values())) for e in numbers["errors"]]
    return f"""\
# Round and aligned scenes

{numbers["pairs"]:,} pairs of each kind (seed {numbers["seed"]}), lengths from 0.05 to \
2 m or whole numbers, functions at their default steps; the *largest* errors. Margins \
relative to max(1, growth distance); distances and gradients as in the report on \
accuracy; contracts (on_box - on_ellipsoid against distance times normal) relative to \
the longest length plus the distance of the centres. A contact of bodies that overlap \
keeps it as far as the search for the shortest way out has come. Wrong verdicts are of \
balls of a lattice that touch exactly: the rounding of their own axes decides there.

{report.table(header, rows)}

{report.machine_lines(numbers["machine"])}"""


def _cell(x: str | float) -> str:
    return f"{x:.1e}" if isinstance(x, float) else str(x)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=10_000, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="500 pairs: a look")
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs = min(options.pairs, 500)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", True)
    numbers: dict[str, Any] = {
        "machine": machine.describe(),
        "pairs": options.pairs,
        "seed": options.seed,
    }
    with report.progress_bar() as progress:
        bar = progress.add_task("everyday", total=len(KINDS) * len(settings.DTYPES))
        numbers["errors"] = measure(
            options.pairs, options.seed, lambda: progress.advance(bar)
        )
    report.write(options, text(numbers), numbers)


if __name__ == "__main__":
    main()
