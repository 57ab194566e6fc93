"""Kinds of pairs on which the peers' verdicts are judged.

`touching` makes pairs that touch exactly, in the numbers as floats have them: all are
small multiples of powers of two, all axes are those of the world, permuted and
mirrored. The ellipsoid's surface passes through a point of the box's with a rational
direction in its metric: (1, 0, 0) for a face, (3, 4, 0) / 5 for an edge and
(1, 2, 2) / 3 for a vertex.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from benchmarks import margin_scenes, scenes

DIRECTIONS = {
    "face": ((1, 0, 0), 1),
    "edge": ((3, 4, 0), 5),
    "vertex": ((1, 2, 2), 3),
}
"""What is touched: a direction of integers, and its length."""


def touching(n: int, seed: int, feature: str) -> scenes.Scene:
    """Pairs that touch in one point of a face, an edge or a vertex of the box.

    With an integer direction u of length r and powers of two s, the semi-axes are
    a = r s, and the point of contact is s u from the ellipsoid's centre: the sum of
    (s_i u_i / a_i)^2 is 1 exactly. Along free axes it is anywhere on the feature.
    """
    rng = np.random.default_rng(seed)
    u, r = DIRECTIONS[feature]
    powers = 2.0 ** rng.integers(-4, 5, (n, 3))
    e = rng.integers(1, 65, (n, 3)) / 16
    free = np.array(u) == 0
    # A free coordinate of the point of contact: a multiple of e / 4 inside the box.
    point = np.where(free, e * rng.integers(-3, 4, (n, 3)) / 4, e)
    k = point + powers * np.array(u)
    C = rng.integers(-32, 33, (n, 3)) / 8
    identity = np.broadcast_to(np.eye(3), (n, 3, 3))
    aligned = scenes.Scene(C, identity, e, C + k, identity, r * powers)
    return _turned(aligned, rng)


def _turned(pairs: scenes.Scene, rng: np.random.Generator) -> scenes.Scene:
    """The world's axes permuted and mirrored, those of the bodies relabelled."""
    order = np.argsort(rng.random((pairs.size, 3)), axis=1)
    signs = rng.choice([-1.0, 1.0], size=(pairs.size, 3, 1))
    Q = np.eye(3)[order] * signs
    turned = pairs._replace(
        C=np.einsum("nij,nj->ni", Q, pairs.C), U=Q @ pairs.U,
        K=np.einsum("nij,nj->ni", Q, pairs.K), V=Q @ pairs.V,
    )  # fmt: skip
    return scenes.permuted(turned, seed=int(rng.integers(2**31)))


def near(n: int, seed: int, growth: float) -> scenes.Scene:
    """Random pairs moved to a growth distance within 1 +- growth."""
    wanted = 1 + growth * np.random.default_rng(seed).uniform(-1, 1, n)
    return margin_scenes.near_touching(scenes.random(n, seed), wanted)


def coincident(n: int, seed: int) -> scenes.Scene:
    """Random pairs with one centre."""
    return scenes.coincident(scenes.random(n, seed))


def _random(low: float) -> Callable[[int, int], scenes.Scene]:
    return functools.partial(scenes.random, low=low, high=2.0)


KINDS: dict[str, Callable[[int, int], scenes.Scene]] = {
    "random, aspect to 40": _random(0.05),
    "random, aspect to 1000": _random(2e-3),
    "random, aspect to 1e5": _random(2e-5),
    "needles": margin_scenes.needles,
    "plates": margin_scenes.plates,
    "coincident centres": coincident,
    **{
        f"near touching, {growth:g}": functools.partial(near, growth=growth)
        for growth in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    },
    **{
        f"touching, {feature}": functools.partial(touching, feature=feature)
        for feature in DIRECTIONS
    },
}
"""Scenes by name, functions of the number of pairs and a seed."""
