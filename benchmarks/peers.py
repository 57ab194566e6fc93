"""jaxbe beside other systems: speed on one core, and who is wrong.

Run from the repository root, with the extra `bench`:

    python -m benchmarks.peers

Speed: every system on the same random pairs, of which slow ones get the first few, in
turn (see `benchmarks.timing`), in a child process that has one core. Correctness: all
on every kind of pairs of `benchmarks.peer_scenes` (see `benchmarks.peer_verdicts`). A
system that is not installed, or fails, is reported and left out. Nothing is fetched but
the headers of ellipsoid-tree, by pip; the system's C++ compiler builds its core.
Differentiable-growth-distance has no package on PyPI.
"""

from __future__ import annotations

import argparse
import functools
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from benchmarks import (
    machine,
    one_core,
    peer_adapters,
    peer_scenes,
    peer_verdicts,
    peers_report,
    report,
    scenes,
    timing,
)
from benchmarks.peer_adapters import ADAPTERS, Adapter, Answer, Peer

SEED = 6

Failures = dict[str, str]
"""Why what is left out is left out."""


def attempt(
    name: str, make: Callable[[], Any], failures: Failures, default: Any = None
) -> Any:
    """The result of `make`; what it raises is noted, and the default returned."""
    try:
        return make()
    except Exception as error:  # A peer may raise anything; none is fatal.
        first = (str(error).strip().splitlines() or [""])[0]
        failures[name] = f"{type(error).__name__}: {first}"
        return default


def versions(adapters: Mapping[str, Adapter], failures: Failures) -> dict[str, str]:
    """Of the packages installed."""
    found = {
        name: attempt(name, functools.partial(peer_adapters.version, a.package), {})
        for name, a in adapters.items()
        if name not in failures
    }
    return {name: version for name, version in found.items() if version}


def peers_of(
    adapters: Mapping[str, Adapter],
    pairs: Callable[[Adapter], scenes.Scene],
    folder: Path,
    failures: Failures,
) -> list[Peer]:
    """The peers of all adapters that work."""
    found = []
    for name, adapter in adapters.items():
        make = lambda a=adapter: list(a.peers(pairs(a), folder))  # noqa: E731
        found += attempt(name, make, failures, [])
    return found


def speed(
    adapters: Mapping[str, Adapter],
    pairs: int,
    repeats: int,
    folder: Path,
    tick: Callable[[], Any],
) -> dict[str, Any]:
    """Times all systems in turn; peers get the first of the pairs."""
    scene, failures = scenes.random(pairs), {}
    systems = [
        *peer_adapters.jaxbe_by_components(scene),
        *peer_adapters.jaxbe_verdicts(scene),
        *peers_of(adapters, lambda a: scene.part(slice(a.pairs)), folder, failures),
    ]
    tasks, timed = {}, {}
    for peer in systems:
        attempt(peer.name, peer.run, failures)
        if peer.name not in failures:
            timed[peer.name], tasks[peer.name] = peer, timing.Task(peer.run)
            if peer.spheres:
                tasks[f"{peer.name}, spheres"] = timing.Task(peer.spheres)
    measured = timing.interleaved(tasks, repeats, tick)
    return {
        "repeats": repeats,
        "rounds": measured.rounds,
        "cores_busy_with_others": measured.others,
        "failures": failures,
        "systems": {
            name: timings(peer, measured.times) for name, peer in timed.items()
        },
    }


def timings(peer: Peer, times: Mapping[str, timing.Timing]) -> dict[str, Any]:
    """Rates of one system, and what its loop costs where that is Python's."""
    time = times[peer.name]
    numbers = {
        "dtype": peer.dtype,
        "looped_in": peer.looped_in,
        "pairs": peer.pairs,
        "seconds": time._asdict(),
        "pairs_per_second": peer.pairs / time.median,
    }
    if not peer.spheres:
        return numbers
    spheres = times[f"{peer.name}, spheres"].median
    return numbers | {
        "spheres_per_second": peer.pairs / spheres,
        "pairs_per_second_less_spheres": peer.pairs / max(time.median - spheres, 1e-12),
    }


def correctness(
    adapters: Mapping[str, Adapter], n: int, folder: Path, tick: Callable[[], Any]
) -> list[dict[str, Any]]:
    """Judges all systems on every kind of pairs."""
    return [
        judged(kind, make(n, SEED), adapters, folder, tick)
        for kind, make in peer_scenes.KINDS.items()
    ]


def judged(
    kind: str,
    pairs: scenes.Scene,
    adapters: Mapping[str, Adapter],
    folder: Path,
    tick: Callable[[], Any],
) -> dict[str, Any]:
    """Judges all systems on one kind."""
    failures: Failures = {}
    systems = [
        *peer_adapters.jaxbe_verdicts(pairs),
        *peers_of(adapters, lambda _: pairs, folder, failures),
    ]
    answers: dict[str, Answer] = {}
    for peer in systems:
        if found := attempt(peer.name, peer.answer, failures):
            answers[peer.name] = found
    said = [(p.name, p.dtype, answers[p.name]) for p in systems if p.name in answers]
    tick()
    return peer_verdicts.judge(kind, pairs, said) | {"failures": failures}


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Both parts, with a progress bar each."""
    chosen = options.only or list(ADAPTERS)
    adapters = {name: ADAPTERS[name] for name in chosen}
    numbers: dict[str, Any] = {"machine": machine.describe()}
    with report.progress_bar() as progress, tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        bar = progress.add_task("correctness", total=len(peer_scenes.KINDS))
        tick = functools.partial(progress.advance, bar)
        numbers["correctness"] = correctness(adapters, options.judged, folder, tick)
        bar = progress.add_task("speed", total=options.repeats)
        tick = functools.partial(progress.advance, bar)
        numbers["speed"] = speed(adapters, options.pairs, options.repeats, folder, tick)
    numbers["versions"] = versions(adapters, numbers["speed"]["failures"])
    return numbers


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--pairs", type=int, default=1_000_000, help="timed; slow systems get fewer"
    )
    parser.add_argument(
        "--judged", type=int, default=300, metavar="PAIRS", help="judged, of each kind"
    )
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument(
        "--only", nargs="+", choices=ADAPTERS, metavar="PEER", help="leave out others"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="20,000 pairs, 50 of each kind and 3 repeats at most: a look, no result",
    )
    report.add_output_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.pairs = min(options.pairs, 20_000)
        options.judged = min(options.judged, 50)
        options.repeats = min(options.repeats, 3)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, prints, writes; in a process of one core."""
    options = parse(arguments)
    if one_core.done_by_child("benchmarks.peers", arguments):
        return
    jax.config.update("jax_enable_x64", True)
    numbers = measure(options)
    report.write(options, peers_report.text(numbers), numbers)


if __name__ == "__main__":
    main()
