"""One adapter for each system that can say whether boxes touch ellipsoids.

An adapter takes pairs and a folder to build in and returns its `Peer`s. It may raise
whatever its package raises, `ImportError` above all: `benchmarks.peers` reports that.
Objects are made beforehand, so that the test alone is timed. Where Python loops over
the pairs, the same loop over two spheres tells how much of the time that is.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.metadata
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxbe
from benchmarks import ellipsoid_tree, layouts, naive, scenes
from jaxbe.pose import canonical_pair

FAR = 1e6
"""MuJoCo measures distances up to a limit: here there is none."""


class Answer(NamedTuple):
    """What a system says.

    Attributes:
        overlap: (n,) booleans.
        distance: (n,), in metres where the bodies are apart, if it tells.
    """

    overlap: np.ndarray
    distance: np.ndarray | None = None


class Peer(NamedTuple):
    """A system with pairs ready-made.

    Attributes:
        name: as the tables have it.
        dtype: in which it computes.
        looped_in: the language of the loop over the pairs.
        run: what is timed.
        read: what `run` returned, as an answer.
        spheres: the same loop over pairs of spheres, where it is Python's.
        pairs: how many `run` tests.
    """

    name: str
    dtype: str
    looped_in: str
    run: Callable[[], Any]
    read: Callable[[Any], Answer]
    pairs: int
    spheres: Callable[[], Any] | None = None

    def answer(self) -> Answer:
        """Runs and reads."""
        return self.read(self.run())


def signed(distances: Any) -> Answer:
    """The answer of a system that tells signed distances."""
    distances = np.asarray(distances, np.float64)
    return Answer(distances <= 0, distances)


def overlap(verdicts: Any) -> Answer:
    """The answer of a system that gives verdicts alone."""
    return Answer(np.asarray(verdicts, bool))


def in_python(calls: Iterable[Callable[[], Any]]) -> Callable[[], list[Any]]:
    """The plainest loop over ready-made calls."""
    ready = list(calls)
    return lambda: [call() for call in ready]


def coal(pairs: scenes.Scene, _: Path) -> Iterator[Peer]:
    """Coal's collision test and its signed distance."""
    library = importlib.import_module("coal")
    poses = [
        (
            library.Transform3s(scenes.proper(U), C),
            library.Transform3s(scenes.proper(V), K),
        )
        for C, U, _, K, V, _ in zip(*pairs, strict=True)
    ]
    bodies = [
        (library.Box(*(2 * e)), library.Ellipsoid(*a))
        for e, a in zip(pairs.e, pairs.a, strict=True)
    ]
    balls = [(library.Sphere(0.1), library.Sphere(0.1))] * pairs.size

    def calls(function: Any, shapes: Any, request: Any, result: Any) -> Any:
        for (one, other), (at, there) in zip(shapes, poses, strict=True):
            # Else the smallest distance so far is kept, and no other is computed.
            yield lambda o=one, s=at, p=other, t=there: (
                result.clear(),
                function(o, s, p, t, request, result),
            )[1]

    kinds = {
        "collide": (library.CollisionRequest, library.CollisionResult, overlap),
        "distance": (library.DistanceRequest, library.DistanceResult, signed),
    }
    for name, (Request, Result, read) in kinds.items():
        run, spheres = (
            in_python(calls(getattr(library, name), shapes, Request(), Result()))
            for shapes in (bodies, balls)
        )
        yield Peer(f"coal.{name}", "float64", "Python", run, read, pairs.size, spheres)


def python_fcl(pairs: scenes.Scene, _: Path) -> Iterator[Peer]:
    """FCL's collision test, and its distance of bodies that are apart."""
    fcl = importlib.import_module("fcl")

    def objects(box: Any, ellipsoid: Any) -> list[tuple[Any, Any]]:
        return [
            (
                fcl.CollisionObject(box(e), fcl.Transform(scenes.proper(U), C)),
                fcl.CollisionObject(ellipsoid(a), fcl.Transform(scenes.proper(V), K)),
            )
            for C, U, e, K, V, a in zip(*pairs, strict=True)
        ]

    bodies = objects(lambda e: fcl.Box(*(2 * e)), lambda a: fcl.Ellipsoid(*a))
    balls = objects(lambda _: fcl.Sphere(0.1), lambda _: fcl.Sphere(0.1))
    to_collide, to_measure = fcl.CollisionRequest(), fcl.DistanceRequest()
    make = {
        "collide": lambda o, p: fcl.collide(o, p, to_collide, fcl.CollisionResult()),
        "distance": lambda o, p: fcl.distance(o, p, to_measure, fcl.DistanceResult()),
    }
    for name, read in (("collide", overlap), ("distance", signed)):
        run, spheres = (
            in_python(functools.partial(make[name], *pair) for pair in shapes)
            for shapes in (bodies, balls)
        )
        yield Peer(
            f"python-fcl {name}", "float64", "Python", run, read, pairs.size, spheres
        )


