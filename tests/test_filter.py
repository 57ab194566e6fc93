"""`filter_contacts`: nothing near is lost, on MuJoCo, MJX and Brax."""

import functools
import types

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

import jaxbe
from benchmarks import scenes
from benchmarks.reference import value_along
from jaxbe import _xla
from jaxbe.lower_bound import MAX_STEPS
from jaxbe.mjx import Candidates, Pairs, bounds, filter_contacts, find_pairs, gather
from jaxbe.mjx.margins import contact_distance
from tests import programs
from tests.distance_reference import found
from tests.test_gather import SCENE, mjx_state, poses_of, random_data
from tests.test_gather import allow_pairs as allow_pairs

pytestmark = pytest.mark.bulk


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def pairs(model):
    return find_pairs(model)


def stacked(model, seeds, dtype=np.float64):
    """Poses of random states, with one batch axis."""
    data = [poses_of(random_data(model, seed), dtype) for seed in seeds]
    return types.SimpleNamespace(
        geom_xpos=np.stack([d.geom_xpos for d in data]),
        geom_xmat=np.stack([d.geom_xmat for d in data]),
    )


def as_pairs(scene):
    """A scene as model, data and pairs: geom i is ellipsoid i, geom n + i box i."""
    n = scene.size
    model = types.SimpleNamespace(geom_size=jnp.concatenate([scene.a, scene.e]))
    data = types.SimpleNamespace(
        geom_xpos=jnp.concatenate([scene.K, scene.C]),
        geom_xmat=jnp.concatenate([scene.V, scene.U]),
    )
    ids = np.arange(n)
    return Pairs(np.stack([ids, n + ids], axis=1)), model, data


def kept_pairs(candidates):
    """The set of pairs kept in one state."""
    return {tuple(p) for p in np.asarray(candidates.geom)[candidates.valid].tolist()}


@functools.cache
def compiled(steps):
    """On arrays (P, ...) of a scene: the candidates of `as_pairs`."""

    def run(scene, distance):
        pairs, model, data = as_pairs(scene)
        return filter_contacts(pairs, model, data, distance=distance, steps=steps)

    return jax.jit(run)


# The bound.


def test_what_mujoco_finds_near_is_kept_nearest_first(model, pairs):
    distances, lower = [], []
    for seed in range(50):
        data = random_data(model, seed)
        candidates = filter_contacts(pairs, model, data, distance=0.2)
        distance = {
            (e, b): mujoco.mj_geomDistance(model, data, e, b, 9, None)
            for e, b in pairs.geom.tolist()
        }
        near = {pair for pair, d in distance.items() if d < 0.2}
        assert near <= kept_pairs(candidates)
        assert int(candidates.overflow) == 0
        valid = np.asarray(candidates.valid)
        bounds = np.asarray(candidates.distance)
        assert np.all(np.diff(bounds[valid]) >= 0)
        assert np.all(valid[:-1] >= valid[1:])
        assert np.all(bounds[~valid] == np.inf)
        of_pair = [distance[tuple(p)] for p in np.asarray(candidates.geom).tolist()]
        distances += np.array(of_pair)[valid].tolist()
        lower += bounds[valid].tolist()
    distances, lower = np.array(distances), np.array(lower)
    apart = distances > 0
    assert 20 < np.sum(apart) < 180
    assert np.all(lower[apart] <= distances[apart] + 1e-6)  # MuJoCo's own tolerance
    assert np.mean(distances[apart] - lower[apart] < 0.01) > 0.9


@pytest.mark.parametrize("steps", [0, 1, 2])
@pytest.mark.parametrize("low", [0.05, 0.002])
def test_no_near_contact_is_missed(steps, low):
    """100,000 float32 pairs, each with a bound from 1e-9 to 1e-2 above its distance.

    The distance of the very floats, from below: along a direction found in float64, in
    extended precision. Zero where they overlap, as the depth found is not always the
    least.
    """
    for seed in range(2):
        scene = scenes.random(10_000, seed=70 + seed, low=low)
        scene = scenes.near_touching(scene, growth=10.0 ** (-4 * seed - 1))
        scene = scene.astype(np.float32)
        distance = value_along(scene, found(scene.astype(np.float64)).normal)
        distance = np.maximum(distance, 0)
        rng = np.random.default_rng(seed)
        for _ in range(5):
            above = 10 ** rng.uniform(-9, -2, scene.size)
            candidates = compiled(steps)(scene, distance + above)
            assert np.all(candidates.valid)


