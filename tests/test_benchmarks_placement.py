"""The placement benchmark in tiny form: losses, methods, the test of success."""

import functools
import json

import jax
import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("optax")
pytest.importorskip("scipy")

import jaxbe  # noqa: E402
from benchmarks import (  # noqa: E402
    placement,
    placement_methods,
    placement_mujoco,
    placement_report,
    placement_tasks,
)
from benchmarks.placement_methods import METHODS, OURS  # noqa: E402
from benchmarks.placement_tasks import Finished, Pose, Watch  # noqa: E402
from tests.test_benchmarks_margin import check_picture  # noqa: E402

pytestmark = pytest.mark.usefixtures("jax_as_users_have_it")


def crate(seed=0, fruit=2, starts=8):
    rng = np.random.default_rng(seed)
    return placement_tasks.crate(rng, starts, fruit, density=0.1)


def at(problem, x):
    return placement_mujoco.Moves(problem, 0).pose(x)


def moves_of(problem, seed=1):
    shape = len(problem.task.semi_axes), placement_mujoco.VARIABLES
    return 0.02 * np.random.default_rng(seed).normal(size=shape)


def test_distances_to_boxes_are_those_of_jaxbe():
    problem = crate(fruit=12)
    position, quaternion = (x[0] for x in problem.starts)
    scene = placement_mujoco.Scene(problem.task, [(i, ()) for i in range(12)], 10.0)
    first, last, distance = scene.measure(position, quaternion)
    boxes = len(problem.task.box.center)
    statics = boxes + 6
    assert len(distance) == 12 * statics
    found = np.full((12, boxes), np.nan)
    to_boxes = first + statics < boxes
    found[last[to_boxes], first[to_boxes] + statics] = distance[to_boxes]
    fruit = jaxbe.Ellipsoid.from_quaternion(
        position[:, None], quaternion[:, None], problem.task.semi_axes[:, None]
    )
    with jax.disable_jit():  # Compiling takes longer.
        expected = np.asarray(jaxbe.signed_distance(problem.task.box, fruit))
    apart = expected > 0
    assert apart.sum() > 20
    np.testing.assert_allclose(found[apart], expected[apart], atol=2e-6)


def test_distances_to_walls_and_between_spheres():
    """Which have formulas."""
    problem = crate(fruit=2)
    problem.task.semi_axes[:] = np.float32([[0.03], [0.05]])
    position, quaternion = (np.float64(x[0]) for x in problem.starts)
    scene = placement_mujoco.Scene(problem.task, [(0, ()), (1, (0,))], 10.0)
    first, last, distance = scene.measure(position, quaternion)
    radii = np.float64(problem.task.semi_axes[:, 0])
    between = np.linalg.norm(position[0] - position[1]) - radii.sum()
    np.testing.assert_allclose(distance[first >= 0], between, atol=1e-9)
    for i in range(2):
        walls = np.concatenate(
            [problem.task.crate - side * position[i] for side in (-1, 1)]
        )
        found = np.sort(distance[(last == i) & (first < 0) & (first >= -6)])
        np.testing.assert_allclose(found, np.sort(walls) - radii[i], atol=1e-6)


@pytest.mark.parametrize("make", [crate, functools.partial(crate, fruit=5)])
def test_differences_are_the_gradient_of_the_loss(make):
    problem = make()
    x, way = moves_of(problem), moves_of(problem, seed=2)
    value, slope = placement_mujoco.Differences(problem)(
        placement_mujoco.Moves(problem, 0), x
    )
    loss = placement_mujoco.Loss(problem)
    h = 1e-4
    high, low = (loss(at(problem, x + s * h * way))[0] for s in (1, -1))
    assert value > 0
    np.testing.assert_allclose(value, loss(at(problem, x))[0], rtol=1e-9)
    np.testing.assert_allclose(np.sum(slope * way), (high - low) / (2 * h), rtol=1e-2)


def test_a_population_has_the_losses_of_its_members():
    problem = crate(fruit=4)
    x = np.stack([moves_of(problem, seed) for seed in range(3)])
    together = placement_mujoco.Loss(problem, 3)(at(problem, x))
    alone = placement_mujoco.Loss(problem)
    np.testing.assert_allclose(together, [alone(at(problem, y))[0] for y in x])
    assert len(set(together)) == 3


def test_moves_turn_about_the_centre_by_the_angle_given():
    problem = crate(fruit=1)
    x = np.zeros((1, 6))
    x[0, 3] = placement_mujoco.radius(problem.task) * np.pi / 2
    before, after = (
        jaxbe.Ellipsoid.from_quaternion(*at(problem, y), problem.task.semi_axes)
        for y in (0 * x, x)
    )
    quarter = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(after.axes[0], quarter @ before.axes[0], atol=1e-6)
    np.testing.assert_array_equal(after.center, before.center)


def test_the_watch_takes_proofs_alone_for_success():
    """Whatever a method says its loss is."""
    problem = crate(fruit=2)
    together = jax.tree.map(lambda x: x[0][[0, 0]], problem.starts)
    watch = Watch(problem, budget=1000)
    watch.show(0.0, lambda: together)
    assert watch.solved_after is None
    assert placement_mujoco.least_distance(problem, together) < 0
    late = Watch(problem, budget=0)
    with pytest.raises(Finished):
        late.show(9.0, lambda: together)
    assert late.solved_after is None
    assert late.best is together


