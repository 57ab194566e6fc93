"""python examples/2_packing.py  # this file is imported, not run.

Fruit in a crate: its loss, and the proofs of what `jaxbe` does not answer. An
ellipsoid is in the crate if and only if its extents along the crate's axes are. Two
ellipsoids are apart if and only if some n has n.(c1 - c2) > s1(n) + s2(n), for their
support functions s(n) = sqrt(n^T S n), S = R diag(a^2) R^T; any n found proves it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from crate import Instance
from placing import PROVED, Pose, against, all_separated, ellipsoid_at

import jaxbe

DIRECTION_STEPS = 4
"""Of the search for n: enough for proofs; any number is on the safe side."""

MARGIN = functools.partial(jaxbe.margin, steps=3)
"""The room to the boxes; `benchmarks.placement` puts others in its place."""

Six = tuple[jax.Array, ...]
"""The entries xx, yy, zz, xy, xz, yz of symmetric matrices."""


def loss(
    pose: Pose,
    task: Instance,
    wanted: float,
    room: Callable[..., jax.Array] = MARGIN,
) -> jax.Array:
    """What is missing of the margins wanted: a sum over all fruit (N,)."""
    fruit = ellipsoid_at(pose, task.semi_axes)
    to_boxes = room(task.box, against(fruit))
    S = shape(fruit)
    to_walls = (task.crate - abs(fruit.center)) / jnp.sqrt(
        jnp.stack(S[:3], axis=-1)
    ) - 1
    to_others, _ = growth(fruit.center, S)
    missing = [jnp.square(jax.nn.relu(wanted - m)).sum() for m in (to_boxes, to_walls)]
    # Each pair is seen from both ends, and moved from one of them at a time.
    return (
        missing[0] + missing[1] + jnp.square(jax.nn.relu(wanted + 1 - to_others)).sum()
    )


def shape(fruit: jaxbe.Ellipsoid) -> Six:
    """S of ellipsoids (N,)."""
    L = fruit.axes * fruit.semi_axes[..., None, :]
    entries = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return tuple(jnp.sum(L[..., i, :] * L[..., j, :], axis=-1) for i, j in entries)


def growth(center: jax.Array, S: Six) -> tuple[jax.Array, Six]:
    """The growth distances (N, N) of ellipsoids, infinite to themselves, and the n.

    A lower bound, exact to 1e-4 or so: n is held (envelope theorem), and comes from
    fixed steps of n = (S1/s1 + S2/s2)^-1 (c1 - c2), where the best n is at rest.
    The derivative is with respect to the first of both only.
    """
    rows = [*(center[:, i] for i in range(3)), *S]
    first = [x[:, None] for x in rows]
    second = [jax.lax.stop_gradient(x)[None, :] for x in rows]
    d, S1, S2 = [first[i] - second[i] for i in range(3)], first[3:], second[3:]
    held = jax.lax.stop_gradient((d, S1, S2))
    n = direction(*held)
    s = jnp.sqrt(quadratic(S1, n)) + jnp.sqrt(quadratic(S2, n))
    alpha = sum(n[i] * d[i] for i in range(3)) / s
    return jnp.where(jnp.eye(len(center), dtype=bool), jnp.inf, alpha), n


def direction(d: Any, S1: Any, S2: Any) -> Any:
    """An n that (nearly) tells ellipsoids apart as far as any."""
    weight = 0.5
    for _ in range(DIRECTION_STEPS):
        mixed = [weight * p + (1 - weight) * q for p, q in zip(S1, S2, strict=True)]
        n = solve(mixed, d)
        s1, s2 = jnp.sqrt(quadratic(S1, n)), jnp.sqrt(quadratic(S2, n))
        weight = s2 / jnp.maximum(s1 + s2, 1e-30)
    return n


def quadratic(S: Any, n: Any) -> jax.Array:
    """n^T S n; kept from zero, where the root has no derivative."""
    xx, yy, zz, xy, xz, yz = S
    x, y, z = n
    twice = 2 * (xy * x * y + xz * x * z + yz * y * z)
    return jnp.maximum(xx * x * x + yy * y * y + zz * z * z + twice, 1e-30)


def solve(S: Any, d: Any) -> Any:
    """S^-1 d, but for a positive factor of the size of S."""
    xx, yy, zz, xy, xz, yz = S
    adjugate = (
        (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy),
        (xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz),
        (xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy),
    )
    size = (xx + yy + zz) ** 2
    return [sum(row[i] * d[i] for i in range(3)) / size for row in adjugate]


@jax.jit
def directions(fruit: jaxbe.Ellipsoid) -> jax.Array:
    """The n of all pairs, (N, N, 3)."""
    return jnp.stack(growth(fruit.center, shape(fruit))[1], axis=-1)


def proved(fruit: jaxbe.Ellipsoid, task: Instance) -> bool:
    """Whether all fruit (N,) are in the crate, apart from the boxes and each other.

    For the very floats given: float64 sums of them that exceed zero by more than their
    rounding, and `jaxbe.certify`.
    """
    K, V, a = (np.asarray(x, np.float64) for x in fruit.fields().values())
    reach = np.linalg.norm(V * a[:, None, :], axis=-1)
    room = np.asarray(task.crate, np.float64) - abs(K) - reach
    n = np.asarray(directions(fruit), np.float64)
    gap = np.einsum("ijr,ijr->ij", n, K[:, None] - K[None])
    s = np.linalg.norm(np.einsum("ijr,irp,ip->ijp", n, V, a), axis=-1)
    s += np.linalg.norm(np.einsum("ijr,jrp,jp->ijp", n, V, a), axis=-1)
    doubt = PROVED * (s + abs(n).sum(axis=-1) * abs(K).max())
    others = ~np.eye(len(K), dtype=bool)
    apart = np.all((gap - s > doubt)[others])
    return bool(
        np.all(room > PROVED) and apart and np.all(all_separated(task.box, fruit))
    )
