"""The contact benchmark: MuJoCo gets the very pairs, and the report is a table."""

import jax
import numpy as np

import jaxbe
from benchmarks import contact_speed, scenes


def test_mujoco_finds_contacts_in_the_pairs_that_overlap():
    pairs = scenes.random(60, seed=90)
    loop = contact_speed.mujoco_loop(pairs)
    loop()
    _, data = loop.args
    depth = -np.asarray(jax.jit(jaxbe.signed_distance)(*pairs.bodies()))
    assert np.sum(depth > 1e-4) <= data.ncon
    touched = {tuple(sorted(c.geom)) for c in data.contact}
    assert len(touched) == np.sum(depth > 0)


def test_report():
    numbers = {
        "machine": {"cores": 1},
        "mujoco": "4",
        "compile_seconds": {"contact": 9.0},
        "pairs_per_second": {"contact": 2e6, "mj_collision": 5e5},
        "cores_busy_with_others": 0.0,
    }
    assert "| contact      |                   2 |            4.0 |" in (
        contact_speed.text(numbers)
    )