QUICK = [OURS, *(name for name in METHODS if name.startswith("MuJoCo"))]
"""The others take as long to compile as the first."""


@pytest.mark.parametrize(
    "name",
    [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in METHODS],
)
def test_a_method_ends_in_a_proof(name):
    pytest.importorskip(METHODS[name].package)
    problem = crate(seed=3, fruit=2, starts=4)
    run = placement.solved(METHODS[name], problem, budget=60)
    assert 0 < run["solved_after"] <= run["tried_for"]
    assert run["clearance"] > 0


def test_the_gradient_of_sqrt_q_less_one_vanishes_within():
    """And the margin's does not: the melon's centre is in a parcel."""
    rng = np.random.default_rng(0)
    problem = next(
        p for p in iter(lambda: placement_tasks.shelf(rng, 1), None) if p.deep
    )
    pose = jax.tree.map(lambda x: x[0, 0], problem.starts)
    C, U, e = (np.asarray(x) for x in problem.task.box.fields().values())
    local = np.einsum("mri,mr->mi", U, pose.position - C)
    within = int(np.argmax(np.all(abs(local) < e, axis=-1)))
    box = jaxbe.Box.unchecked(C[within], U[within], e[within])

    def slope(room):
        def value(position):
            place = placement_tasks.ellipsoid_at
            return room(
                box, place(Pose(position, pose.quaternion), problem.task.semi_axes[0])
            )

        return np.asarray(jax.jit(jax.grad(value))(pose.position))

    assert not slope(placement_methods.scaled_distance_less_one).any()
    cheap = functools.partial(jaxbe.margin, steps=0)
    assert np.linalg.norm(slope(cheap)) > 1


def fake(name, after, first=True, clearance=0.001):
    return {
        "prepared_in": 2.0 if name == OURS else 0.01,
        "solved_after": after,
        "tried_for": after or 30.0,
        "from_first_start": first and after is not None,
        "clearance": clearance,
    }


def numbers(runs):
    task = {
        "instances": 4,
        "deep": [True, False, True, False],
        "ellipsoids": 2,
        "wanted_margin": 0.02,
        "wanted_clearance": 0.003,
        "judge_compiled_in": 1.0,
        "seconds_of_mujoco": {"mj_collision": 1e-5, "mj_geomDistance": 1e-4},
        "runs": runs,
    }
    return {
        "machine": {"cores": 1},
        "versions": {"cma": "4"},
        "budget": 30.0,
        "failures": {},
        "cores_busy_with_others": 0.0,
        "tasks": {"shelf": task},
        "rates": [{"rate": 0.01, "margin": [True] * 4, "other": [False] * 3 + [True]}],
    }


def cells(text, name):
    line = next(line for line in text.splitlines() if line.startswith(f"| {name} "))
    return [cell.strip() for cell in line.strip("|").split("|")][1:]


def test_the_report_gives_bounds_where_there_is_no_success(tmp_path):
    runs = {
        OURS: [fake(OURS, t, t < 0.04) for t in (0.01, 0.02, 0.03, 0.04)],
        "MuJoCo, CMA-ES": [fake("", None, clearance=-0.01), fake("", None)],
        "MuJoCo, differences, Adam": [fake("", t) for t in (0.25, 0.25, 0.25, None)],
    }
    text = placement_report.text(numbers(runs))
    assert cells(text, OURS) == [
        *("4 of 4", "3 of 4 (2 of 2)", "1.0, 1.0", "25 ms", "40 ms"),
        *("1.0", "2.0 s", "2.0 s"),
    ]
    # On its two instances, the median of ours is 15 ms.
    assert cells(text, "MuJoCo, CMA-ES") == [
        *("0 of 2", "0 of 2 (0 of 1)", "-4.5, -10.0", "none in 30 s", "none in 30 s"),
        *("> 2,000", "10 ms", "none in 30 s"),
    ]
    assert cells(text, "MuJoCo, differences, Adam")[3:6] == [
        *("250 ms", "none in 30 s", "10"),
    ]
    assert cells(text, "0.01") == ["4 of 4", "2 of 2", "1 of 4", "0 of 2"]
    placement_report.draw(numbers(runs), tmp_path / "a.png")
    check_picture(tmp_path / "a.png")


def test_a_missing_package_is_reported(monkeypatch):
    method = METHODS["MuJoCo, CMA-ES"]._replace(package="no_such_package")
    monkeypatch.setattr(placement, "METHODS", {"a": method, "b": METHODS[OURS]})
    failures = {}
    assert list(placement.available(failures)) == ["b"]
    assert "no_such_package" in failures["a"]


@pytest.mark.slow
def test_the_command(tmp_path):
    names = {"json": "a.json", "markdown": "a.md", "figure": "a.png"}
    files = {k: tmp_path / v for k, v in names.items()}
    placement.main(["--quick", *(f"--{k}={v}" for k, v in files.items())])
    measured = json.loads(files["json"].read_text())
    assert list(measured["tasks"]) == list(placement.KINDS)
    for task in measured["tasks"].values():
        assert all(run["solved_after"] for run in task["runs"][OURS])
    assert OURS in files["markdown"].read_text()
    check_picture(files["figure"])
