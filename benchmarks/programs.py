"""The programs that an H100 and a TPU v5e would run, compiled without them.

Run from the repository root, with the extra `compilers`, once with each jax:

    JAX_PLATFORMS=cpu python -m benchmarks programs

A run replaces the results of its own devices, jax, dtype and pairs, but for programs
that it leaves out, if they are of the same code. `--check` measures nothing: it says
which results are of the code as it is.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import absent_device, programs_report, report
from benchmarks.program_list import PROGRAMS

RESULTS = Path("benchmarks/results/programs.json")
ROOT = Path(__file__).parents[1]
COMPILERS = {"jaxlib", "jax-cuda12-plugin", "nvidia-cuda-nvcc-cu12", "libtpu"}
QUICK = ("overlap, closest_features", "scaled_distance")


def receipt() -> str:
    """A hash of the sources of jaxbe, names and text."""
    found = hashlib.sha256()
    for file in sorted((ROOT / "jaxbe").rglob("*.py")):
        name = file.relative_to(ROOT).as_posix()
        found.update(f"{name}\n{file.read_text()}\n".encode())
    return found.hexdigest()[:16]


def measure(
    device: str, name: str, pairs: int, dtype: str, limit_seconds: float
) -> dict[str, Any]:
    """One program, compiled in a process of its own; `error` says why there is none."""
    if lacking := absent_device.missing(device):
        return {"program": name, "error": lacking}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        words = [device, folder, str(pairs), dtype, name]
        added = absent_device.environment(device, Path(folder))
        found = _run(["benchmarks.program_list", *words], added, limit_seconds)
    return {"program": name} | found


def _run(
    words: Sequence[str], added: Mapping[str, str], limit_seconds: float
) -> dict[str, Any]:
    """What a module prints as JSON; its own processes end with it."""
    child = subprocess.Popen(
        [sys.executable, "-m", *words],
        env=os.environ | added,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        out, said = child.communicate(timeout=limit_seconds)
    except subprocess.TimeoutExpired:
        return {"error": f"took longer than {limit_seconds:g} s"}
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
    if child.returncode:
        last = (said.strip().splitlines() or [""])[-1]
        return {"error": f"ended with {child.returncode}: {last[:300]}"}
    return dict(json.loads(out.splitlines()[-1]))


def measure_set(
    device: str, names: Sequence[str], options: argparse.Namespace
) -> dict[str, Any]:
    """The programs for a device, and what they were compiled with."""
    found = {
        "device": device,
        "jax": importlib.metadata.version("jax"),
        "dtype": options.dtype,
        "pairs": options.pairs,
        "date": datetime.date.today().isoformat(),
        "receipt": receipt(),
        "versions": {
            d.name: d.version
            for d in importlib.metadata.distributions()
            if d.name in COMPILERS
        },
        "cores": os.cpu_count(),
        "rows": [],
    }
    for number, name in enumerate(names, start=1):
        head = f"{device} [{number}/{len(names)}] {name}: "
        print(head, end="", file=sys.stderr, flush=True)
        row = measure(device, name, options.pairs, options.dtype, options.limit_seconds)
        shown = programs_report.cells(row, found).items()
        print(", ".join(f"{k} {v}" for k, v in shown if v), file=sys.stderr)
        found["rows"].append(row)
    return found


def merged(
    before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """The sets of both, in order; a later one takes the place of its like.

    Rows that only the one before has stay if it is of the same sources.
    """
    sets = {_key(one): one for one in before}
    for one in after:
        rows = {row["program"]: row for row in one["rows"]}
        old = sets.get(_key(one))
        if old and old["receipt"] == one["receipt"]:
            rows = {row["program"]: row for row in old["rows"]} | rows
        sets[_key(one)] = one | {"rows": [*rows.values()]}
    return [sets[key] for key in sorted(sets)]


def _key(one: Mapping[str, Any]) -> tuple[Any, ...]:
    """Of results that belong into one table; in the order of the report."""
    version = tuple(map(int, re.findall(r"\d+", one["jax"])))
    return one["device"], version, one["dtype"], one["pairs"]


def check(sets: Sequence[Mapping[str, Any]]) -> int:
    """Says whether results are of the code as it is; how many are not, or lacking."""
    now, others = receipt(), 0
    for device in sorted(set(absent_device.DEVICES) - {one["device"] for one in sets}):
        others += 1
        print(f"{device}: no results")
    for one in sets:
        is_of_now = one["receipt"] == now
        others += not is_of_now
        of = "the code as it is" if is_of_now else f"another, of {one['date']}"
        print(f"{one['device']}, jax {one['jax']}, {one['dtype']}: of {of}")
    return others


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    devices = tuple(absent_device.DEVICES)
    parser.add_argument("--devices", nargs="+", choices=devices, default=devices)
    parser.add_argument("--programs", nargs="+", choices=PROGRAMS, metavar="NAME")
    parser.add_argument("--pairs", type=int, default=1 << 20)
    parser.add_argument("--dtype", choices=("float32", "float64"), default="float32")
    parser.add_argument("--limit-seconds", type=float, default=600, help="of a program")
    parser.add_argument("--quick", action="store_true", help="two programs: a look")
    parser.add_argument(
        "--check", action="store_true", help="are results of this code?"
    )
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    options.programs = options.programs or (QUICK if options.quick else tuple(PROGRAMS))
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures, prints, writes: how many failed. Or checks."""
    options = parse(arguments)
    file = options.json or RESULTS
    before = json.loads(file.read_text())["sets"] if file.exists() else []
    if options.check:
        return check(before)
    for lacking in filter(None, map(absent_device.missing, options.devices)):
        sys.exit(f"{lacking} (or name --devices without it)")
    names = [name for name in PROGRAMS if name in options.programs]
    new = [measure_set(device, names, options) for device in options.devices]
    sets = merged(before if options.json else [], new)
    report.write(options, programs_report.text(sets, receipt()), {"sets": sets})
    return sum("error" in row for one in new for row in one["rows"])


if __name__ == "__main__":
    sys.exit(main())
