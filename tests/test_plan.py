"""`jaxbe.plan`: the cheapest settings that keep a tolerance, and clear refusals."""

import copy
import dataclasses
import functools
import json
import pickle

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import jaxbe
import jaxbe.mjx
from benchmarks import accuracy, scenes, settings
from jaxbe import plan_errors
from jaxbe.cli.arguments import DEFAULT_SCENE
from jaxbe.plan import ENOUGH, SAFETY
from jaxbe.plan_sample import Sample, upper_quantile, upper_share
from jaxbe.plan_table import frontier, lines

COMMON = jaxbe.SceneFacts(spread=40)


def test_fields_are_keyword_arguments():
    found = jaxbe.plan("overlap", "margin", "contact", scene=COMMON, tolerance=1e-4)
    assert found.dtype == "float32"
    box, ellipsoid = scenes.random(3).astype(np.float32).bodies()
    for name in ("overlap", "margin", "contact"):
        getattr(jaxbe, name)(box, ellipsoid, **getattr(found, name))
    assert found.signed_distance is None
    assert found.filter_contacts is None
    assert found.drop_above is None


def test_printed_it_says_why():
    text = str(jaxbe.plan("margin", scene=COMMON, tolerance=1e-2))
    assert text.startswith("float32:\n  margin(steps=")
    assert "in 99.9 % of pairs at spread 40" in text
    assert "ns a pair" in text


def steps(tolerance, **options):
    options = {"scene": COMMON} | options
    return jaxbe.plan("margin", tolerance=tolerance, **options).margin["steps"]


def test_a_tighter_tolerance_never_takes_fewer_steps():
    counts = [steps(t, dtype="float64") for t in (0.9, 0.3, 1e-1, 1e-2, 1e-4, 1e-8)]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_a_larger_share_of_pairs_never_takes_fewer_steps():
    counts = [steps(1e-6, share=s) for s in (0.99, 0.999, 1.0)]
    assert counts == sorted(counts)


def test_no_cheaper_setting_of_the_table_would_do():
    for tolerance in (1e-1, 1e-3, 1e-6):
        chosen = jaxbe.plan("signed_distance", scene=COMMON, tolerance=tolerance)
        rows = [r for r in lines("signed_distance") if not r.gradients]
        good = [r for r in rows if SAFETY * r.error("distance", 1, COMMON) <= tolerance]
        cheapest = min(good, key=lambda r: r.nanoseconds)
        assert chosen.signed_distance == cheapest.keywords
        assert chosen.dtype == cheapest.dtype


def test_float64_only_where_it_is_needed():
    assert jaxbe.plan("margin", scene=COMMON, tolerance=1e-5).dtype == "float32"
    assert jaxbe.plan("margin", scene=COMMON, tolerance=1e-10).dtype == "float64"
    assert jaxbe.plan("overlap", scene=COMMON, tolerance=1e-4).dtype == "float32"
    assert jaxbe.plan("overlap", scene=COMMON, tolerance=1e-9).dtype == "float64"


def test_without_a_tolerance_it_is_as_accurate_as_the_dtype():
    found = jaxbe.plan("margin", scene=COMMON)
    best = min(
        r.error("margin", 1, COMMON)
        for r in lines("margin")
        if not r.gradients and r.dtype == "float32"
    )
    chosen = next(
        r
        for r in lines("margin")
        if (r.keywords, r.dtype, r.gradients) == (found.margin, "float32", False)
    )
    assert chosen.error("margin", 1, COMMON) <= ENOUGH * best


def test_never_missing_gives_the_slack():
    found = jaxbe.plan("overlap", scene=COMMON, never_miss=True)
    assert found.overlap is None
    assert found.drop_above == jaxbe.rounding_slack("float32", 40)
    box, ellipsoid = scenes.random(5000, seed=9).astype(np.float32).bodies()
    margin = np.asarray(jaxbe.margin(box, ellipsoid, **found.margin))
    kept = ~(margin > found.drop_above)
    overlaps = np.asarray(jaxbe.overlap(box, ellipsoid))
    assert not np.any(overlaps & ~kept)
    assert np.sum(kept & ~overlaps) <= 0.02 * np.sum(~overlaps)