def test_few_others_are_kept():
    scene = scenes.random(10_000, seed=73).astype(np.float32)
    overlapping = np.asarray(jaxbe.overlap(*scene.bodies()))
    kept = [np.sum(compiled(steps)(scene, 0.0).valid) for steps in (0, 1)]
    assert 1.2 < kept[0] / overlapping.sum() < 1.6
    assert 0 <= kept[1] - overlapping.sum() < 5


# What is asked for.


def test_default_distance_keeps_every_contact_of_mujoco():
    """Random margins and gaps of geoms and of <pair> elements, some of them twice."""
    rng = np.random.default_rng(74)
    n_contacts = 0
    for _ in range(40):
        sizes = rng.uniform(0.1, 0.4, (8, 3))
        margins, gaps = rng.choice([0, 0, 0.1, 0.5], (2, 14))
        geoms = [
            f'<body pos="{" ".join(map(str, rng.uniform(-1, 1, 3)))}"><freejoint/>'
            f'<geom name="g{i}" type="{kind}" margin="{margins[i]}" gap="{gaps[i]}" '
            f'size="{" ".join(map(str, sizes[i]))}"/></body>'
            for i, kind in enumerate(["ellipsoid", "box"] * 4)
        ]
        elements = [
            f'<pair geom1="g{i}" geom2="g{j}" margin="{margins[m]}" gap="{gaps[m]}"/>'
            for m, i, j in ((8, 0, 1), (9, 3, 2), (10, 0, 1), (11, 4, 6))
        ]
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody>{''.join(geoms)}</worldbody>"
            f"<contact>{''.join(elements)}</contact></mujoco>"
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        contacts = {
            tuple(sorted(c.geom, key=lambda g: model.geom_type[g]))
            for c in data.contact
            if sorted(model.geom_type[c.geom]) == [4, 6]
        }
        n_contacts += len(contacts)
        candidates = filter_contacts(find_pairs(model), model, data)
        assert contacts <= kept_pairs(candidates)
    assert n_contacts > 100


def test_default_distance_is_the_margin_and_the_gap(model, pairs):
    """Of the <pair>, the larger one of two, else of both geoms."""
    other = SCENE.replace(
        "</worldbody>",
        """</worldbody><contact>
        <pair geom1="hand" geom2="shelf" margin=".3" gap=".1"/>
        <pair geom1="shelf" geom2="hand" margin=".2" gap=".1"/></contact>""",
    ).replace('size=".1 .2 .3"', 'size=".1 .2 .3" margin=".05" gap=".01"')
    model = mujoco.MjModel.from_xml_string(
        other.replace('size=".1 .2 .15"', 'size=".1 .2 .15" margin=".5"')
    )
    names = [
        tuple(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, i) for i in p)
        for p in pairs.geom
    ]
    expected = {
        ("hand", "shelf"): 0.4,
        ("hand", "parcel"): 0.56,
        ("finger", "shelf"): 0.0,
        ("finger", "parcel"): 0.5,
    }
    found = find_pairs(model)
    np.testing.assert_array_equal(found.geom, pairs.geom)
    for given in (model, one_environment(model)):
        distance = contact_distance(found, given)
        np.testing.assert_allclose(distance, [expected[x] for x in names], rtol=1e-6)
    batch = types.SimpleNamespace(
        **{
            name: np.stack([getattr(model, name), 2 * getattr(model, name)])
            for name in ("geom_margin", "geom_gap", "pair_margin", "pair_gap")
        }
    )
    doubled = contact_distance(found, batch)[1]
    np.testing.assert_allclose(doubled, [2 * expected[x] for x in names], rtol=1e-6)


