"""The report as an object, for machines."""

from __future__ import annotations

import json
import math
import platform
from typing import Any

import jax
import mujoco
import numpy as np

import jaxbe
from jaxbe.cli.arguments import Options
from jaxbe.cli.crosscheck import Crosscheck
from jaxbe.cli.report import Report


def as_json(report: Report, options: Options) -> str:
    """The report as one object in one line, all of it ASCII."""
    return json.dumps(_finite(as_object(report, options)), allow_nan=False)


def as_object(report: Report, options: Options) -> dict[str, Any]:
    """The report as JSON's types."""
    totals, check = report.sweep.totals, report.crosscheck
    return {
        "versions": versions(),
        "device": device(),
        "dtype": options.dtype,
        "scene": str(options.scene),
        "qpos": None if options.qpos is None else str(options.qpos),
        "seed": options.seed,
        "states": totals.states,
        "states_overlapping": totals.states_overlapping,
        "pairs": [_pair_object(report, i) for i in range(len(report.sweep.pairs.geom))],
        "methods": {m: method_object(report, m) for m in jaxbe.METHODS},
        "seconds": _besides(totals.seconds) | {"total": report.seconds},
        "compile_seconds": _besides(report.sweep.tests.compile_seconds),
        "between_methods": totals.methods.as_object(),
        "certificates": verdicts(report) | totals.certificates.as_object(),
        "distance_signs": totals.signs.as_object(),
        "mujoco": None if check is None else _crosscheck_object(check),
        "deepest": _deepest_object(report),
        "picture": None if report.picture is None else report.picture._asdict(),
        "agree": report.agree(),
    }


def _finite(value: Any) -> Any:
    """The same with null for NaN and infinity, which JSON has not."""
    if isinstance(value, dict):
        return {key: _finite(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(x) for x in value]
    is_bad = isinstance(value, float) and not math.isfinite(value)
    return None if is_bad else value


def versions() -> dict[str, str]:
    """What took part."""
    return {
        "jaxbe": jaxbe.__version__,
        "jax": jax.__version__,
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def device() -> str:
    """Where the tests ran."""
    first = jax.devices()[0]
    kind = first.device_kind
    return first.platform if kind == first.platform else f"{first.platform} ({kind})"


def _crosscheck_object(check: Crosscheck) -> dict[str, Any]:
    return check._asdict() | {
        "disagreements": [item._asdict() for item in check.disagreements]
    }


def _pair_object(report: Report, pair: int) -> dict[str, Any]:
    results = report.sweep.pairs
    ellipsoid, box = report.names(pair)
    return {
        "ellipsoid": ellipsoid,
        "box": box,
        "geom": results.geom[pair].tolist(),
        "overlapping": int(results.overlapping[pair]),
        "proved_overlapping": int(results.proved_overlapping[pair]),
        "proved_separated": int(results.proved_separated[pair]),
        "undecided": int(results.undecided[pair]),
        "smallest_distance": float(results.smallest_distance[pair]),
        "smallest_scaled_distance": float(results.smallest_scaled_distance[pair]),
        "smallest_margin": float(results.smallest_margin[pair]),
        "mean_margin": float(results.mean_margin()[pair]),
    }


def verdicts(report: Report) -> dict[str, int]:
    """How many pairs in states have each certified verdict."""
    results = report.sweep.pairs
    return {
        "overlapping": int(results.proved_overlapping.sum()),
        "separated": int(results.proved_separated.sum()),
        "undecided": int(results.undecided.sum()),
    }


def method_object(report: Report, method: str) -> dict[str, Any]:
    """What is reported of a test."""
    seconds = report.sweep.totals.seconds[method]
    return {
        "overlapping": report.sweep.totals.overlapping[method],
        "compile_seconds": report.sweep.tests.compile_seconds[method],
        "run_seconds": seconds,
        "pairs_per_second": report.compared() / seconds,
    }


def _besides(seconds: dict[str, float]) -> dict[str, float]:
    """Those that are not of a method."""
    return {name: x for name, x in seconds.items() if name not in jaxbe.METHODS}


def _deepest_object(report: Report) -> dict[str, Any]:
    deepest = report.sweep.deepest
    contact = {name: x.tolist() for name, x in deepest.contact._asdict().items()}
    return deepest._asdict() | {
        "qpos": deepest.qpos.tolist(),
        "contact": contact,
        "overlapping": np.flatnonzero(deepest.overlapping).tolist(),
    }