def test_gradients_are_planned_by_their_own_errors():
    """A value is a maximum, right to second order where its gradient is to first."""
    value = jaxbe.plan("margin", scene=COMMON, tolerance=1e-3, share=0.99)
    gradient = jaxbe.plan(
        "margin", scene=COMMON, tolerance=1e-3, share=0.99, gradients=True
    )
    assert gradient.margin["steps"] >= value.margin["steps"]


def test_between_two_spreads_the_error_is_between_theirs():
    low, middle, high = (
        lines("margin")[2].error("margin", 1, jaxbe.SceneFacts(s)) for s in (4, 12, 40)
    )
    assert low < middle < high


def test_in_a_model():
    model = mujoco.MjModel.from_xml_path(str(DEFAULT_SCENE))
    pairs = jaxbe.mjx.find_pairs(model)
    facts = jaxbe.mjx.scene_facts(pairs, model)
    box, ellipsoid = pairs.geom[:, 1], pairs.geom[:, 0]
    smallest = model.geom_size[ellipsoid].min(axis=1)
    longest = np.maximum(
        model.geom_size[box].max(axis=1), model.geom_size[ellipsoid].max(axis=1)
    )
    assert facts.spread == pytest.approx(np.max(longest / smallest))
    assert not facts.spheres
    found = jaxbe.plan("filter_contacts", scene=facts)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    jaxbe.mjx.filter_contacts(pairs, model, data, **found.filter_contacts)


def test_facts_of_a_batch():
    box, ellipsoid = scenes.random(100).bodies()
    facts = jaxbe.scene_facts(box, ellipsoid)
    assert facts.spread == pytest.approx(scenes.random(100).spread.max())
    mean = np.exp(np.mean(np.log(np.sort(scenes.random(100).spread)[-10:])))
    assert facts.upper_spread == pytest.approx(mean)
    assert not facts.spheres
    spheres = scenes.spheres(scenes.random(100)).bodies()
    assert jaxbe.scene_facts(*spheres).spheres


def test_spheres_take_fewer_steps():
    spheres = jaxbe.SceneFacts(spread=40, spheres=True)
    assert steps(1e-4, scene=spheres) <= steps(1e-4)


@pytest.mark.parametrize(
    ("outputs", "options", "error", "message"),
    [
        ((), {}, ValueError, "outputs must be of overlap, margin"),
        (("margn",), {}, ValueError, "got 'margn'"),
        (("margin",), {"scene": 40}, TypeError, "scene must be a SceneFacts, got int"),
        (("margin",), {"dtype": "bfloat16"}, ValueError, "dtype must be"),
        (("margin",), {"share": 0.5}, ValueError, "share must be one of 0.99"),
        (("margin",), {"tolerance": 0.0}, ValueError, "tolerance must be positive"),
        (("margin",), {"tolerance": np.nan}, ValueError, "tolerance must be positive"),
        (("margin",), {"tolerance": True}, TypeError, "a number, got True"),
        (("margin",), {"tolerance": "x"}, TypeError, "tolerance must be .* got 'x'"),
        (("margin",), {"tolerance": [0.1]}, TypeError, r"number, got \[0.1\]"),
        (("margin",), {"share": "x"}, TypeError, "share must be a number, got 'x'"),
        (("margin",), {"share": True}, TypeError, "share must be a number, got True"),
        (("margin",), {"share": np.nan}, ValueError, "share must be one of 0.99"),
        (
            ("margin",),
            {"tolerance": 1e-30},
            ValueError,
            r"the least that is, in float64: margin",
        ),
        (
            ("margin",),
            {"tolerance": 1e-9, "dtype": "float32"},
            ValueError,
            "the least that is, in float32: margin",
        ),
        (
            ("margin",),
            {"gradients": True, "never_miss": True},
            ValueError,
            "no gradients",
        ),
        (
            ("margin",),
            {"scene": jaxbe.SceneFacts(1e7)},
            ValueError,
            "beyond the table",
        ),
    ],
)
def test_refusals_say_what_would_do(outputs, options, error, message):
    with pytest.raises(error, match=message):
        jaxbe.plan(*outputs, **({"scene": COMMON} | options))


