"""What holds rounding included holds with the arithmetic of accelerators.

Certificates, the filter's bounds and the margin's slack, of pairs within 1e-8 to 1e-2
of touching, with quotients and roots up to 3 units in the last place off, products
contracted or not, subnormals flushed or not; judged exactly. No accelerator is needed:
see `tests.accelerator_arithmetic`.
"""

import functools
import itertools
import sys
from collections.abc import Callable
from typing import Any, NamedTuple
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from benchmarks.certificates import holds
from benchmarks.reference import LONG, value_along
from jaxbe import lower_bound
from tests import accelerator_arithmetic as accelerator
from tests import truth
from tests.accelerator_arithmetic import MOVES, Arithmetic, evaluate
from tests.margin_reference import KINDS, LOWS

# The claims


SLACK = lower_bound.ROUNDINGS
"""As it is before a test makes it smaller."""


class Claim(NamedTuple):
    """A function, and how much of the room that its claim leaves it takes.

    Attributes:
        function: of two bodies.
        fraction: (n,), of a scene and the results: above 1 the claim is false.
    """

    function: Callable[..., Any]
    fraction: Callable[..., np.ndarray]


def certificates() -> Claim:
    """No certificate is false: neither verdict nor proof."""
    return Claim(lambda *bodies: tuple(jaxbe.certify(*bodies)), fraction_of_proofs)


def bounds(steps: int) -> Claim:
    """The filter's bound, and the directions along which it was evaluated."""

    def function(box: Any, ellipsoid: Any) -> tuple[Any, ...]:
        directions = []

        def times(*arguments: Any) -> Any:
            directions.append(original(*arguments))
            return directions[-1]

        original = lower_bound.times
        with mock.patch.object(lower_bound, "times", times):
            # The function without its derivatives: the directions leave it.
            bound = lower_bound.distance_lower_bound.__wrapped__(box, ellipsoid, steps)
        return bound, *(jnp.stack(w, axis=-1) for w in directions)

    return Claim(function, fraction_of_slack)


def margins(steps: int) -> Claim:
    """The margin of a pair that overlaps is at most `rounding_slack`."""
    function = functools.partial(jaxbe.margin, steps=steps)
    return Claim(lambda *bodies: function(*bodies), fraction_of_rounding_slack)


def fraction_of_proofs(pairs, verdict, point, direction) -> np.ndarray:
    """2 where a verdict or its proof is false, 0 elsewhere."""
    scene = pairs.scene
    assert set(verdict.tolist()) == {-1, 0, 1}
    inside = np.all(abs(point) <= scene.e, axis=1)
    x = np.where(inside[:, None], point, 0).astype(np.float64)
    sizes = np.sum(abs(scene.K - scene.C) + scene.e + scene.a, axis=1)
    with np.errstate(invalid="ignore"):
        proved = np.where(
            verdict > 0,
            inside & truth.proves_overlap(scene, x),
            value_along(scene, -direction) > truth.ROUNDING * sizes,
        )
    for i in np.flatnonzero((verdict != 0) & ~proved):
        proved[i] = holds(truth.exact(scene, i), verdict[i], point[i], direction[i])
    right = proved & ((verdict > 0) == pairs.overlapping)
    return np.where((verdict != 0) & ~right, 2, 0)


def fraction_of_slack(pairs, bound, *directions) -> np.ndarray:
    """How far the bound is above what these directions prove, had it no slack.

    What any direction proves, in extended precision, is at most the exact distance,
    which for a pair that overlaps is not positive.
    """
    C, _, e, K, _, a = (x.astype(LONG) for x in pairs.scene)
    info = np.finfo(bound.dtype)
    sizes = np.sum(abs(K - C) + e + a, axis=1)
    slack = SLACK * (info.eps * sizes + info.tiny)
    proved = np.max([value_along(pairs.scene, -w) for w in directions], axis=0)
    return (1 + (bound - proved) / slack).astype(np.float64)


def fraction_of_rounding_slack(pairs, margin) -> np.ndarray:
    """The margin of pairs that overlap, over what rounding may make of it."""
    slack = jaxbe.rounding_slack(margin.dtype, 1) * pairs.scene.spread
    return np.where(pairs.overlapping, margin / slack, 0)


CLAIMS: dict[str, Claim] = {
    "certify": certificates(),
    **{f"bound {steps}": bounds(steps) for steps in (0, 1, 2, 3, 4)},
    **{f"margin {steps}": margins(steps) for steps in (0, 1, 3, 5)},
}
"""Of everything that says "rounding included", with its number of steps."""