def one_environment(model):
    """The fields that are arrays of JAX in an mjx.Model."""
    names = ("geom_margin", "geom_gap", "pair_margin", "pair_gap", "geom_size")
    return types.SimpleNamespace(
        **{name: jnp.asarray(getattr(model, name), jnp.float32) for name in names}
    )


def test_distances_of_each_pair_and_state(model, pairs):
    data = stacked(model, range(6))
    everything = filter_contacts(pairs, model, data, distance=np.inf)
    assert np.all(everything.valid)
    none = filter_contacts(pairs, model, data, distance=-np.inf)
    assert not np.any(none.valid)
    each = np.full((6, 4), -np.inf)
    each[2, 1] = np.inf
    one = filter_contacts(pairs, model, data, distance=each)
    assert np.sum(one.valid) == 1
    assert one.valid[2, 0]
    np.testing.assert_array_equal(one.geom[2, 0], pairs.geom[1])
    row = filter_contacts(pairs, model, data, distance=each[2])
    np.testing.assert_array_equal(np.sum(row.valid, axis=1), 1)


def test_a_mask_takes_pairs_away_without_a_new_compilation(model, pairs):
    @jax.jit
    def run(position, axes, mask):
        data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        return filter_contacts(pairs, model, data, distance=np.inf, mask=mask)

    poses = poses_of(random_data(model, 0))
    for mask in (np.ones(4, bool), np.array([True, False, False, True])):
        candidates = run(poses.geom_xpos, poses.geom_xmat, mask)
        expected = {tuple(p) for p in pairs.geom[mask].tolist()}
        assert kept_pairs(candidates) == expected
    assert run._cache_size() == 1


@pytest.mark.parametrize("max_pairs", [1, 2, 4, 7])
def test_what_does_not_fit_is_counted(model, pairs, max_pairs):
    data = stacked(model, range(20))
    options = {"distance": 0.3}
    everything = filter_contacts(pairs, model, data, **options)
    some = filter_contacts(pairs, model, data, max_pairs=max_pairs, **options)
    count = np.sum(everything.valid, axis=1)
    assert set(np.asarray(count).tolist()) == {0, 1, 2, 3, 4}
    assert some.geom.shape == (20, max_pairs, 2)
    np.testing.assert_array_equal(some.overflow, np.maximum(count - max_pairs, 0))
    np.testing.assert_array_equal(
        np.sum(some.valid, axis=1), np.minimum(count, max_pairs)
    )
    n = min(max_pairs, 4)
    np.testing.assert_array_equal(some.distance[:, :n], everything.distance[:, :n])
    np.testing.assert_array_equal(some.geom[:, :n], everything.geom[:, :n])
    # Empty places hold legal pairs.
    known = {tuple(p) for p in pairs.geom.tolist()}
    assert {tuple(p) for p in np.asarray(some.geom).reshape(-1, 2).tolist()} <= known