def test_any_tolerance_is_the_cheapest_setting():
    """Once: no setting keeps it."""
    rows = [r for r in lines("margin") if r.dtype == "float32" and not r.gradients]
    cheapest = min(rows, key=lambda row: row.nanoseconds)
    found = jaxbe.plan("margin", scene=COMMON, tolerance=np.inf)
    assert found.margin == cheapest.keywords


@pytest.mark.parametrize("number", [np.float32, np.float64, jnp.float32])
def test_numbers_may_be_of_numpy_or_jax(number):
    found = jaxbe.plan(
        "margin", scene=COMMON, tolerance=number(1e-3), share=number(0.99)
    )
    assert (
        found.margin
        == jaxbe.plan("margin", scene=COMMON, tolerance=1e-3, share=0.99).margin
    )


def test_a_plan_is_a_value():
    """It can be stored, sent, copied, and be a key."""
    found = jaxbe.plan("margin", "contact", scene=COMMON, tolerance=1e-3)
    copies = (
        pickle.loads(pickle.dumps(found)),
        copy.deepcopy(found),
        copy.copy(found),
        jaxbe.Plan(**json.loads(json.dumps(dataclasses.asdict(found)))),
    )
    for again in copies[:3]:
        assert again == found
        assert hash(again) == hash(found)
    assert copies[3].margin == found.margin
    assert {found: 1}[copies[0]] == 1
    for again in copies[:3]:
        with pytest.raises(TypeError):
            again.margin["steps"] = 0
        assert again.margin == found.margin


def test_facts_are_checked():
    with pytest.raises(TypeError, match="spread must be a number, got '40'"):
        jaxbe.SceneFacts("40")
    with pytest.raises(ValueError, match=r"spread must be at least 1, got 0\.5"):
        jaxbe.SceneFacts(0.5)
    with pytest.raises(ValueError, match="spread must be at least 1, got nan"):
        jaxbe.SceneFacts(float("nan"))
    with pytest.raises(ValueError, match="upper_spread must be from 1 to 4"):
        jaxbe.SceneFacts(4, upper_spread=5)
    assert jaxbe.SceneFacts(4).upper_spread == 4
    box, ellipsoid = scenes.random(2).bodies()
    flat = jaxbe.Ellipsoid.unchecked(
        ellipsoid.center, ellipsoid.axes, 0 * ellipsoid.semi_axes
    )
    with pytest.raises(ValueError, match="semi_axes positive"):
        jaxbe.scene_facts(box, flat)
    with pytest.raises(TypeError, match="must be known when a plan is made"):
        jax.jit(lambda b, e: jnp.asarray(jaxbe.scene_facts(b, e).spread))(
            box, ellipsoid
        )
    nobody = scenes.random(1).part(slice(0)).bodies()
    with pytest.raises(ValueError, match="has no pair"):
        jaxbe.scene_facts(*nobody)


def test_the_table_has_every_setting_and_says_its_origin():
    assert "python -m benchmarks" in frontier()["command"]
    names = {
        (r["function"], r.get("steps"), r.get("method"), r["gradients"], r["dtype"])
        for r in frontier()["settings"]
    }
    for s in settings.JUDGED:
        for dtype in settings.DTYPES:
            method = s.options.get("method")
            assert (s.function, s.steps, method, s.gradients, dtype) in names


def test_a_plan_cannot_be_changed():
    found = jaxbe.plan("margin", scene=COMMON)
    with pytest.raises(TypeError):
        found.margin["steps"] = 0


def test_a_wide_scene_in_float32_keeps_more_than_it_may():
    """The slack grows with the spread: at 10^5 it is as large as a body."""
    wide = jaxbe.SceneFacts(spread=1e5, upper_spread=1e4)
    found = jaxbe.plan("overlap", scene=wide, never_miss=True, tolerance=0.1)
    assert found.dtype == "float64"
    with pytest.raises(ValueError, match="no setting is sure to keep"):
        jaxbe.plan("overlap", scene=wide, never_miss=True, dtype="float32")


def test_distances_say_that_depths_are_another_matter():
    text = str(jaxbe.plan("contact", scene=COMMON, tolerance=1e-4))
    assert "of pairs apart (depths of overlapping ones to" in text