def ellipsoid_tree_core(pairs: scenes.Scene, folder: Path) -> Iterator[Peer]:
    """The C++ core of ellipsoid-tree, without its Python bindings."""
    run = ellipsoid_tree.loop(pairs, folder)
    yield Peer("ellipsoid-tree, C++", "float64", "C++", run, overlap, pairs.size)


def mujoco_model(pairs: scenes.Scene, round_bodies: bool = False) -> tuple[Any, Any]:
    """MuJoCo's model of these pairs and no others, and its data, posed.

    Geom 2 i is box i, 2 i + 1 ellipsoid i; or all are spheres of 0.1 m.
    """
    mujoco = importlib.import_module("mujoco")
    spec, kinds = mujoco.MjSpec(), mujoco.mjtGeom
    spec.memory = 2**28
    boxes, ellipsoids = (
        (kinds.mjGEOM_SPHERE,) * 2
        if round_bodies
        else (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID)
    )
    for i, (C, U, e, K, V, a) in enumerate(zip(*pairs, strict=True)):
        bodies = (("b", boxes, C, U, e), ("e", ellipsoids, K, V, a))
        for letter, kind, center, axes, lengths in bodies:
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, scenes.proper(axes).ravel())
            spec.worldbody.add_body(pos=center, quat=quaternion).add_geom(
                name=f"{letter}{i}",
                type=kind,
                size=[0.1, 0, 0] if round_bodies else lengths,
                contype=0,
                conaffinity=0,
            )
        spec.add_pair(geomname1=f"e{i}", geomname2=f"b{i}")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def touching_geoms(geoms: np.ndarray, distances: np.ndarray, n: int) -> Answer:
    """The answer of contacts: their pairs of geoms, and how far apart these are."""
    verdicts = np.zeros(n, bool)
    verdicts[np.min(geoms[distances <= 0], axis=1) // 2] = True
    return Answer(verdicts)


def mujoco_c(pairs: scenes.Scene, _: Path) -> Iterator[Peer]:
    """MuJoCo's collisions, a loop in C, and its geom distances, one in Python."""
    mujoco = importlib.import_module("mujoco")
    model, data = mujoco_model(pairs)

    def read(_: Any) -> Answer:
        return touching_geoms(data.contact.geom, data.contact.dist, pairs.size)

    run = functools.partial(mujoco.mj_collision, model, data)
    yield Peer("MuJoCo mj_collision", "float64", "C", run, read, pairs.size)

    def distances(in_model: Any, with_data: Any) -> Callable[[], list[float]]:
        return in_python(
            functools.partial(
                mujoco.mj_geomDistance, in_model, with_data, 2 * i, 2 * i + 1, FAR, None
            )
            for i in range(pairs.size)
        )

    run, spheres = distances(model, data), distances(*mujoco_model(pairs, True))
    yield Peer(
        "MuJoCo mj_geomDistance", "float64", "Python", run, signed, pairs.size, spheres
    )


def mujoco_warp(pairs: scenes.Scene, _: Path) -> Iterator[Peer]:
    """MuJoCo Warp's collisions, on the CPU."""
    model, data = mujoco_model(pairs)

    def run() -> None:
        with wp.ScopedDevice("cpu"):
            mjw.collision(on_device, state)
            wp.synchronize()

    # It talks on stdout, where the report goes, while it compiles.
    with contextlib.redirect_stdout(sys.stderr):
        mjw, wp = (importlib.import_module(name) for name in ("mujoco_warp", "warp"))
        with wp.ScopedDevice("cpu"):
            on_device = mjw.put_model(model)
            state = mjw.put_data(model, data, naconmax=8 * pairs.size, njmax=1)
            mjw.kinematics(on_device, state)
        run()

    def read(_: Any) -> Answer:
        count = int(state.nacon.numpy()[0])
        geoms, distances = state.contact.geom.numpy(), state.contact.dist.numpy()
        return touching_geoms(geoms[:count], distances[:count], pairs.size)

    yield Peer("mujoco-warp, CPU", "float32", "kernel", run, read, pairs.size)


def jax_program(
    name: str, dtype: str, program: Any, arguments: Any, read: Any, n: int
) -> Peer:
    """A jitted JAX function of all pairs."""
    run = functools.partial(program, *arguments)
    return Peer(f"{name}, {dtype}", dtype, "XLA", run, read, n)


def naive_jax(pairs: scenes.Scene, _: Path) -> Iterator[Peer]:
    """The enumeration of 27 candidates."""
    for dtype in ("float32", "float64"):
        arguments = pairs.astype(dtype).bodies()
        program = layouts.by_vmap(naive.overlap)
        yield jax_program("naive JAX", dtype, program, arguments, overlap, pairs.size)


def qpax(pairs: scenes.Scene, _: Path) -> Iterator[Peer]:
    """The box's nearest point in the ellipsoid's metric, by an interior point method.

    In units near the largest semi-axis.
    """
    arguments = pairs.astype(np.float64).bodies()
    yield jax_program(
        "qpax", "float64", _qpax_program(), arguments, overlap, pairs.size
    )


@functools.cache
def _qpax_program() -> Callable[..., jax.Array]:
    solve = importlib.import_module("qpax").solve_qp

    def touches(box: jaxbe.Box, ellipsoid: jaxbe.Ellipsoid) -> jax.Array:
        pair = canonical_pair(box, ellipsoid)
        k, e, a = (jnp.stack(x) for x in (pair.k, pair.e, pair.a))
        R = jnp.array([list(row) for row in pair.R])
        M = R / a  # M M^T is the metric
        N, none = M @ M.T, jnp.zeros((0, 3), k.dtype)
        sides = jnp.concatenate([jnp.eye(3, dtype=k.dtype), -jnp.eye(3, dtype=k.dtype)])
        bounds = jnp.concatenate([e, e])
        x = solve(N, -N @ k, none, jnp.zeros(0, k.dtype), sides, bounds)[0]
        y = M.T @ (x - k)
        return y @ y <= 1

    return layouts.by_vmap(touches)


def jaxbe_verdicts(pairs: scenes.Scene) -> Iterator[Peer]:
    """The functions of jaxbe under vmap, in both dtypes, one peer each."""
    functions = {f"overlap, {m}": (_method(m), overlap) for m in jaxbe.METHODS} | {
        "margin": (jaxbe.margin, lambda x: Answer(np.asarray(x) <= 0)),
        "signed_distance": (jaxbe.signed_distance, signed),
        "contact": (jaxbe.contact, lambda c: signed(c.distance)),
    }
    for dtype in ("float32", "float64"):
        arguments = pairs.astype(dtype).bodies()
        for name, (function, read) in functions.items():
            program = layouts.by_vmap(function)
            yield jax_program(
                f"jaxbe.{name}", dtype, program, arguments, read, pairs.size
            )


def jaxbe_by_components(pairs: scenes.Scene) -> Iterator[Peer]:
    """`jaxbe.overlap` on arrays stored component after component."""
    for dtype in ("float32", "float64"):
        arguments = layouts.component_arrays(pairs.astype(dtype))
        program = layouts.by_components(jaxbe.overlap)
        name = "jaxbe.overlap, components"
        yield jax_program(name, dtype, program, arguments, overlap, pairs.size)


@functools.cache
def _method(name: str) -> Callable[..., jax.Array]:
    return functools.partial(jaxbe.overlap, method=name)


class Adapter(NamedTuple):
    """How to get a system's peers.

    Attributes:
        peers: the function above.
        package: whose version is reported.
        pairs: at most so many are timed: what takes long gets fewer.
    """

    peers: Callable[[scenes.Scene, Path], Iterator[Peer]]
    package: str
    pairs: int = 20_000


ADAPTERS: dict[str, Adapter] = {
    "ellipsoid-tree": Adapter(ellipsoid_tree_core, "ellipsoid-tree"),
    "coal": Adapter(coal, "coal"),
    "python-fcl": Adapter(python_fcl, "python-fcl"),
    "MuJoCo": Adapter(mujoco_c, "mujoco", 5000),
    "mujoco-warp": Adapter(mujoco_warp, "mujoco-warp", 2000),
    "naive JAX": Adapter(naive_jax, "jax", 200_000),
    "qpax": Adapter(qpax, "qpax", 2000),
}


def version(package: str) -> str:
    """Of an installed package."""
    return importlib.metadata.version(package)