@pytest.mark.parametrize("max_pairs", [None, 2])
def test_a_model_without_pairs(model, max_pairs):
    none = Pairs(np.zeros((0, 2), int))
    for options in ({}, {"distance": 1.0}):
        candidates = filter_contacts(
            none, model, stacked(model, range(3)), max_pairs=max_pairs, **options
        )
        assert candidates.valid.shape == (3, max_pairs or 0)
        assert not np.any(candidates.valid)
        assert np.all(np.asarray(candidates.geom) == -1)
        assert np.all(np.asarray(candidates.overflow) == 0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_poses_that_are_not_finite_are_kept_first(model, pairs, bad):
    data = stacked(model, range(3))
    hand = int(pairs.geom[0, 0])
    data.geom_xpos[1, hand, 2] = bad
    good = filter_contacts(pairs, model, stacked(model, range(3)), distance=0.0)
    candidates = filter_contacts(pairs, model, data, distance=0.0)
    np.testing.assert_array_equal(candidates.valid[1, :2], True)
    assert set(np.asarray(candidates.geom[1, :2, 0]).tolist()) == {hand}
    assert np.all(np.isnan(candidates.distance[1, :2]))
    for x, y in zip(candidates, good, strict=True):
        np.testing.assert_array_equal(x[::2], y[::2])
    masked = filter_contacts(pairs, model, data, mask=np.zeros(4, bool))
    assert not np.any(masked.valid)


# Where the poses and sizes come from.


def test_batch_vmap_and_loop_agree(model, pairs):
    data = stacked(model, range(12))

    def run(position, axes):
        poses = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        return filter_contacts(pairs, model, poses, distance=0.3, max_pairs=3)

    together = filter_contacts(pairs, model, data, distance=0.3, max_pairs=3)
    each = jax.jit(jax.vmap(run))(data.geom_xpos, data.geom_xmat)
    one = jax.jit(run)
    loop = [one(*poses) for poses in zip(data.geom_xpos, data.geom_xmat, strict=True)]
    loop = jax.tree.map(lambda *x: np.stack(x), *loop)
    for x, y, z in zip(together, each, loop, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(x, z, rtol=1e-12, atol=1e-12)


def test_batches_of_sizes_as_in_domain_randomisation(model, pairs):
    data = stacked(model, range(3))
    scales = np.array([0.5, 1.0, 3.0])
    sizes = scales[:, None, None] * model.geom_size
    together = filter_contacts(
        pairs, types.SimpleNamespace(geom_size=sizes), data, distance=0.0
    )

    def run(size, position, axes):
        poses = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        given = types.SimpleNamespace(geom_size=size)
        return filter_contacts(pairs, given, poses, distance=0.0)

    each = jax.vmap(run)(sizes, data.geom_xpos, data.geom_xmat)
    for i in range(3):
        expected = run(sizes[i], data.geom_xpos[i], data.geom_xmat[i])
        for x, y, z in zip(together, each, expected, strict=True):
            np.testing.assert_allclose(x[i], z, rtol=1e-12)
            np.testing.assert_allclose(y[i], z, rtol=1e-12)
    assert np.sum(together.valid[2]) > np.sum(together.valid[0])


@pytest.fixture
def half_spheres(model):
    """The hand's semi-axes made equal."""
    model.geom_size[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "hand")] = 0.2
    return model


@pytest.mark.parametrize("steps", [0, 1, MAX_STEPS])
def test_spheres_are_recognised_where_sizes_are_known(half_spheres, pairs, steps):
    model, data = half_spheres, stacked(half_spheres, range(10))

    def run(size):
        given = types.SimpleNamespace(geom_size=size)
        return filter_contacts(pairs, given, data, distance=np.inf, steps=steps)

    known, unknown = run(model.geom_size), jax.jit(run)(model.geom_size)
    box, ellipsoid = gather(pairs, model, data)
    exact = np.sort(jaxbe.signed_distance(box, ellipsoid, steps=12), axis=1)
    for candidates in (known, unknown):
        assert np.all(np.asarray(candidates.distance) <= exact + 1e-12)
    if steps == MAX_STEPS:
        apart = exact > 0
        error = abs(np.asarray(known.distance) - np.asarray(unknown.distance))
        assert np.max(error[apart]) < 1e-3


def test_spheres_take_no_step(half_spheres, pairs):
    """The program is shorter if sizes are known, and shortest for spheres alone."""
    data = poses_of(random_data(half_spheres, 0))
    hand = Pairs(pairs.geom[pairs.geom[:, 0] == pairs.geom[0, 0]])

    def length(pairs, size):
        given = types.SimpleNamespace(geom_size=size)
        run = lambda: filter_contacts(pairs, given, data, distance=0.0)  # noqa: E731
        return len(str(jax.make_jaxpr(run)()).splitlines())

    size = half_spheres.geom_size
    of_spheres = length(hand, size)
    assert of_spheres < 0.6 * length(hand, size[None])
    assert of_spheres < length(pairs, size)


def test_few_pairs_of_many_bodies(dtype):
    """Gathered one by one, and as a choice from all against all: the same."""
    scene = scenes.random(30, seed=75).astype(dtype)
    few, model, data = as_pairs(scene)
    every = Pairs(np.stack(np.meshgrid(*few.geom.T), axis=-1).reshape(-1, 2))
    assert _xla.MAX_TABLE_RATIO * len(few) < 30 * 30
    one_by_one = bounds.pair_distances(few, model, data, 1)
    chosen = np.asarray(bounds.pair_distances(every, model, data, 1))
    chosen = chosen[every.geom[:, 1] == every.geom[:, 0] + 30]
    np.testing.assert_allclose(one_by_one, chosen, rtol=1e-5, atol=1e-5)
    assert one_by_one.dtype == dtype


@pytest.mark.usefixtures("allow_pairs")
def test_states_of_mjx(model, pairs):
    on_device = mjx.put_model(model)
    data = [random_data(model, seed) for seed in range(4)]
    qpos = jnp.stack([jnp.asarray(d.qpos) for d in data])
    states = jax.vmap(lambda q: mjx_state(on_device, q))(qpos)

    def run(state):
        return filter_contacts(pairs, on_device, state, distance=0.1)

    for candidates in (run(states), jax.jit(jax.vmap(run))(states)):
        for i, d in enumerate(data):
            expected = filter_contacts(pairs, model, d, distance=0.1)
            one = jax.tree.map(lambda x, i=i: x[i], candidates)
            assert kept_pairs(one) == kept_pairs(expected)
            np.testing.assert_allclose(one.distance, expected.distance, atol=1e-5)


NO_CONTACTS = '<option><flag contact="disable"/></option><worldbody>'


@pytest.mark.slow
@pytest.mark.usefixtures("allow_pairs")
@pytest.mark.parametrize("backend", ["mjx", "generalized", "positional", "spring"])
def test_states_of_brax(model, pairs, backend):
    pytest.importorskip("brax")
    import importlib

    from brax.io import mjcf

    pipeline = importlib.import_module(f"brax.{backend}.pipeline")
    system = mjcf.loads(SCENE.replace("<worldbody>", NO_CONTACTS, 1))
    data = random_data(model, 0)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        state = pipeline.init(system, jnp.asarray(data.qpos), jnp.zeros(system.nv))
    candidates = filter_contacts(find_pairs(system), system, state, distance=0.1)
    expected = filter_contacts(pairs, model, data, distance=0.1)
    assert 0 < np.sum(expected.valid) < 4
    assert kept_pairs(candidates) == kept_pairs(expected)
    np.testing.assert_allclose(candidates.distance, expected.distance, atol=1e-5)


def test_candidates_can_be_gathered(model, pairs):
    """The use of a filter: what is dearer, on fewer pairs."""
    data = stacked(model, range(10))
    candidates = filter_contacts(pairs, model, data, distance=0.2, max_pairs=2)
    margins = jaxbe.margin(*gather(candidates, model, data))
    assert margins.shape == (10, 2)

    def one(position, axes):
        poses = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        found = filter_contacts(pairs, model, poses, distance=0.2, max_pairs=2)
        return jaxbe.margin(*gather(found, model, poses))

    each = jax.vmap(one)(data.geom_xpos, data.geom_xmat)
    all_pairs = np.asarray(jaxbe.margin(*gather(pairs, model, data)))
    geom = np.asarray(candidates.geom)
    for i in range(10):
        for k in range(2):
            row = int(np.flatnonzero((pairs.geom == geom[i, k]).all(axis=1))[0])
            expected = all_pairs[i, row]
            np.testing.assert_allclose(margins[i, k], expected, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(each[i, k], expected, rtol=1e-9, atol=1e-9)


# Mistakes, programs, derivatives.


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"steps": 25}, ValueError, "steps must be from 0 to 24, got 25"),
        ({"steps": 1.0}, TypeError, "steps must be a Python integer"),
        ({"max_pairs": 0}, ValueError, "max_pairs must be from 1"),
        ({"distance": np.zeros(3)}, ValueError, r"distance must broadcast to \(4,\)"),
        ({"distance": np.zeros((2, 4))}, ValueError, "distance must broadcast"),
        ({"mask": np.ones(5, bool)}, ValueError, r"mask must .* got \(5,\)"),
        ({"distance": 1j}, TypeError, "distance must be of real numbers, got complex"),
        ({"mask": np.ones(4)}, TypeError, "mask must be of bools, got float64"),
    ],
)
def test_mistakes_are_named(model, pairs, options, error, message):
    with pytest.raises(error, match=message):
        filter_contacts(pairs, model, random_data(model, 0), **options)