@pytest.mark.bulk
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-5])
def test_the_tolerance_is_kept_on_scenes_not_in_the_table(tolerance):
    pairs = scenes.random(20_000, seed=77, low=0.03, high=1.1).astype(np.float32)
    facts = jaxbe.scene_facts(*pairs.bodies())
    found = jaxbe.plan("margin", scene=facts, tolerance=tolerance, dtype="float32")
    setting = settings.Setting("margin", ("steps", found.margin["steps"]))
    true = accuracy.margin_scenes.truth(pairs)
    margins = np.asarray(settings.under_vmap(setting)(*pairs.bodies()), np.float64)
    error = abs(margins - true) / np.maximum(1, 1 + true)
    assert np.percentile(error, 99.9) <= tolerance


def aligned(n, seed):
    return scenes.axis_aligned(scenes.random(n, seed=seed)).astype(np.float32).bodies()


EASY = aligned(12_000, 3)
OTHERS = aligned(12_000, 4)
"""Of the same scene."""


def error_on_others(found, share):
    margin = np.asarray(jaxbe.margin(*OTHERS, **found.margin), np.float64)
    wide = jax.tree.map(lambda x: x.astype(np.float64), OTHERS)
    exact = np.asarray(jaxbe.margin(*wide, steps=10))
    return np.quantile(plan_errors.margin_error(margin, exact), share)


def test_a_sample_tells_what_sizes_cannot():
    """Aligned bodies: the exact margin takes fewer steps than their spread suggests."""
    facts = jaxbe.scene_facts(*EASY)
    by_sizes = jaxbe.plan("margin", scene=facts, tolerance=1e-3)
    found = jaxbe.plan("margin", sample=EASY, tolerance=1e-3)
    assert found.margin["steps"] < by_sizes.margin["steps"]
    assert "measured on 12,000" in str(found)
    assert error_on_others(found, 0.999) <= 1e-3


def test_a_sample_of_a_filter():
    facts = jaxbe.scene_facts(*EASY)
    options = {"sample": EASY, "tolerance": 0.05, "never_miss": True}
    found = jaxbe.plan("overlap", scene=facts, **options)
    assert found.drop_above == jaxbe.rounding_slack("float32", facts.spread)
    kept = ~(np.asarray(jaxbe.margin(*OTHERS, **found.margin)) > found.drop_above)
    overlaps = np.asarray(jaxbe.overlap(*OTHERS))
    assert not np.any(overlaps & ~kept)
    assert np.mean(kept[~overlaps]) <= 0.05
    # A wider scene than its sample has a larger slack.
    wide = jaxbe.plan("overlap", scene=jaxbe.SceneFacts(1000), **options)
    assert wide.drop_above == jaxbe.rounding_slack("float32", 1000)
    few = jax.tree.map(lambda x: x[:500], EASY)
    nearest = jaxbe.plan("filter_contacts", sample=few, tolerance=0.5)
    assert set(nearest.filter_contacts) == {"steps"}


def test_a_sample_of_contacts():
    found = jaxbe.plan("contact", sample=EASY, tolerance=1e-3, share=0.99)
    assert "depths of overlapping ones to" in str(found)
    box, ellipsoid = OTHERS
    distance = jaxbe.signed_distance(box, ellipsoid, **found.contact)
    exact = np.asarray(jaxbe.signed_distance(box, ellipsoid, steps=8), np.float64)
    longest = plan_errors.longest_length(
        *(np.asarray(x) for x in (box.half_extents, ellipsoid.semi_axes))
    )
    errors = plan_errors.distance_error(distance, exact, longest)[exact > 0]
    assert np.quantile(errors, 0.99) <= 1e-3
    sides = exact > 0, exact < 0
    apart, inside = (np.resize(np.flatnonzero(x), 12_000) for x in sides)
    none_deep = jax.tree.map(lambda x: x[apart], OTHERS)
    text = str(jaxbe.plan("contact", sample=none_deep, tolerance=1e-3, share=0.99))
    assert "overlapping ones unknown" in text
    deep = jax.tree.map(lambda x: x[inside], OTHERS)
    with pytest.raises(ValueError, match=r"400 pairs apart to tell .* got 0"):
        jaxbe.plan("contact", sample=deep, tolerance=1e-3, share=0.99)
    with pytest.raises(ValueError, match="filter_contacts 1"):
        jaxbe.plan("filter_contacts", sample=deep, tolerance=0.5)


