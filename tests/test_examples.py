"""Each numbered example, shortened: it keeps its promise, and its picture shows."""

import json
import runpy

import numpy as np
import pytest

pytest.importorskip("optax")
image = pytest.importorskip("matplotlib.image")
pytest.importorskip("PIL")

from placing import Pose, ellipsoid_at  # noqa: E402

import jaxbe  # noqa: E402

pytestmark = [pytest.mark.bulk, pytest.mark.usefixtures("jax_as_users_have_it")]


def run(name, path, *arguments):
    """What the example's `main` returns, after a look at what it drew."""
    main = runpy.run_path(f"examples/{name}.py")["main"]
    numbers = path.with_suffix(".json")
    answer = main(
        ["--quick", "--output", str(path), "--json", str(numbers), *arguments]
    )
    assert {"command", "machine", "seconds"} < set(json.loads(numbers.read_text()))
    if not arguments:
        assert image.imread(path)[..., :3].std() > 0.05 * image.imread(path).max()
    return answer


def test_push_out(tmp_path):
    assert run("1_push_out", tmp_path / "a.gif")


def test_packing(tmp_path):
    assert run("2_packing", tmp_path / "a.png") > 0.1


@pytest.mark.slow
def test_second_order(tmp_path):
    steps = run("3_second_order", tmp_path / "a.png")
    assert steps["Newton"] < 25
    assert 2 * steps["Newton"] < steps["L-BFGS"]


@pytest.mark.slow
def test_trajectory(tmp_path):
    assert run("4_trajectory", tmp_path / "a.gif")


def test_largest_ellipsoid(tmp_path):
    """By as much as rounding may be, it is larger than what is proved to be largest."""
    assert 0.97 < run("5_largest_ellipsoid", tmp_path / "a.png") < 1 + 1e-5


@pytest.mark.slow
def test_packing_succeeds_below_the_density_where_it_fails(tmp_path):
    assert run("2_packing", tmp_path / "a.png", "--measure") == 1


# The proofs that are not jaxbe's own.


def balls(*rows):
    """Balls of rows (x, y, z, radius), in any axes."""
    table = np.array(rows, np.float32)
    wxyz = np.random.default_rng(0).normal(size=(len(rows), 4)).astype(np.float32)
    return ellipsoid_at(Pose(table[:, :3], wxyz), table[:, 3:])


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (((-0.2, 0, 0, 0.1), (0.01, 0, 0, 0.1)), True),
        (((-0.2, 0, 0, 0.1), (-0.01, 0, 0, 0.1)), False),
        (((0.39, 0, 0, 0.1), (0, 0, 0, 0.1)), True),
        (((0.41, 0, 0, 0.1), (0, 0, 0, 0.1)), False),
        (((-0.3, 0, 0, 0.1), (0.2, 0.2, 0.1, 0.1)), False),
    ],
    ids=["apart", "overlapping", "inside", "through the wall", "in a parcel"],
)
def test_only_what_is_true_is_proved(rows, expected):
    from crate import Instance
    from fruit import proved

    parcel = np.float32([[0.2, 0.3, 0.1]])
    box = jaxbe.Box(parcel, np.eye(3, dtype=np.float32)[None], np.float32([[0.05] * 3]))
    assert proved(balls(*rows), Instance(box, np.zeros((2, 3)))) == expected


def test_the_growth_distance_of_ellipsoids_is_that_of_the_best_direction():
    from fruit import growth, shape

    rng = np.random.default_rng(1)
    pose = Pose(*(rng.normal(size=(30, n)).astype(np.float32) for n in (3, 4)))
    fruit = ellipsoid_at(pose, rng.uniform(0.2, 0.6, (30, 3)).astype(np.float32))
    found, _ = growth(fruit.center, shape(fruit))
    n = rng.normal(size=(20_000, 3))
    K, V, a = (np.asarray(x, float) for x in fruit.fields().values())
    s = np.linalg.norm(np.einsum("kr,irp->kip", n, V) * a, axis=-1)
    for i, j in [(0, 1), (2, 3), (4, 5), (6, 7)]:
        quotients = n @ (K[i] - K[j]) / (s[:, i] + s[:, j])
        np.testing.assert_allclose(found[i, j], quotients.max(), rtol=5e-3)
        assert found[i, j] > quotients.max() * (1 - 1e-3)