def test_pairs_of_another_model_are_refused(model):
    pairs = Pairs(np.array([[3, 9]]))
    with pytest.raises(ValueError, match="pairs name geom 9, the model has 5"):
        filter_contacts(pairs, model, random_data(model, 0), distance=0.0)


def test_candidates_are_no_pairs_to_be_filtered(model, pairs):
    candidates = Candidates(pairs.geom, np.zeros(4), np.ones(4, bool), np.zeros(()))
    with pytest.raises(TypeError, match="must be from find_pairs, got Candidates"):
        filter_contacts(candidates, model, random_data(model, 0), distance=0.0)


def batched(model, pairs, max_pairs):
    def run(position, axes):
        poses = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        return filter_contacts(pairs, model, poses, max_pairs=max_pairs)

    return jax.vmap(run)


@pytest.mark.parametrize("max_pairs", [None, 2])
def test_branch_free(model, pairs, max_pairs):
    """No branch, loop, host call or matrix product; the choice sorts."""
    data = stacked(model, range(8), np.float32)
    arguments = data.geom_xpos, data.geom_xmat
    function = batched(model, pairs, max_pairs)
    assert not programs.primitives(function, *arguments) & programs.FORBIDDEN
    text = jax.jit(function).lower(*arguments).compile().as_text()
    assert not [x for x in (" while(", " conditional(", " dot(") if x in text]
    assert text.count("custom-call(") == text.count('custom_call_target="TopK"') == 1


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="fuses in other ways")
def test_the_kernel_is_computed_once(model, pairs):
    """Though four results need it: one loop has its operations."""
    data = stacked(model, range(512), np.float32)
    scene = as_pairs(scenes.random(100).astype(np.float32))
    for function, arguments in (
        (batched(model, pairs, 2), (data.geom_xpos, data.geom_xmat)),
        (lambda *x: filter_contacts(*scene[:2], as_data(*x), distance=0.0),
         (scene[2].geom_xpos, scene[2].geom_xmat)),
    ):  # fmt: skip
        text = jax.jit(function).lower(*arguments).compile().as_text()
        bodies = [x for x in text.split("\n}") if "fused_computation" in x]
        assert sum(body.count("\n") > 400 for body in bodies) == 1


