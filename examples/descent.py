"""python examples/3_second_order.py  # this file is imported, not run.

Gradients, Hessians and one line search for batches of small problems; Newton's step.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from placing import Pose
from rich.progress import track

VARIABLES = 6
"""Of a pose: three metres, three radians."""

LENGTHS = 2.0 ** -jnp.arange(12.0)
"""Of the steps tried, all at once: no loop in the search."""

ARRIVED = 1e-3
"""The gradient's size (per metre and radian) that ends a descent."""

FLATTEST = 1e-4
"""Curvatures below that, by the largest, are taken as that."""


class Objective:
    """A function of x (n,) and more, infinite where x is not allowed, for batches.

    Each of its derivatives is compiled once, for all descents.
    """

    def __init__(
        self, function: Callable[..., jax.Array], likely: Callable[..., jax.Array]
    ) -> None:
        """`likely` is cheaper than the Hessian (n, n), and like it."""
        self.likely = jax.jit(jax.vmap(likely))
        self.gradient = jax.jit(jax.vmap(jax.grad(function)))
        self.hessian = jax.jit(jax.vmap(jax.jacfwd(jax.grad(function))))
        self._search = jax.jit(jax.vmap(functools.partial(_search, function)))

    def search(self, x: jax.Array, way: jax.Array, *more: Any) -> jax.Array:
        """The best of some points x + length * way, or x; all of shape (B, n)."""
        return self._search(x, way, *more)

    def hessian_by_gradient(self, *more: Any) -> float:
        """How many gradients take as long as a Hessian."""
        at = jnp.zeros((len(jax.tree.leaves(more)[0]), VARIABLES)), *more
        return seconds(self.hessian, *at) / seconds(self.gradient, *at)


def seconds(function: Any, *arguments: Any, repeats: int = 20) -> float:
    """Of a call, compiled: the median."""
    times = []
    for _ in range(1 + repeats):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - began)
    return float(np.median(times[1:]))


def _search(function: Any, x: jax.Array, way: jax.Array, *more: Any) -> jax.Array:
    lengths = jnp.append(LENGTHS, 0).astype(x.dtype)
    tried = x + lengths[:, None] * way
    values = jax.vmap(lambda x: function(x, *more))(tried)
    return tried[jnp.argmin(jnp.where(jnp.isnan(values), jnp.inf, values))]


@jax.jit
@jax.vmap
def newton_way(gradient: jax.Array, hessian: jax.Array) -> jax.Array:
    """Newton's step (B, n); down also where the curvature is negative."""
    curvature, axes = jnp.linalg.eigh(hessian)
    size = jnp.abs(curvature)
    size = jnp.maximum(size, FLATTEST * size.max())
    return -axes @ ((axes.T @ gradient) / size)


class Descent(NamedTuple):
    """Where all starts end (S, n), gradients (S, T), seconds of one step of one."""

    x: jax.Array
    gradient: np.ndarray
    seconds: float


Step = tuple[Callable[..., Any], Callable[..., Any]]
"""From x, gradient and memory to x and memory, for a batch; and the first memory."""


def newton(goal: Objective, start: Pose) -> Step:
    """The margins' Hessian."""

    def step(x: jax.Array, g: jax.Array, memory: Any) -> Any:
        way = newton_way(g, goal.hessian(x, start))
        return goal.search(x, way, start), memory

    return step, lambda x: None


def gauss_newton(goal: Objective, start: Pose) -> Step:
    """What is likely to be the Hessian, from gradients."""

    def step(x: jax.Array, g: jax.Array, memory: Any) -> Any:
        way = newton_way(g, goal.likely(x, start))
        return goal.search(x, way, start), memory

    return step, lambda x: None


def steepest(goal: Objective, start: Pose) -> Step:
    """Down the gradient; the steps tried are at most one metre or radian."""

    def step(x: jax.Array, g: jax.Array, memory: Any) -> Any:
        way = -g / jnp.linalg.norm(g, axis=-1, keepdims=True)
        return goal.search(x, way, start), memory

    return step, lambda x: None


def l_bfgs(goal: Objective, start: Pose) -> Step:
    """Optax's approximation of the Hessian's inverse from ten gradients."""
    rule = optax.scale_by_lbfgs()
    update = jax.jit(jax.vmap(rule.update))

    def step(x: jax.Array, g: jax.Array, memory: Any) -> Any:
        way, memory = update(g, memory, x)
        return goal.search(x, -way, start), memory

    return step, jax.vmap(rule.init)


def adam(goal: Objective, start: Pose) -> Step:
    """Optax's, without a line search."""
    rule = optax.adam(optax.cosine_decay_schedule(3e-3, STEPS["Adam"]))
    update = jax.jit(rule.update)

    def step(x: jax.Array, g: jax.Array, memory: Any) -> Any:
        way, memory = update(g, memory)
        return x + way, memory

    return step, rule.init


METHODS = {
    "Newton": newton,
    "Gauss-Newton": gauss_newton,
    "L-BFGS": l_bfgs,
    "steepest descent": steepest,
    "Adam": adam,
}
STEPS = {
    "Newton": 50,
    "Gauss-Newton": 80,
    "L-BFGS": 150,
    "steepest descent": 300,
    "Adam": 800,
}


def descend(name: str, goal: Objective, start: Pose, steps: int) -> Descent:
    """All starts at once; once more to be timed without compilation."""
    step, memory_of = METHODS[name](goal, start)
    for count in (2, steps):
        x = jnp.zeros((len(start.position), VARIABLES))
        memory, sizes, began = memory_of(x), [], time.perf_counter()
        for _ in track(range(count), description=name, transient=True):
            g = goal.gradient(x, start)
            sizes.append(jnp.linalg.norm(g, axis=-1))
            x, memory = step(x, g, memory)
        sizes = np.array(sizes).T
    seconds = (time.perf_counter() - began) / sizes.size
    return Descent(x, sizes, seconds)


def summary(one: Descent) -> dict[str, float | None]:
    """The starts that arrive, their steps (None: never), and the time of a step."""
    there = one.gradient < ARRIVED
    steps = np.where(there.any(axis=1), there.argmax(axis=1), np.inf)
    median, late = np.quantile(steps, [0.5, 0.9], method="higher").tolist()
    return {
        "arrive, %": 100 * float(there.any(axis=1).mean()),
        "steps, median": median if np.isfinite(median) else None,
        "steps, 90 %": late if np.isfinite(late) else None,
        "a step, us": 1e6 * one.seconds,
    }


def log_barrier(margins: jax.Array) -> jax.Array:
    """Minus the sum of their logarithms; infinite if one is not positive."""
    allowed = jnp.all(margins > 0)
    logs = jnp.log(jnp.where(margins > 0, margins, 1)).sum()
    return jnp.where(allowed, -logs, jnp.inf)


def turned(quaternion: jax.Array, r: jax.Array) -> jax.Array:
    """A quaternion (4,) turned by r (3,), small: by about |r| radians."""
    w, v = quaternion[0], quaternion[1:]
    half = r / 2
    scalar = w - half @ v
    return jnp.concatenate([scalar[None], v + w * half + jnp.cross(half, v)])