# The scenes


MOVED_LAST = {
    "tiny": KINDS["tiny"],
    "huge": KINDS["huge"],
    "far": lambda scene: scenes.shifted(scene, 100),
}
"""Once they are near touching: in float32 1e6 metres away nothing is near."""

AT_REST = {
    name: kind
    for name, kind in KINDS.items()
    if "coincident" not in name and name not in MOVED_LAST
}


def spread_out(scene: scenes.Scene) -> scenes.Scene:
    """From coincident to far apart."""
    factor = 10 ** np.random.default_rng(8).uniform(-1, 1, (scene.size, 1))
    return scene._replace(K=scene.C + factor * (scene.K - scene.C))


def near(kind, low: float, n: int, seed: int, eps: float) -> scenes.Scene:
    """Pairs of a kind whose distance from touching is log-uniform, on both sides.

    In float32 from 1e-8 to 1e-2; in float64 as many of its eps. Without those whose
    centres coincide: there is no way to move them.
    """
    rng = np.random.default_rng(seed)
    from_touching = 10 ** rng.uniform(-8, -2, n) * (eps / np.finfo(np.float32).eps)
    scene = kind(scenes.random(n, seed=seed, low=low))
    moved = np.any(scene.K != scene.C, axis=1)
    scene, from_touching = scene.part(moved), from_touching[moved]
    return scenes.near_touching(scene, seed=seed, growth=from_touching)


class Pairs:
    """Pairs to judge."""

    def __init__(self, scene: scenes.Scene) -> None:
        self.scene = scene

    @functools.cached_property
    def overlapping(self) -> np.ndarray:
        """The exact verdicts."""
        return truth.overlaps(self.scene)


@functools.cache
def pairs_of(n: int, dtype: np.dtype) -> Pairs:
    """Of every kind and range of lengths n pairs near touching.

    And some that touch or not by their whole numbers, or are anywhere.
    """
    eps = float(np.finfo(dtype).eps)
    seeds = itertools.count(1000)
    parts = [
        near(kind, low, n, next(seeds), eps)
        for kind in AT_REST.values()
        for low in LOWS.values()
    ]
    parts += [
        kind(near(KINDS["permuted"], low, n, next(seeds), eps))
        for kind in MOVED_LAST.values()
        for low in LOWS.values()
    ]
    parts += [
        kind(scenes.random(n, seed=next(seeds)))
        for kind in (KINDS["lattice"], KINDS["lattice-of-balls"], spread_out)
    ]
    together = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Pairs(scenes.Scene(*together).astype(dtype))


def traced(claim: Claim, scene: scenes.Scene) -> Any:
    """The jaxpr of a claim's function, for all pairs of a scene at once."""
    return jax.make_jaxpr(lambda *bodies: claim.function(*bodies))(*scene.bodies())


def worst_fraction(claim: Claim, pairs: Pairs, how: Arithmetic, jaxpr: Any) -> float:
    """The largest fraction of its room that the claim takes; false if above 1."""
    results, _ = evaluate(jaxpr, pairs.scene, how)
    return float(np.max(claim.fraction(pairs, *results)))


# The tests

QUICK = {"float32": 30, "float64": 6}
FULL = {"float32": 890, "float64": 40}
"""Pairs of a kind, of 90: 2,700 and 80,000 in float32. Float64's truth is slow."""

HOWS = {
    f"{name}, {fraction} contracted, {'no ' * (not flushes)}subnormals flushed":
        Arithmetic(move, fraction, flushes)
    for name, move in MOVES.items()
    for fraction in (0, 0.5, 1)
    for flushes in (False, True)
}  # fmt: skip
"""Every arithmetic that is tried, 42 of them."""

FEWER_HOWS = {name: how for name, how in HOWS.items() if how.contracts != 0.5}
"""Those of a normal run."""


@pytest.mark.bulk
@pytest.mark.parametrize(
    ("sizes", "hows"),
    [(QUICK, FEWER_HOWS), pytest.param(FULL, HOWS, marks=pytest.mark.slow)],
    ids=["some", "many"],
)
@pytest.mark.parametrize("name", CLAIMS)
def test_claims_hold(name, sizes, hows, dtype):
    """With every arithmetic of an accelerator."""
    claim, pairs = CLAIMS[name], pairs_of(sizes[dtype.name], dtype)
    jaxpr = traced(claim, pairs.scene)
    fractions = {k: worst_fraction(claim, pairs, how, jaxpr) for k, how in hows.items()}
    print(f"{name}, {dtype}, {pairs.scene.size} pairs: {max(fractions.values()):.3f}")
    assert not [k for k, fraction in fractions.items() if not fraction <= 1]


