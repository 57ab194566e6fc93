"""What reaches GPUs and TPUs, read and computed without them.

The programs are lowered for them, which takes no compiler of theirs. Their mathematics,
without what is there for a compiler, is evaluated one operation at a time.
"""

import functools
import re

import jax
import numpy as np
import pytest

from benchmarks import everyday, reference
from benchmarks.program_list import PROGRAMS, _shapes
from jaxbe import _xla_primitives
from jaxbe.lower_bound import distance_lower_bound
from tests import without_hints
from tests.processes import python

PAIRS = 64
lower_bound = functools.partial(distance_lower_bound, steps=4)


def of_pair(function):
    """As in PROGRAMS."""
    return lambda pairs, dtype: (function, _shapes(pairs, dtype), pairs)


LOWERED = {
    **PROGRAMS,
    "lower bound": of_pair(lower_bound),
    "gradient of lower bound": of_pair(without_hints.gradient(lower_bound)),
}
"""All public functions, and those of derivatives that the table of programs has."""

UNCUT = ("overlap", "scaled_distance", "lower bound", "filter_contacts")
"""What is small enough to be one program, gradients apart."""

NOT_ELSEWHERE = re.compile(
    r"complex|stablehlo\.(real|imag|case|if|while|custom_call|dot\w*|sort)\b"
)
PACKED = re.compile(r"1\.7592186\d*E\+13")
"""2^44, to tell apart on a CPU in float32 what was packed with a factor of 2^40."""


@functools.cache
def traced(name):
    function, shapes, _ = LOWERED[name](PAIRS, "float32")
    return jax.jit(function).trace(*shapes)


@functools.cache
def text(name, platform):
    return traced(name).lower(lowering_platforms=(platform,)).as_text()


def found(pattern, name, platform):
    return {x.group(0) for x in pattern.finditer(text(name, platform))}


def test_tricks_would_be_found():
    """On a CPU they are there, or else the next tests would pass for nothing."""
    name = "signed_distance, 3 steps"
    assert found(NOT_ELSEWHERE, name, "cpu") >= {"complex", "stablehlo.real"}
    assert found(PACKED, name, "cpu")


@pytest.mark.bulk
@pytest.mark.parametrize("name", LOWERED)
def test_no_trick_reaches_other_platforms(name):
    """No complex number, branch or call; no bits but those of a power of two."""
    on_cpu = text(name, "cpu")
    assert "optimization_barrier" not in on_cpu
    for platform in ("cuda", "tpu"):
        # MJX makes its frames by a product of its own.
        by_mjx = {"stablehlo.dot_general"} if "MJX" in name else set()
        assert found(NOT_ELSEWHERE, name, platform) == by_mjx
        assert found(PACKED, name, platform) == set()
        here = text(name, platform)
        assert here.count("bitcast_convert") == on_cpu.count("bitcast_convert")
        assert here.count("stablehlo.divide") <= on_cpu.count("stablehlo.divide")
        is_cut = not name.startswith(UNCUT) or "gradient" in name
        assert ("optimization_barrier" in here) == is_cut


@functools.cache
def answers(dtype, folder):
    """With what is there for a CPU's compiler, and without it."""
    file = folder / f"{dtype}.npz"
    assert _xla_primitives.IS_ON
    python("-m", "tests.without_hints", file, dtype)
    with np.load(file) as found:
        return without_hints.answers(dtype), dict(found)


@pytest.fixture(params=["float32", pytest.param("float64", marks=pytest.mark.slow)])
def both(request, tmp_path_factory, monkeypatch):
    monkeypatch.setenv("JAXBE_XLA", "off")
    return request.param, *answers(request.param, tmp_path_factory.getbasetemp())


@pytest.mark.bulk
def test_hints_change_no_answer(both):
    """Not by a bit, derivatives included, for random, round and aligned bodies."""
    _, here, without = both
    assert here.keys() == without.keys()
    for name, x in without.items():
        np.testing.assert_array_equal(x, here[name], err_msg=name)
        assert np.all(np.isfinite(x)), name


@pytest.mark.bulk
def test_without_hints_distances_are_right(both):
    """By the value along the normal, the witness points, and the verdicts."""
    dtype, _, without = both
    scene, eps = without_hints.scene_of(dtype), np.finfo(dtype).eps
    size = everyday.reach(scene)
    distance, _, normal, on_box, on_ellipsoid = (
        without[f"contact: {i}"].astype(np.float64) for i in range(5)
    )
    exact = scene.astype(np.float64)
    value = reference.value_along(exact, normal)
    assert np.all(abs(distance - value) <= 8 * eps * size)
    apart = distance > 10 * eps * size
    assert 0.2 < np.mean(apart) < 0.8
    along = on_box - on_ellipsoid - distance[:, None] * normal
    errors = np.linalg.norm(along, axis=1) / size
    assert np.max(errors[apart]) <= {"float32": 3e-6, "float64": 1e-14}[dtype]
    lower, upper = (without[f"distance_bounds: {i}"] for i in range(2))
    assert np.max(((upper - lower) / size)[apart]) <= 1e-5
    deeper = without["signed_distance, 5 steps: 0"] - distance
    assert np.all(deeper >= -10 * eps * size)
    for method in ("closest_features", "all_features", "minkowski"):
        overlaps = without[f"{method}: 0"]
        clear = abs(distance) > 10 * eps * size
        np.testing.assert_array_equal(overlaps[clear], distance[clear] < 0)