def as_data(position, axes):
    return types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)


def test_gradients_are_finite(model, pairs, dtype):
    """Of kept distances, empty places and coincident centres included."""
    data = stacked(model, range(10), dtype)
    data.geom_xpos[0] = 0

    @jax.jit
    @jax.grad
    def total(position, axes):
        found = filter_contacts(pairs, model, as_data(position, axes), distance=0.3)
        return jnp.sum(jnp.where(found.valid, found.distance, 0))

    gradient = np.asarray(total(data.geom_xpos, data.geom_xmat))
    assert np.all(np.isfinite(gradient))
    assert np.any(gradient)


OVERRIDE = 'o_margin="{margin}"><flag override="enable"/>'


def above_a_box(override="", ellipsoid="", box="", contact=""):
    """An ellipsoid that slides up from a box; it touches it at 0.25 m."""
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><option {override or ">"}</option>
      <worldbody>
        <geom name="b" type="box" size=".3 .2 .1" {box}/>
        <body><joint type="slide" axis="0 0 1"/>
          <geom name="e" type="ellipsoid" size=".1 .2 .15" {ellipsoid}/>
        </body>
      </worldbody><contact>{contact}</contact></mujoco>""")


def at_height(model, gap):
    data = mujoco.MjData(model)
    data.qpos[0] = 0.25 + gap
    mujoco.mj_forward(model, data)
    return data


PAIR = '<pair geom1="e" geom2="b" {}/>'

MARGINS = {
    "gap, overridden": {"override": 0.2, "box": 'gap=".06"'},
    "both gaps, overridden": {
        "override": 0.2, "box": 'margin=".5" gap=".06"', "ellipsoid": 'gap=".01"',
    },
    "none, overridden": {"override": 0.2},
    "large margins, overridden by none": {
        "override": 0.0, "box": 'margin=".5"', "ellipsoid": 'margin=".3" gap=".01"',
    },
    "overridden by less than none": {"override": -0.1, "box": 'margin=".5" gap=".2"'},
    "pair's gap, overridden": {
        "override": 0.2, "box": 'gap=".06"', "contact": PAIR.format('gap=".03"'),
    },
    "pair's margin, overridden": {
        "override": 0.2, "box": 'gap=".06"', "contact": PAIR.format('margin=".4"'),
    },
    "pair": {"contact": PAIR.format('margin=".3" gap=".03"')},
    "pair, and geoms": {"contact": PAIR.format(""), "box": 'margin=".3" gap=".03"'},
    "geoms": {"box": 'margin=".3" gap=".03"', "ellipsoid": 'margin=".1" gap=".2"'},
    "below zero": {"box": 'margin=".3" gap="-.03"', "ellipsoid": 'margin="-.1"'},
}  # fmt: skip


@pytest.mark.parametrize("case", MARGINS)
def test_the_default_distance_is_that_of_mujoco_c(case):
    """What C makes a contact of is kept, and little that is further away."""
    given = dict(MARGINS[case])
    if "override" in given:
        given["override"] = OVERRIDE.format(margin=given["override"])
    model = above_a_box(**given)
    pairs, data, touching = find_pairs(model), [], []
    for gap in np.arange(-0.05, 0.75, 0.01) + 0.005:
        data.append(poses_of(at_height(model, gap)))
        touching.append(at_height(model, gap).ncon > 0)
    data = types.SimpleNamespace(
        geom_xpos=np.stack([d.geom_xpos for d in data]),
        geom_xmat=np.stack([d.geom_xmat for d in data]),
    )
    kept = np.asarray(filter_contacts(pairs, model, data).valid[:, 0])
    assert not np.any(touching & ~kept)
    assert 5 <= np.sum(touching) < 70
    # Of versions before 3.9.0 more is kept, and where margins or gaps are negative.
    version = tuple(int(x) for x in mujoco.__version__.split(".")[:2])
    if version >= (3, 9) and "below" not in case and "less" not in case:
        assert np.sum(kept) == np.sum(touching)


def test_the_margin_that_overrides_contacts():
    """As MuJoCo C has it: what it makes a contact of is kept."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco>
      <option o_margin="0.5"><flag override="enable"/></option>
      <worldbody>
        <geom type="box" size="1 1 1"/>
        <body pos="0 0 1.4"><freejoint/><geom type="ellipsoid" size=".3 .2 .2"/></body>
      </worldbody>
    </mujoco>
    """)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    kept = filter_contacts(find_pairs(model), model, data, max_pairs=3)
    np.testing.assert_array_equal(kept.valid, [True, False, False])


def test_what_overflows_is_no_nearer_than_the_last_bound(model, pairs):
    """So the nearest distance has a lower bound, whatever had no place."""
    data = [random_data(model, seed) for seed in range(100)]
    exact = np.array(
        [
            [mujoco.mj_geomDistance(model, d, e, b, 9, None) for e, b in pairs.geom]
            for d in data
        ]
    )
    some = filter_contacts(
        pairs, model, stacked(model, range(100)), distance=np.inf, max_pairs=1
    )
    assert np.all(some.overflow == 3)
    kept = (np.asarray(some.geom) == pairs.geom).all(axis=-1)
    left_out = np.where(kept, np.inf, exact).min(axis=1)
    # To the tolerance of MuJoCo, whose depths may be longer than the least.
    apart = left_out > 0
    assert np.sum(apart) > 80
    last = np.asarray(some.distance)[:, -1]
    assert np.all(left_out[apart] >= last[apart] - 1e-6)
