"""The methods that `benchmarks.placement` compares.

Each is prepared for a problem (compiled, built), then run with a watch until that
raises `Finished`. One that stalls goes on from the next of the problem's starts.
"""

from __future__ import annotations

import functools
import importlib
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy import optimize

import jaxbe
from benchmarks import placement_mujoco as mj
from benchmarks.placement_tasks import (
    MARGIN,
    Instance,
    Pose,
    Problem,
    Watch,
    loss_of,
)

ITERATIONS = 400
"""From one start, of methods with a gradient."""

BLOCK = 20
"""Iterations between looks at what Adam has reached."""

AT_ONCE = 64
"""Starts in one vmap, as in examples/2_packing.py."""

Run = Callable[[Watch], None]

Minimise = Callable[[Any, np.ndarray, float], None]
"""Of a function that gives value and slope, from x, with a rate if it needs one."""


def scaled_distance_less_one(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
    """Its gradient vanishes where the ellipsoid's centre is in the box."""
    return jaxbe.scaled_distance(box, ellipsoid) - 1


class Adam(NamedTuple):
    """The first memory of poses (S, N), and a block of iterations at a rate."""

    begin: Any
    block: Any


@functools.cache
def adam_of(room: Callable[..., jax.Array], wanted: float) -> Adam:
    """Compiled once a shape; losses come in units of one margin missing whole."""
    decay = optax.cosine_decay_schedule(-1.0, ITERATIONS)
    optimiser = optax.chain(optax.scale_by_adam(), optax.scale_by_schedule(decay))

    def missing(pose: Pose, task: Instance) -> jax.Array:
        return loss_of(pose, task, wanted, room) / wanted**2

    def step(task: Instance, rate: jax.Array, carry: Any, _: None) -> Any:
        pose, memory, *_ = carry
        value, slope = jax.value_and_grad(missing)(pose, task)
        change, memory = optimiser.update(slope, memory)
        change = jax.tree.map(lambda x: rate * x, change)
        return (optax.apply_updates(pose, change), memory, pose, value), None

    def block(pose: Pose, memory: Any, task: Instance, rate: jax.Array) -> Any:
        """The poses and memory to go on from; the poses before these, their losses."""
        begin = pose, memory, pose, jnp.zeros((), pose.position.dtype)
        some = functools.partial(step, task, rate)
        return jax.lax.scan(some, begin, length=BLOCK)[0]

    begin = jax.jit(jax.vmap(optimiser.init))
    return Adam(begin, jax.jit(jax.vmap(block, in_axes=(0, 0, None, None))))


def by_gradient(
    problem: Problem, room: Any, at_once: int = 1, rate: float | None = None
) -> Run:
    """Adam on the loss of the examples, at the problem's rate if none is given."""
    task, adam = jax.device_put(problem.task), adam_of(room, problem.wanted)
    fixed = task, jnp.asarray(rate or problem.rate, jnp.float32)

    def part(first: int) -> Pose:
        chosen = slice(first, first + at_once)
        return jax.tree.map(lambda x: jax.device_put(x[chosen]), problem.starts)

    def run(watch: Watch) -> None:
        for watch.start in range(0, len(problem.starts[0]), at_once):
            pose = part(watch.start)
            memory = adam.begin(pose)
            for _ in range(ITERATIONS // BLOCK):
                pose, memory, before, losses = adam.block(pose, memory, *fixed)
                _show_best(watch, np.asarray(losses), before)

    # To compile is to prepare.
    jax.block_until_ready(adam.block(part(0), adam.begin(part(0)), *fixed))
    return run


def _show_best(watch: Watch, losses: np.ndarray, pose: Pose) -> None:
    best = int(np.argmin(losses))
    pick = lambda: jax.tree.map(lambda x: np.asarray(x)[best], pose)  # noqa: E731
    watch.show(float(losses[best]), pick)


def by_minimiser(problem: Problem, room: Any, minimise: Minimise) -> Run:
    """The same loss and gradient for a minimiser in Python."""
    task, n = jax.device_put(problem.task), len(problem.task.semi_axes)
    unit = np.float32([1] * 3 + [1 / mj.radius(problem.task)] * 4)
    program = value_and_slope_of(room, problem.wanted)

    def run(watch: Watch) -> None:
        for watch.start in range(len(problem.starts[0])):
            pose = jax.tree.map(lambda x: x[watch.start], problem.starts)

            def value_and_slope(x: np.ndarray) -> Any:
                rows = np.float32(x.reshape(n, -1)) * unit
                value, slope = program(rows, task)
                watch.show(float(value), lambda: Pose(rows[:, :3], rows[:, 3:]))
                return float(value), np.float64(slope * unit).ravel()

            minimise(value_and_slope, (rows_of(pose) / unit).ravel(), problem.rate)

    jax.block_until_ready(
        program(rows_of(jax.tree.map(lambda x: x[0], problem.starts)), task)
    )
    return run


def rows_of(pose: Pose) -> np.ndarray:
    """Positions and quaternions (N, 7) of length one."""
    position, quaternion = pose
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.concatenate([position, quaternion / length], axis=-1)


@functools.cache
def value_and_slope_of(room: Callable[..., jax.Array], wanted: float) -> Any:
    """Of poses as rows (N, 7); compiled once a shape."""

    def missing(rows: jax.Array, task: Instance) -> jax.Array:
        return loss_of(Pose(rows[:, :3], rows[:, 3:]), task, wanted, room) / wanted**2

    return jax.jit(jax.value_and_grad(missing))


def by_differences(problem: Problem, minimise: Minimise) -> Run:
    """Finite differences of MuJoCo's distances."""
    differences = mj.Differences(problem)
    shape = len(problem.task.semi_axes), mj.VARIABLES

    def run(watch: Watch) -> None:
        for watch.start in range(len(problem.starts[0])):
            moves = mj.Moves(problem, watch.start)

            def value_and_slope(x: np.ndarray, moves: Any = moves) -> Any:
                x = x.reshape(shape)
                value, slope = differences(moves, x)
                watch.show(value, lambda: moves.pose(x))
                return value, slope.ravel()

            minimise(value_and_slope, np.zeros(np.prod(shape)), problem.rate)

    return run


def by_scipy_alone(problem: Problem) -> Run:
    """L-BFGS-B told nothing but MuJoCo's loss: it differs all numbers by itself."""
    losses, shape = mj.Loss(problem), (1, len(problem.task.semi_axes), mj.VARIABLES)
    options = LBFGS_OPTIONS | {"maxfun": 10**9, "eps": mj.STEP}

    def run(watch: Watch) -> None:
        for watch.start in range(len(problem.starts[0])):
            moves = mj.Moves(problem, watch.start)

            def value(x: np.ndarray, moves: Any = moves) -> float:
                pose = moves.pose(x.reshape(shape))
                found = losses(pose)
                _show_best(watch, found, pose)
                return float(found[0])

            start = np.zeros(np.prod(shape))
            optimize.minimize(value, start, method="L-BFGS-B", options=options)

    return run


LBFGS_OPTIONS = {"maxiter": ITERATIONS, "ftol": 1e-3}
"""The tolerance is the best of 1e-9 to 1e-2: it notices soon if stuck."""


def lbfgs(value_and_slope: Any, x: np.ndarray, rate: float) -> None:
    """SciPy's."""
    options: Any = {"method": "L-BFGS-B", "options": LBFGS_OPTIONS}
    optimize.minimize(value_and_slope, x, jac=True, **options)


def adam(value_and_slope: Any, x: np.ndarray, rate: float) -> None:
    """As for jaxbe, in NumPy."""
    mean, square, decay = np.zeros_like(x), np.zeros_like(x), (0.9, 0.999)
    for i in range(ITERATIONS):
        _, slope = value_and_slope(x)
        mean = decay[0] * mean + (1 - decay[0]) * slope
        square = decay[1] * square + (1 - decay[1]) * slope**2
        m, s = (
            v / (1 - d ** (i + 1)) for v, d in zip((mean, square), decay, strict=True)
        )
        decayed = rate * (1 + np.cos(np.pi * i / ITERATIONS)) / 2
        x = x - decayed * m / (np.sqrt(s) + 1e-8)


def by_cma(problem: Problem) -> Run:
    """CMA-ES on the loss by MuJoCo, a population in one call."""
    shape = len(problem.task.semi_axes), mj.VARIABLES
    begin = functools.partial(cma_strategy, int(np.prod(shape)), problem.sigma)
    losses = mj.Loss(problem, begin().popsize)

    def run(watch: Watch) -> None:
        for watch.start in range(len(problem.starts[0])):
            moves = mj.Moves(problem, watch.start)
            strategy = begin()
            while not strategy.stop():
                asked = strategy.ask()
                poses = moves.pose(np.reshape(asked, (-1, *shape)))
                found = losses(poses)
                strategy.tell(asked, found)
                _show_best(watch, found, poses)

    return run


def cma_strategy(variables: int, sigma: float) -> Any:
    """At zero, with the best of the options tried."""
    options: dict[str, Any] = {"verbose": -9, "seed": 1, "tolfun": 1e-2}
    # Success takes some hundred generations; what takes many more is stuck.
    options["maxiter"] = 500 + 3 * variables
    if variables > 50:
        # A whole covariance learns too slowly, and costs more.
        options |= {"CMA_diagonal": True, "popsize": 12}
    strategy = importlib.import_module("cma").CMAEvolutionStrategy
    # It warns of axes that grow where the loss is flat, every generation.
    warnings.filterwarnings("ignore", "elements of z2", UserWarning)
    return strategy(np.zeros(variables), sigma, options)


ROOMS = {"margin": MARGIN, "sqrt(q) - 1": scaled_distance_less_one}


class Method(NamedTuple):
    """What is compared.

    Attributes:
        prepare: compiles or builds, for a problem.
        package: what is missing where it cannot be imported.
        slow: whether it gets fewer instances.
    """

    prepare: Callable[[Problem], Run]
    package: str = "jaxbe"
    slow: bool = False


OURS = "jaxbe, Adam"
"""What the others are compared with."""

METHODS = {
    OURS: Method(functools.partial(by_gradient, room=MARGIN)),
    "jaxbe, L-BFGS-B": Method(
        functools.partial(by_minimiser, room=MARGIN, minimise=lbfgs), "scipy"
    ),
    f"jaxbe, Adam, {AT_ONCE} starts at once": Method(
        functools.partial(by_gradient, room=MARGIN, at_once=AT_ONCE)
    ),
    "sqrt(q) - 1, Adam": Method(
        functools.partial(by_gradient, room=scaled_distance_less_one)
    ),
    "MuJoCo, differences, L-BFGS-B": Method(
        functools.partial(by_differences, minimise=lbfgs), "scipy"
    ),
    "MuJoCo, differences, Adam": Method(
        functools.partial(by_differences, minimise=adam), "mujoco"
    ),
    "MuJoCo, SciPy's differences, L-BFGS-B": Method(by_scipy_alone, "scipy", slow=True),
    "MuJoCo, CMA-ES": Method(by_cma, "cma", slow=True),
}
