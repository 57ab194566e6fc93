"""How long the filter takes on the shipped scene, and what its shortcuts save."""

from __future__ import annotations

import functools
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import filter_scenes, timing
from benchmarks.filter_scenes import Sample
from jaxbe.lower_bound import distance_lower_bound
from jaxbe.mjx import Pairs, filter_contacts
from jaxbe.mjx.bounds import of_pairs
from jaxbe.mjx.filter import nearest_candidates
from jaxbe.shapes import Box, Ellipsoid

MAX_PAIRS = 16
SAMPLE_SECONDS = 0.02
"""So long a sample of a small batch takes."""

Call = Callable[[], Any]


def counts(most: int) -> list[int]:
    """1, 8, 64... environments, and the most."""
    return sorted({n for n in (1, 8, 64, 512, 4096) if n < most} | {most})


def measure_throughput(
    environments: Sequence[int], repeats: int, tick: Callable[[], Any]
) -> list[dict[str, Any]]:
    """Seconds a call by number of environments."""
    pool = filter_scenes.arm_states(0, 512, 0)
    points = []
    for n in environments:
        poses = _poses(pool, n)
        tasks = {
            f"filter, {MAX_PAIRS} places": _filter(filter_scenes.arm(), poses),
            "filter, all places": _filter(filter_scenes.arm(), poses, max_pairs=None),
            f"filter, {MAX_PAIRS} places, steps=0": _filter(
                filter_scenes.arm(), poses, steps=0
            ),
            f"bounding spheres, {MAX_PAIRS} places": _spheres(poses),
        }
        points.append({"environments": n} | interleaved(tasks, repeats))
        tick()
    return points


def measure_savings(environments: int, repeats: int) -> dict[str, Any]:
    """Each shortcut with and without."""
    poses = _poses(filter_scenes.arm_states(0, 512, 0), environments)
    model, round_model = filter_scenes.arm(), with_spheres(filter_scenes.arm())
    pairs, every = filter_scenes.arm_pairs(), filter_scenes.every_pair(model)
    fixed = fixed_boxes(model)
    tasks = {
        "pairs that may collide": _filter(model, poses),
        "every ellipsoid and box": _filter(model, poses, every),
        "spheres, known": _filter(round_model, poses),
        "spheres, sizes an argument": _filter(round_model, poses, known=False),
        "boxes that never move, from one state": _fixed(model, poses, True),
        "boxes that never move, from every state": _fixed(model, poses, False),
    }
    return {
        "environments": environments,
        "pairs": len(pairs),
        "every_pair": len(every),
        "pairs_of_fixed_boxes": int(np.isin(pairs.geom[:, 1], fixed).sum()),
    } | interleaved(tasks, repeats)


def interleaved(tasks: Mapping[str, Call], repeats: int) -> dict[str, Any]:
    """Seconds a call, and how busy the machine was."""
    long = {
        name: timing.long_enough(timing.Task(call), SAMPLE_SECONDS)
        for name, call in tasks.items()
    }
    measured = timing.interleaved(long, repeats)
    return {
        "seconds": {name: t._asdict() for name, t in measured.times.items()},
        "cores_busy_with_others": measured.others,
    }


def with_spheres(model: Any) -> Any:
    """The same model with a sphere for each ellipsoid."""
    ids = np.unique(filter_scenes.arm_pairs().geom[:, 0])
    model.geom_size[ids] = model.geom_size[ids].mean(axis=1, keepdims=True)
    return model


def fixed_boxes(model: Any) -> np.ndarray:
    """Ids of the boxes, of the pairs, that are welded to the world."""
    ids = np.unique(filter_scenes.arm_pairs().geom[:, 1])
    body = model.geom_bodyid[ids]
    return ids[(model.body_weldid[body] == 0) & (model.body_mocapid[body] < 0)]


def _poses(pool: Sample, n: int) -> tuple[jax.Array, jax.Array]:
    """So many states, repeated."""
    rows = np.arange(n) % len(pool.position)
    return jnp.asarray(pool.position[rows]), jnp.asarray(pool.axes[rows])


def _compiled(function: Callable[..., Any], *arguments: Any) -> Call:
    return functools.partial(jax.jit(function).lower(*arguments).compile(), *arguments)


def filtered(model: Any, pairs: Pairs, **options: Any) -> Callable[..., Any]:
    """The filter as a function of poses, under vmap."""

    def run(position: Any, axes: Any) -> Any:
        data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        return filter_contacts(pairs, model, data, distance=0.0, **options)

    return jax.vmap(run)


def _filter(
    model: Any,
    poses: tuple[jax.Array, jax.Array],
    pairs: Pairs | None = None,
    *,
    known: bool = True,
    max_pairs: int | None = MAX_PAIRS,
    steps: int = 1,
) -> Call:
    pairs = filter_scenes.arm_pairs() if pairs is None else pairs
    options = {"max_pairs": max_pairs, "steps": steps}
    if known:
        return _compiled(filtered(model, pairs, **options), *poses)

    def run(size: Any, *poses: Any) -> Any:
        return filtered(types.SimpleNamespace(geom_size=size), pairs, **options)(*poses)

    return _compiled(run, jnp.asarray(model.geom_size, jnp.float32), *poses)


def _spheres(poses: tuple[jax.Array, jax.Array]) -> Call:
    """Bounding spheres in the place of the bounds, the rest as in the filter."""
    return _by_query(filter_scenes.between_spheres, filter_scenes.arm_pairs(), poses)


def _fixed(
    model: Any, poses: tuple[jax.Array, jax.Array], from_one_state: bool
) -> Call:
    """The pairs of boxes that never move; their poses batched, or those of a state."""
    ids, pairs = fixed_boxes(model), filter_scenes.arm_pairs()
    pairs = Pairs(pairs.geom[np.isin(pairs.geom[:, 1], ids)])
    position, axes = (np.asarray(x[0])[ids][None] for x in poses)
    prepared = Box.unchecked(position, axes, model.geom_size[ids][None].astype("f4"))

    def bound(box: Box, ellipsoid: Ellipsoid) -> jax.Array:
        return distance_lower_bound(prepared if from_one_state else box, ellipsoid, 1)

    return _by_query(bound, pairs, poses)


def _by_query(query: Any, pairs: Pairs, poses: tuple[jax.Array, jax.Array]) -> Call:
    """What the filter does with another query."""
    model = filter_scenes.arm()

    def run(position: Any, axes: Any) -> Any:
        data = types.SimpleNamespace(geom_xpos=position, geom_xmat=axes)
        found = of_pairs(query, pairs.geom, model, data)
        return nearest_candidates(pairs, found, found <= 0, MAX_PAIRS)

    return _compiled(jax.vmap(run), *poses)
