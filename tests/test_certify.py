"""`certify`: no certificate is false, checked in exact rational arithmetic."""

from fractions import Fraction

import jax
import numpy as np
import pytest

import jaxbe
from benchmarks import scenes
from tests import oracle, programs
from tests.margin_reference import KINDS

LOWS = {"to 40": 0.05, "to 1000": 0.002, "to 1e5": 2e-5}


def check_certificate(pair, verdict, point, direction) -> bool:
    """Whether the proof holds for the very floats of the pair."""
    if verdict == 1:
        x = [Fraction(float(v)) for v in point]
        if any(abs(v) > e for v, e in zip(x, pair.e, strict=True)):
            return False
        w = [
            c + v - k
            for c, v, k in zip(pair.C, oracle.apply(pair.U, x), pair.K, strict=True)
        ]
        y = oracle.apply(oracle.inverse(pair.V), w)
        return sum((v / a) ** 2 for v, a in zip(y, pair.a, strict=True)) <= 1
    w = [Fraction(float(v)) for v in direction]
    across = [k - c for k, c in zip(pair.K, pair.C, strict=True)]
    gap = sum(p * q for p, q in zip(w, across, strict=True))
    on_box = oracle.apply(oracle.transpose(pair.U), w)
    gap -= sum(e * abs(v) for e, v in zip(pair.e, on_box, strict=True))
    on_ellipsoid = oracle.apply(oracle.transpose(pair.V), w)
    square = sum((a * v) ** 2 for a, v in zip(pair.a, on_ellipsoid, strict=True))
    return gap > 0 and gap * gap > square


def false_certificates(scene):
    """Numbers of the pairs whose proof fails, and the share that is undecided."""
    certificate = jax.jit(jaxbe.certify)(*scene.bodies())
    verdict, point, direction = (np.asarray(x) for x in certificate)
    wrong = []
    for i in np.flatnonzero(verdict):
        pair = oracle.exact(*(x[i].astype(np.float64).tolist() for x in scene))
        if not check_certificate(pair, verdict[i], point[i], direction[i]):
            wrong.append(int(i))
    return wrong, np.mean(verdict == 0), verdict


def mixed(n, low, seed):
    """Random pairs, a tenth of them within 1e-6 of touching."""
    scene = scenes.random(n, seed=seed, low=low)
    close = scenes.near_touching(scene.part(slice(n // 10)), growth=1e-6)
    return type(scene)(
        *(np.concatenate([c, x[n // 10 :]]) for c, x in zip(close, scene, strict=True))
    )


def test_the_checker_rejects_what_is_false():
    """Or else the next tests would pass for nothing."""
    scene = scenes.random(200, seed=80)
    _, point, direction = (np.asarray(x) for x in jaxbe.certify(*scene.bodies()))
    overlaps = np.asarray(jaxbe.overlap(*scene.bodies()))
    for i in range(scene.size):
        pair = oracle.exact(*(x[i].tolist() for x in scene))
        wrong = -1 if overlaps[i] else 1
        assert not check_certificate(pair, wrong, point[i], direction[i])


@pytest.mark.parametrize("aspect", LOWS)
def test_no_certificate_is_false(aspect, dtype):
    scene = mixed(3400, LOWS[aspect], seed=81).astype(dtype)
    wrong, undecided, verdict = false_certificates(scene)
    print(aspect, dtype, "undecided", undecided)
    assert not wrong
    assert undecided <= (0.11 if dtype == np.float32 else 0.001)
    truth = np.asarray(jaxbe.overlap(*scene.astype(np.float64).bodies()))
    assert np.all((verdict == 1)[verdict != 0] == truth[verdict != 0])


@pytest.mark.slow
@pytest.mark.parametrize("aspect", LOWS)
def test_no_certificate_of_many_is_false(aspect, dtype):
    wrong, undecided, _ = false_certificates(
        mixed(34_000, LOWS[aspect], seed=82).astype(dtype)
    )
    print(aspect, dtype, "undecided", undecided)
    assert not wrong
    assert undecided <= (0.11 if dtype == np.float32 else 0.001)


@pytest.mark.parametrize("power", [-0.5, -1, -4, -8])
def test_where_floats_end(power, dtype):
    """Lengths beside the smallest normal float, most of what is small flushed."""
    tiny = float(np.finfo(dtype).tiny)
    scene = scenes.scaled(scenes.random(400, seed=87), tiny * 10.0**-power)
    scene = type(scene)(*(x.astype(dtype) for x in scene))
    wrong, _, _ = false_certificates(scene)
    assert not wrong


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
        wrong, _, _ = false_certificates(scene)
        assert not wrong


@pytest.mark.bulk
@pytest.mark.parametrize("kind", KINDS)
def test_special_scenes(kind, dtype):
    scene = KINDS[kind](scenes.random(200, seed=83)).astype(dtype)
    wrong, _, _ = false_certificates(scene)
    assert not wrong


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
        pair = oracle.exact(*(x[i].astype(np.float64).tolist() for x in skewed))
        assert check_certificate(pair, verdict[i], point[i], direction[i])
    assert np.mean(verdict == 0) <= 0.01


def test_nan_is_undecided(dtype):
    scene = scenes.random(20, seed=86).astype(dtype)
    for field, array in enumerate(scene):
        fields = [x.copy() for x in scene]
        fields[field].reshape(array.shape[0], -1)[:, 0] = np.nan
        box = jaxbe.Box.unchecked(*fields[:3])
        verdict, _, _ = jaxbe.certify(box, jaxbe.Ellipsoid.unchecked(*fields[3:]))
        assert np.all(np.asarray(verdict) == 0)


def test_branch_free():
    programs.check_branch_free(jax.vmap(jaxbe.certify), *scenes.random(64).bodies())
