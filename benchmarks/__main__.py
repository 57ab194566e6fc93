"""The whole suite by one command, or some of its parts.

Run from the repository root, with the extra `bench`:

    python -m benchmarks

measures the parts of the suite in turn, each in a process of its own, and writes
benchmarks/results/PART-DEVICE.json, .md and figures; `--quick` is a look at small sizes
that writes to a folder you name. Parts that one names run alone, those of MORE too.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

RESULTS = Path("benchmarks/results")

PLAN_TABLE = Path("jaxbe/frontier.json")
"""What `jaxbe.plan` reads: of the suite's results on a CPU."""


class Part(NamedTuple):
    """One benchmark of its own module.

    Attributes:
        what: it measures.
        options: besides --json and --markdown; {NAME} is the stem of a part's results.
        has_quick: whether it knows --quick.
        needs: parts whose results it reads.
        is_of_this_device: whether its results are named after the device at hand.
    """

    what: str
    options: tuple[str, ...] = ()
    has_quick: bool = True
    needs: tuple[str, ...] = ()
    is_of_this_device: bool = True


SUITE = {
    "throughput": Part(
        "pairs a second of every setting, by dtype and layout; memory, compile time",
        ("--figure", "{throughput}.png"),
    ),
    "limit": Part(
        "the machine's bandwidth and arithmetic rate, and the shares reached",
        ("--throughput", "{throughput}.json"),
        needs=("throughput",),
    ),
    "accuracy": Part("errors and wrong verdicts of every setting by kind of scene"),
    "frontier": Part(
        "speed against error, and the table of jaxbe.plan",
        (
            *("--throughput", "{throughput}.json", "--accuracy", "{accuracy}.json"),
            *("--figures", "{frontier}", "--table", "{table}"),
        ),
        has_quick=False,
        needs=("throughput", "accuracy"),
    ),
    "plan": Part(
        "whether jaxbe.plan keeps its word on scenes it has not seen",
        ("--throughput", "{throughput}.json"),
        needs=("throughput", "frontier"),
    ),
    "extremes": Part(
        "errors against the inputs' conditioning at all sizes, shapes and distances",
        ("--figure", "{extremes}.png"),
    ),
    "against_c": Part("jaxbe beside a hand-written C loop"),
    "peers": Part("speed and wrong verdicts of other libraries on the same pairs"),
}
"""What `python -m benchmarks` runs, in this order."""

MORE = {
    "everyday": Part("the largest errors in round and aligned scenes"),
    "growth": Part("the cost of a pair by the batch, on one core"),
    "limitations": Part("the figures of the README's limitations"),
    "verdicts": Part("how near to touching a verdict can be wrong", (), False),
    "certificates": Part("whether certificates prove their verdicts"),
    "distances": Part("distances and depths beside MuJoCo C, and the least depth"),
    "published": Part("how wrong the paper's pseudocode is", (), False),
    "margin_knob": Part(
        "the margin by steps", ("--figure", "{margin_knob}.png"), False
    ),
    "margin_speed": Part("the margin's gradients, and coal", (), False),
    "margin_continuity": Part(
        "how smooth the margin is", ("--figure", "{margin_continuity}.png"), False
    ),
    "one_sided": Part("pairs that a filter by the margin drops", (), False),
    "contact_speed": Part("contacts beside MuJoCo C", (), False),
    "filter": Part("the filter of MJX's contacts", (), False),
    "placement": Part(
        "placing by the margin's gradient, and by what else there is",
        ("--figure", "{placement}.png"),
    ),
    "programs": Part(
        "programs compiled for an H100 and a TPU that are not there",
        is_of_this_device=False,
    ),
}
"""More parts, run if named."""

PARTS = SUITE | MORE


def device() -> str:
    """A short name of the machine's accelerator, for files."""
    # In a process of its own: JAX takes an accelerator's memory for as long as it runs.
    words = [sys.executable, "-c", "import jax; print(jax.devices()[0].device_kind)"]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    return re.sub(r"[^a-z0-9]+", "-", done.stdout.lower()).strip("-")


def command(name: str, folder: Path, quick: bool, label: str) -> list[str]:
    """What runs a part."""
    stems = {
        name: str(folder / f"{name.replace('_', '-')}{'-' * bool(end)}{end}")
        for name, part in PARTS.items()
        for end in [label if part.is_of_this_device else ""]
    }
    stems["table"] = str(folder / f"plan-table-{label}.json")
    if (folder, label) == (RESULTS, "cpu"):
        stems["table"] = str(PLAN_TABLE)
    part = PARTS[name]
    options = [option.format(**stems) for option in part.options]
    if quick and part.has_quick:
        options.append("--quick")
    files = ["--json", f"{stems[name]}.json", "--markdown", f"{stems[name]}.md"]
    return [sys.executable, "-m", f"benchmarks.{module(name)}", *options, *files]


def module(name: str) -> str:
    """The file that has the part."""
    return "plan_check" if name == "plan" else name


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    lines = [f"  {name:<18}{part.what}" for name, part in PARTS.items()]
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=(__doc__ or "").partition("\n")[0],
        epilog="parts:\n" + "\n".join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help="default: the suite")
    parser.add_argument("--folder", type=Path, default=RESULTS, help="for the results")
    parser.add_argument(
        "--quick", action="store_true", help="small sizes; needs another --folder"
    )
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.parts) - set(PARTS))
    if unknown:
        parser.error(f"no such part: {', '.join(unknown)}")
    if options.quick and options.folder == RESULTS:
        parser.error("--quick is no result: name another --folder")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the parts; how many failed."""
    options = parse(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    parts = options.parts or list(SUITE)
    label, failed = device(), []
    for number, name in enumerate(parts, start=1):
        print(f"[{number}/{len(parts)}] {name}: {PARTS[name].what}", file=sys.stderr)
        if set(PARTS[name].needs) & set(failed):
            failed.append(name)
            print("    left out: a part that it needs has failed", file=sys.stderr)
            continue
        start = time.perf_counter()
        words = command(name, options.folder, options.quick, label)
        if subprocess.run(words, stdout=subprocess.DEVNULL).returncode:
            failed.append(name)
        print(f"    {time.perf_counter() - start:.0f} s", file=sys.stderr)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
