"""python examples/5_largest_ellipsoid.py  # this file is imported, not run.

A shelf; a room between flat walls, and by convex optimisation its largest ellipsoid.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from placing import boxes
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, HalfspaceIntersection

import jaxbe

SHELF = boxes(
    (0.0, 0.0, -0.05, 0.5, 0.5, 0.05),
    (0.0, 0.0, 0.65, 0.5, 0.5, 0.05),
    (0.55, 0.0, 0.3, 0.05, 0.5, 0.4),
    (-0.55, 0.0, 0.3, 0.05, 0.5, 0.4),
    (0.0, 0.55, 0.3, 0.6, 0.05, 0.4),
    (0.0, -0.55, 0.3, 0.6, 0.05, 0.4),
    (0.25, 0.2, 0.15, 0.15, 0.2, 0.15, 25),
    (-0.3, -0.25, 0.1, 0.15, 0.15, 0.1, -30),
    (-0.25, 0.3, 0.45, 0.18, 0.12, 0.15, 10),
)


def room(rng: np.random.Generator, walls: int = 10) -> tuple[jaxbe.Box, np.ndarray]:
    """Slabs around a polytope, and its rows (n, h): it is where n.x <= h."""
    spread = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    more = rng.normal(size=(walls - 6, 3))
    n = np.concatenate([spread, -spread, more / np.linalg.norm(more, axis=1)[:, None]])
    h = rng.uniform(0.3, 0.6, walls)
    axes = np.linalg.svd(n[:, None, :])[2].swapaxes(1, 2)[..., ::-1]
    slab = np.broadcast_to(np.float32([2, 2, 0.2]), (walls, 3))
    center = np.float32(n * (h + 0.2)[:, None])
    return jaxbe.Box(center, np.float32(axes), slab), np.column_stack([n, h])


def convex_volume(rows: np.ndarray) -> float:
    """Of the largest ellipsoid {d + L u} in a polytope: log det L is concave."""
    n, h = rows[:, :3], rows[:, 3]
    entries = np.tril_indices(3)

    def factor(x: np.ndarray) -> np.ndarray:
        L = np.zeros((3, 3))
        L[entries] = x[3:]
        return L

    def slack(x: np.ndarray) -> np.ndarray:
        return h - n @ x[:3] - np.linalg.norm(n @ factor(x), axis=1)

    def minus_log(x: np.ndarray) -> float:
        return -np.log(np.maximum(np.diag(factor(x)), 1e-9)).sum()

    start = np.concatenate([np.zeros(3), 0.1 * np.eye(3)[entries]])
    rule = {"type": "ineq", "fun": slack}
    options = {"maxiter": 500, "ftol": 1e-12}
    found = minimize(minus_log, start, constraints=rule, options=options)
    return float(4 / 3 * np.pi * np.exp(-found.fun))


def draw_polytope(axes: Any, rows: np.ndarray) -> None:
    """Its faces and edges."""
    halfspaces = np.column_stack([rows[:, :3], -rows[:, 3]])
    corners = HalfspaceIntersection(halfspaces, np.zeros(3)).intersections
    hull = ConvexHull(corners)
    style = {"color": (0.4, 0.6, 0.8, 0.25), "linewidth": 0}
    axes.plot_trisurf(*corners.T, triangles=hull.simplices, **style)
    for i, a in enumerate(rows):
        for b in rows[:i]:
            on_both = abs(corners @ np.stack([a, b])[:, :3].T - (a[3], b[3])) < 1e-9
            edge = corners[on_both.all(axis=1)]
            axes.plot(*edge.T, color="0.2", lw=0.8)
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.2)