@pytest.mark.bulk
@pytest.mark.parametrize(
    ("name", "n"),
    [("bound 0", 30), ("bound 1", 30), ("margin 1", 30)]
    + [pytest.param(x, 100, marks=pytest.mark.slow) for x in CLAIMS if x != "certify"],
)
@pytest.mark.parametrize("contracts", [0, 1])
def test_claims_hold_with_each_result_moved_to_its_wrong_side(name, n, contracts):
    """Wrong for each pair and operation; of a proof it is "toward zero" for all."""
    claim, pairs = CLAIMS[name], pairs_of(n, np.dtype(np.float32))
    jaxpr = traced(claim, pairs.scene)
    plain = Arithmetic(contracts=contracts, flushes=bool(contracts))
    sites = evaluate(jaxpr, pairs.scene, plain).sites
    wrong = accelerator.wrong_sides(
        lambda how: evaluate(jaxpr, pairs.scene, how).results[0], sites, plain
    )
    fraction = worst_fraction(claim, pairs, wrong, jaxpr)
    print(f"{name}, {pairs.scene.size} pairs, {sites} moved: {fraction:.3f}")
    assert worst_fraction(claim, pairs, plain, jaxpr) <= fraction <= 1


def smallest(power: int, dtype: np.dtype) -> Pairs:
    """Pairs near touching, so much larger than the smallest normal float."""
    info = np.finfo(dtype)
    scene = near(KINDS["permuted"], LOWS["aspect40"], 300, 7, float(info.eps))
    return Pairs(scenes.scaled(scene, float(info.tiny) * 10.0**power).astype(dtype))


@pytest.mark.parametrize("name", ["bound 0", "bound 1"])
@pytest.mark.parametrize("power", [1, 2, 4, 8])
def test_bounds_hold_where_floats_end(power, name, dtype):
    """Once 5000 slacks too high: K - C is flushed before it is scaled."""
    claim, pairs = CLAIMS[name], smallest(power, dtype)
    jaxpr = traced(claim, pairs.scene)
    for move, flushes in itertools.product(("exact", "random"), (False, True)):
        how = Arithmetic(MOVES[move], flushes=flushes)
        fraction = worst_fraction(claim, pairs, how, jaxpr)
        assert fraction <= 1, (move, flushes)


SMALLER = {
    "certify": ("jaxbe.certify", "ROUNDINGS"),
    "bound 0": ("jaxbe.lower_bound", "ROUNDINGS"),
    "bound 1": ("jaxbe.lower_bound", "ROUNDINGS"),
}
"""The band or slack of a claim."""


@pytest.mark.parametrize("name", SMALLER)
def test_a_band_that_is_too_small_is_found_out(name, dtype, monkeypatch):
    """Or else the other tests would pass for nothing."""
    module, constant = SMALLER[name]
    monkeypatch.setattr(sys.modules[module], constant, 0)
    claim, pairs = CLAIMS[name], pairs_of(QUICK[dtype.name], dtype)
    jaxpr = traced(claim, pairs.scene)
    for how in (Arithmetic(MOVES["random"]), Arithmetic(MOVES["toward zero"], 1, True)):
        fraction = worst_fraction(claim, pairs, how, jaxpr)
        assert fraction > 1


def test_a_slack_of_zero_is_found_out(dtype):
    """Margins of pairs that overlap are above zero at times."""
    pairs = pairs_of(QUICK[dtype.name], dtype)
    jaxpr = traced(CLAIMS["margin 5"], pairs.scene)
    for move in ("random", "up"):
        (margin,), _ = evaluate(jaxpr, pairs.scene, Arithmetic(MOVES[move]))
        assert np.any(margin[pairs.overlapping] > 0)


@pytest.mark.parametrize("name", ["certify", "bound 4", "margin 5"])
def test_unmoved_it_is_ieee_arithmetic(name, dtype):
    """To the bit what JAX computes one operation at a time; a CPU's flush, too."""
    pairs = pairs_of(QUICK[dtype.name], dtype)
    jaxpr = traced(CLAIMS[name], pairs.scene)
    results, _ = evaluate(jaxpr, pairs.scene, Arithmetic(flushes=True))
    bodies = jax.tree.leaves(pairs.scene.bodies())
    expected = jax.core.eval_jaxpr(jaxpr.jaxpr, jaxpr.consts, *bodies)
    for x, y in zip(results, expected, strict=True):
        np.testing.assert_array_equal(x, y)
