"""`certify`: no certificate is false, checked in exact rational arithmetic."""

import jax
import numpy as np
import pytest
from jax.experimental import checkify

import jaxbe
from benchmarks import scenes
from benchmarks.certificates import LOWS, holds, judge, mixed
from tests import programs, truth
from tests.margin_reference import KINDS


def test_the_checker_rejects_what_is_false():
    """Or else the next tests would pass for nothing."""
    scene = scenes.random(200, seed=80)
    _, point, direction = (np.asarray(x) for x in jaxbe.certify(*scene.bodies()))
    overlaps = np.asarray(jaxbe.overlap(*scene.bodies()))
    for i in range(scene.size):
        pair = truth.exact(scene, i)
        wrong = -1 if overlaps[i] else 1
        assert not holds(pair, wrong, point[i], direction[i])


@pytest.mark.parametrize("spread", LOWS)
@pytest.mark.parametrize(
    ("pairs", "seed"),
    [(3400, 81), pytest.param(34_000, 82, marks=pytest.mark.slow)],
    ids=["some", "many"],
)
def test_no_certificate_is_false(pairs, seed, spread, dtype):
    scene = mixed(pairs, LOWS[spread], seed).astype(dtype)
    judged = judge(scene)
    print(spread, dtype, "undecided", judged.undecided)
    assert not judged.false
    assert judged.undecided <= (0.11 if dtype == np.float32 else 0.001)
    overlapping = np.asarray(jaxbe.overlap(*scene.astype(np.float64).bodies()))
    decided = judged.verdict != 0
    assert np.all((judged.verdict == 1)[decided] == overlapping[decided])


@pytest.mark.parametrize("power", [-0.5, -1, -4, -8])
def test_where_floats_end(power, dtype):
    """Lengths beside the smallest normal float, most of what is small flushed."""
    tiny = float(np.finfo(dtype).tiny)
    scene = scenes.scaled(scenes.random(400, seed=87), tiny * 10.0**-power)
    scene = type(scene)(*(x.astype(dtype) for x in scene))
    assert not judge(scene).false


def test_what_is_flushed_proves_nothing():
    """Numbers below the smallest normal float count as zero in compiled programs."""
    f, eye = np.float32, np.eye(3, dtype=np.float32)
    cases = (
        (np.zeros(3), 1e-38, [2.5e-38, 0, 0], 2e-38),
        (np.full(3, 3.9e-38), 0, np.full(3, 5e-38), 1.2e-38),
    )
    for C, e, K, a in cases:
        scene = scenes.Scene(*(
            np.asarray(x, f)[None]
            for x in (C, eye, np.full(3, e), K, eye, np.full(3, a))
        ))  # fmt: skip
        assert not judge(scene).false


@pytest.mark.bulk
@pytest.mark.parametrize("kind", KINDS)
def test_special_scenes(kind, dtype):
    scene = KINDS[kind](scenes.random(200, seed=83)).astype(dtype)
    assert not judge(scene).false


def test_axes_that_are_not_orthonormal(dtype):
    """As MJX in float32 hands them over, and worse."""
    scene = scenes.random(500, seed=84)
    rng = np.random.default_rng(85)
    U, V = (x + 1e-5 * rng.normal(size=x.shape) for x in (scene.U, scene.V))
    C, _, e, K, _, a = (x.astype(dtype) for x in scene)
    skewed = scene._replace(C=C, U=U.astype(dtype), e=e, K=K, V=V.astype(dtype), a=a)

    def bodies():
        box = jaxbe.Box.unchecked(*skewed[:3])
        return box, jaxbe.Ellipsoid.unchecked(*skewed[3:])

    verdict, point, direction = (np.asarray(x) for x in jaxbe.certify(*bodies()))
    for i in np.flatnonzero(verdict):
        pair = truth.exact(skewed, i)
        assert holds(pair, verdict[i], point[i], direction[i])
    assert np.mean(verdict == 0) <= 0.01


def test_nan_is_undecided(dtype):
    scene = scenes.random(20, seed=86).astype(dtype)
    for field, array in enumerate(scene):
        fields = [x.copy() for x in scene]
        fields[field].reshape(array.shape[0], -1)[:, 0] = np.nan
        box = jaxbe.Box.unchecked(*fields[:3])
        verdict, _, _ = jaxbe.certify(box, jaxbe.Ellipsoid.unchecked(*fields[3:]))
        assert np.all(np.asarray(verdict) == 0)


