"""The programs that `benchmarks.programs` compiles, and the limits that they keep.

    python -m benchmarks.program_list DEVICE FOLDER PAIRS DTYPE NAME

compiles one and prints what it is made of, in a process with the environment and the
folder of `benchmarks.absent_device`.
"""

from __future__ import annotations

import json
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxbe
from benchmarks import absent_device, machine
from benchmarks.settings import Setting

ENVIRONMENTS = 4096
"""Of `filter_contacts`."""

Built = tuple[Callable[..., Any], tuple[Any, ...], int]
"""A function, the shapes of its arguments, and the pairs in them."""


class Limits(NamedTuple):
    """The most that a program for an H100 may need, in float32.

    Attributes:
        instructions: of a pair, with those of the device functions.
        temporary: bytes a pair.
        compile_seconds: with jax 0.10, on two quiet cores; twice as many with later.
        spilled: bytes of the kernel that spills most.
        functions: on the device.
    """

    instructions: int
    temporary: int
    compile_seconds: int
    spilled: int = 0
    functions: int = 0


TPU_COMPILE_SECONDS = 30

LIMITS = {
    **{f"overlap, {method}": Limits(520, 0, 2) for method in jaxbe.METHODS},
    "scaled_distance": Limits(360, 0, 2),
    "certify": Limits(1050, 64, 4),
    "margin, 5 steps": Limits(2200, 130, 6),
    "margin, 10 steps": Limits(4200, 160, 12),
    "margin and gradients, 5 steps": Limits(4200, 160, 14, spilled=32),
    "Hessian of the margin in the center": Limits(8200, 350, 25, spilled=64),
    "signed_distance, 3 steps": Limits(9500, 160, 18),
    "signed_distance, 5 steps": Limits(14_000, 160, 25),
    "signed_distance and gradients, 3 steps": Limits(11_500, 200, 30, spilled=64),
    "distance_bounds, 3 steps": Limits(12_500, 200, 25, spilled=64),
    "contact, 3 steps": Limits(10_000, 160, 20, spilled=32),
    "contact, as MJX's collision function": Limits(12_000, 160, 20, spilled=32),
}


def _shapes(pairs: int, dtype: str) -> tuple[jaxbe.Box, jaxbe.Ellipsoid]:
    fields = [jax.ShapeDtypeStruct((pairs, *x), dtype) for x in ((3,), (3, 3), (3,))]
    bodies = jaxbe.Box.unchecked, jaxbe.Ellipsoid.unchecked
    box, ellipsoid = (jax.eval_shape(body, *fields) for body in bodies)
    return box, ellipsoid


def _setting(setting: Setting) -> Callable[[int, str], Built]:
    return lambda pairs, dtype: (jax.vmap(setting.call), _shapes(pairs, dtype), pairs)


def _hessian(pairs: int, dtype: str) -> Built:
    def margin(center: Any, box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> Any:
        axes, semi_axes = ellipsoid.axes, ellipsoid.semi_axes
        moved = jaxbe.Ellipsoid.unchecked(center, axes, semi_axes)
        return jaxbe.margin(box, moved)

    box, ellipsoid = _shapes(pairs, dtype)
    arguments = ellipsoid.center, box, ellipsoid
    return jax.vmap(jax.hessian(margin)), arguments, pairs


def _contact_derivative(pairs: int, dtype: str) -> Built:
    def derivative(bodies: Any, tangents: Any) -> Any:
        return jax.jvp(jaxbe.contact, bodies, tangents)

    bodies = _shapes(pairs, dtype)
    return derivative, (bodies, bodies), pairs


def _poses(environments: int, geoms: int, dtype: str) -> tuple[Any, Any]:
    shapes = (environments, geoms, 3), (environments, geoms, 3, 3)
    position, axes = (jax.ShapeDtypeStruct(shape, dtype) for shape in shapes)
    return position, axes


def _collision(pairs: int, dtype: str) -> Built:
    """As MJX's driver calls it, of the pairs of the shipped scene."""
    # Only here: the others need no mujoco.
    from benchmarks import filter_scenes
    from jaxbe.mjx.ellipsoid_box import ellipsoid_box

    size, geom = filter_scenes.arm().geom_size, filter_scenes.arm_pairs().geom
    model = types.SimpleNamespace(geom_size=np.asarray(size, dtype))

    def collide(position: Any, axes: Any) -> Any:
        data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        return ellipsoid_box(model, data, None, geom)

    environments = -(-pairs // len(geom))
    poses = _poses(environments, len(size), dtype)
    return jax.vmap(collide), poses, environments * len(geom)


def _filter(_: int, dtype: str) -> Built:
    from benchmarks import filter_scenes, filter_times

    model, pairs = filter_scenes.arm(), filter_scenes.arm_pairs()
    run = filter_times.filtered(model, pairs, max_pairs=filter_times.MAX_PAIRS)
    poses = _poses(ENVIRONMENTS, model.ngeom, dtype)
    return run, poses, ENVIRONMENTS * len(pairs)


_SETTINGS = (
    *(Setting("overlap", ("method", method)) for method in jaxbe.METHODS),
    Setting("scaled_distance"),
    Setting("scaled_distance", gradients=True),
    Setting("certify"),
    Setting("margin", ("steps", 5)),
    Setting("margin", ("steps", 10)),
    Setting("margin_bounds", ("steps", 5)),
    Setting("margin", ("steps", 5), gradients=True),
    Setting("signed_distance", ("steps", 3)),
    Setting("signed_distance", ("steps", 5)),
    Setting("signed_distance", ("steps", 3), gradients=True),
    Setting("distance_bounds", ("steps", 3)),
    Setting("contact", ("steps", 3)),
)

PROGRAMS: dict[str, Callable[[int, str], Built]] = {
    **{setting.name: _setting(setting) for setting in _SETTINGS},
    "contact, as MJX's collision function": _collision,
    "contact and its derivative": _contact_derivative,
    "Hessian of the margin in the center": _hessian,
    f"filter_contacts, {ENVIRONMENTS:,} environments": _filter,
}
"""By name: makes a program for a number of pairs and a dtype."""


def main(arguments: list[str]) -> None:
    """Compiles one program."""
    device, folder, pairs, dtype, name = arguments
    jax.config.update("jax_enable_x64", dtype == "float64")
    function, shapes, count = PROGRAMS[name](int(pairs), dtype)
    load = machine.OtherLoad()
    found = absent_device.compile_for(device, Path(folder), function, shapes)
    about = {"pairs": count, "cores_busy_with_others": load.cores()}
    print(json.dumps(about | dict(found)))


if __name__ == "__main__":
    main(sys.argv[1:])