@pytest.mark.slow
def test_a_sample_of_gradients_in_a_scene_that_broadcasts():
    box, ellipsoid = EASY
    one = jax.tree.map(lambda x: x[:1, None], box)
    grid = jax.tree.map(lambda x: x[:800].reshape(20, 40, *x.shape[1:]), ellipsoid)
    options = {"share": 0.99, "gradients": True, "dtype": "float32"}
    found = jaxbe.plan("margin", sample=(one, grid), tolerance=1e-1, **options)
    assert "gradients to" in str(found)
    assert "measured on 800" in str(found)
    flat = jax.tree.map(lambda x: x[:800], ellipsoid)
    box = jax.tree.map(lambda x: np.broadcast_to(x[0], (800, *x.shape[2:])), one)

    def gradient(steps):
        value = functools.partial(jaxbe.margin, steps=steps)
        return jax.vmap(jax.grad(value, argnums=(0, 1)))(box, flat)

    longest = np.ones(800)
    exact = plan_errors.flat_gradient(gradient(7), longest)
    errors = plan_errors.gradient_error(gradient(found.margin["steps"]), exact, longest)
    assert np.quantile(errors, 0.99) <= 0.2


def test_a_sample_may_need_float64():
    small = jax.tree.map(lambda x: x[:4000], EASY)
    assert jaxbe.plan("margin", sample=small, tolerance=1e-9).dtype == "float64"
    with pytest.raises(ValueError, match="of a sample of 4,000 pairs"):
        jaxbe.plan("margin", sample=small, tolerance=1e-30, dtype="float64")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"sample": EASY}, ValueError, "a tolerance must be given"),
        ({"sample": 7, "tolerance": 1}, TypeError, r"\(box, ellipsoid\), got int"),
        ({"sample": EASY[:1], "tolerance": 1}, TypeError, r"\(box, ellipsoid\)"),
        (
            {"sample": jax.tree.map(lambda x: x[:99], EASY), "tolerance": 1},
            ValueError,
            r"at least 4,000 pairs to tell a share of 0\.999, got 99",
        ),
        ({"sample": EASY, "tolerance": 1, "share": 1.0}, ValueError, "a share of 1"),
        (
            {"sample": EASY, "tolerance": 1, "never_miss": True},
            TypeError,
            "a sample alone does, but for never_miss",
        ),
        ({}, TypeError, "scene must be a SceneFacts, got NoneType"),
    ],
)
def test_refusals_of_samples(options, error, message):
    with pytest.raises(error, match=message):
        jaxbe.plan("margin", **options)


def test_a_traced_sample_is_refused():
    box, ellipsoid = EASY

    def planned(center):
        moved = jaxbe.Box.unchecked(center, box.axes, box.half_extents)
        jaxbe.plan("margin", sample=(moved, ellipsoid), tolerance=0.1)
        return center

    with pytest.raises(TypeError, match="sample must be known"):
        jax.jit(planned)(box.center)


def test_pairs_that_are_not_decided_count_as_wrong():
    center = EASY[0].center.at[:100].set(jnp.nan)
    box = jaxbe.Box.unchecked(center, EASY[0].axes, EASY[0].half_extents)
    with pytest.raises(ValueError, match="margin inf"):
        jaxbe.plan("margin", sample=(box, EASY[1]), tolerance=0.5, dtype="float32")
    found = Sample(box, EASY[1])
    for answer in ("distance", "depth"):
        assert found.error("signed_distance", 1, "float32", answer, 0.99) == np.inf


def test_upper_quantiles_hold_for_the_whole_of_which_a_sample_is_known():
    """Twice the standard deviation: of 400 samples nearly all say enough."""
    rng = np.random.default_rng(0)
    errors = rng.exponential(size=(400, 10_000))
    true = -np.log(1e-3)
    said = np.array([upper_quantile(e, 0.999) for e in errors])
    assert np.mean(said >= true) > 0.95
    assert np.mean(said) < 1.2 * true
    counts = rng.binomial(10_000, 1e-3, size=400)
    assert np.mean([upper_share(k, 10_000) >= 1e-3 for k in counts]) > 0.95
    assert upper_share(0, 0) == upper_share(3, 3) == 1