def optimised(kind, field, index, value, dtype):
    """A unit body of which an optimiser changed one number."""
    center, axes = np.zeros(3, dtype), np.eye(3, dtype=dtype)
    body = kind(center, axes, np.ones(3, dtype))
    fields = {name: np.array(x) for name, x in body.fields().items()}
    fields[field][index] = value
    return jax.tree.unflatten(jax.tree.structure(body), fields.values())


BROKEN = [
    (jaxbe.Box, "axes", (0, 1), 0.01, r"axes must be orthonormal .*\[\[1.0, 0.0"),
    (jaxbe.Ellipsoid, "axes", (0, 0), 1.01, "axes must be orthonormal"),
    (jaxbe.Box, "half_extents", 1, -0.1, r"half_extents must be non-negative.*-0\.1"),
    (jaxbe.Ellipsoid, "semi_axes", 2, -0.1, "semi_axes must be non-negative"),
]


@pytest.mark.parametrize(("kind", "field", "index", "value", "message"), BROKEN)
def test_bodies_that_an_optimiser_spoiled(kind, field, index, value, message, dtype):
    """Once a proof that they are apart."""
    other = {jaxbe.Box: jaxbe.Ellipsoid, jaxbe.Ellipsoid: jaxbe.Box}[kind]
    far = other(np.full(3, 5, dtype), np.eye(3, dtype=dtype), np.ones(3, dtype))
    body = optimised(kind, field, index, value, dtype)
    pair = (body, far) if kind is jaxbe.Box else (far, body)
    with pytest.raises(ValueError, match=f"{kind.__name__}: {message}"):
        jaxbe.certify(*pair)
    many = jax.tree.map(lambda x: np.stack([x] * 3), pair)
    with pytest.raises(ValueError, match=r"at batch index \(0,\)"):
        jaxbe.certify(*many)
    jax.jit(jaxbe.certify)(*pair)  # There values are not read.
    with pytest.raises(checkify.JaxRuntimeError):
        jaxbe.checked(jaxbe.certify)(*pair)


def test_undecided_poses_are_no_error(dtype):
    """NaN and infinity, as of a simulation that failed, and a flat ellipsoid."""
    box, ellipsoid = scenes.random(4, seed=88).astype(dtype).bodies()
    for bad in (np.nan, np.inf, -np.inf):
        for i in range(3):
            leaves = [np.array(x) for x in jax.tree.leaves(ellipsoid)]
            leaves[i][1] = abs(bad) if i == 2 else bad
            spoiled = jax.tree.unflatten(jax.tree.structure(ellipsoid), leaves)
            assert jaxbe.certify(box, spoiled).verdict[1] == 0
    flat = ellipsoid.unchecked(
        ellipsoid.center, ellipsoid.axes, ellipsoid.semi_axes.at[1, 0].set(0)
    )
    jaxbe.certify(box, flat)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="fuses in other ways")
@pytest.mark.parametrize(
    ("body", "field"),
    [(i, f) for i, kind in enumerate((jaxbe.Box, jaxbe.Ellipsoid))
     for f in kind.__dataclass_fields__],
)  # fmt: skip
@pytest.mark.parametrize("varies", [True, False], ids=["alone", "constant"])
def test_any_field_may_be_a_constant_of_the_program(body, field, varies):
    """The kernel was computed again for each term of the proof: 800 operations."""
    pair = scenes.random(1000).astype(np.float32).bodies()

    def with_field(bodies, x):
        changed = type(bodies[body]).unchecked(
            *(bodies[body].fields() | {field: x}).values()
        )
        return jaxbe.certify(*(changed if i == body else bodies[i] for i in range(2)))

    given = getattr(pair[body], field)
    if varies:
        largest = programs.largest_expression(lambda x: with_field(pair, x), given)
    else:
        largest = programs.largest_expression(lambda b: with_field(b, given), pair)
    assert largest <= 600


def test_branch_free():
    programs.check_branch_free(jax.vmap(jaxbe.certify), *scenes.random(64).bodies())
