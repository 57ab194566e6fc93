"""Agreement with MuJoCo C's `mj_geomDistance`, on a sample."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from jaxbe import Box, Ellipsoid, scaled_distance
from jaxbe.cli.rounding import rounding_in_metres
from jaxbe.cli.sample import Drawn
from jaxbe.cli.states import Floats
from jaxbe.mjx import Pairs


class Disagreement(NamedTuple):
    """A pair in a state where jaxbe and MuJoCo C differ beyond their tolerances.

    Attributes:
        state: its number.
        pair: its number.
        overlapping: jaxbe's answer.
        scaled_distance: in the dtype of the run.
        scaled_distance_float64: recomputed from the poses in float64; at most 1
            where the pair overlaps.
        mujoco_distance: metres, negative where MuJoCo C says they overlap.
        tolerance: metres.
    """

    state: int
    pair: int
    overlapping: bool
    scaled_distance: float
    scaled_distance_float64: float
    mujoco_distance: float
    tolerance: float


class Crosscheck(NamedTuple):
    """The comparison.

    Attributes:
        checked: how many pairs in states were compared.
        overlapping: how many of them overlap by jaxbe.
        differing: on how many the answers differ at all.
        ccd_tolerance: MuJoCo's own, metres.
        largest_rounding: the largest that was added to it, metres.
        disagreements: the differences beyond both.
    """

    checked: int
    overlapping: int
    differing: int
    ccd_tolerance: float
    largest_rounding: float
    disagreements: list[Disagreement]


class _Measured(NamedTuple):
    """MuJoCo's view of the sample: distances (n,) and the poses used."""

    distance: Floats
    position: Floats
    axes: Floats


def crosscheck(model: Any, data: Any, pairs: Pairs, drawn: Drawn) -> Crosscheck:
    """Compares the sampled answers with MuJoCo C.

    MuJoCo's distance is the result of an iteration that stops within
    `opt.ccd_tolerance` metres, so nearer to 0 its sign is open. (Before MuJoCo
    3.3.5 the distance of bodies that overlap comes out positive.) jaxbe's answer is
    open where rounding could change it (`jaxbe.cli.rounding`). A disagreement is
    a difference further from touching than the sum of the two.

    Args:
        model: a `mujoco.MjModel`.
        data: its `mujoco.MjData`, overwritten.
        pairs: of the model.
        drawn: the sample; the dtype of its ratio is that of the tests.
    """
    measured = _measure(model, data, pairs.geom[drawn.pair], drawn.qpos)
    geom = pairs.geom[drawn.pair]
    rounding = rounding_in_metres(
        measured.position,
        model.geom_size[geom[:, 1]],
        model.geom_size[geom[:, 0]],
        str(drawn.ratio.dtype),
    )
    tolerance = model.opt.ccd_tolerance + rounding
    differ = drawn.overlapping != (measured.distance <= 0)
    beyond = np.flatnonzero(differ & (abs(measured.distance) > tolerance))
    exact = _float64_ratio(model, geom, measured)
    return Crosscheck(
        len(drawn.state),
        int(drawn.overlapping.sum()),
        int(differ.sum()),
        float(model.opt.ccd_tolerance),
        float(rounding.max(initial=0)),
        [
            Disagreement(
                int(drawn.state[i]),
                int(drawn.pair[i]),
                bool(drawn.overlapping[i]),
                float(drawn.ratio[i]),
                float(exact[i]),
                float(measured.distance[i]),
                float(tolerance[i]),
            )
            for i in beyond
        ],
    )


def _measure(
    model: Any, data: Any, geom: NDArray[np.integer[Any]], qpos: Floats
) -> _Measured:
    distance = np.empty(len(qpos))
    position, axes = np.empty((len(qpos), 2, 3)), np.empty((len(qpos), 2, 9))
    for i, ((ellipsoid, box), row) in enumerate(zip(geom, qpos, strict=True)):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        distance[i] = mujoco.mj_geomDistance(
            model, data, ellipsoid, box, mujoco.mjMAXVAL, None
        )
        position[i], axes[i] = data.geom_xpos[geom[i]], data.geom_xmat[geom[i]]
    return _Measured(distance, position, axes.reshape(-1, 2, 3, 3))


def _float64_ratio(
    model: Any, geom: NDArray[np.integer[Any]], measured: _Measured
) -> Floats:
    """`scaled_distance` in float64, whatever dtype the tests ran in."""
    ellipsoid, box = (
        (
            jnp.asarray(measured.position[:, i]),
            jnp.asarray(measured.axes[:, i]),
            jnp.asarray(model.geom_size[geom[:, i]]),
        )
        for i in range(2)
    )
    ratio = scaled_distance(Box.unchecked(*box), Ellipsoid.unchecked(*ellipsoid))
    return np.asarray(ratio)
