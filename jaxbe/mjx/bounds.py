"""Lower bounds of the distances of a model's pairs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbe import _xla
from jaxbe.lower_bound import distance_lower_bound
from jaxbe.mjx.gather import bodies
from jaxbe.mjx.pairs import Ids, Mask, Pairs
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Scalars
from jaxbe.validate import is_readable

Query = Callable[[Box, Ellipsoid], Scalars]


def pair_distances(pairs: Pairs, model: Any, data: Any, steps: int) -> Scalars:
    """The certified lower bounds, (..., P); spheres take no steps."""
    spheres = _are_spheres(pairs, model)
    if not steps or spheres.all():
        return of_pairs(_bound(0), pairs.geom, model, data)
    if not spheres.any():
        return of_pairs(_bound(steps), pairs.geom, model, data)
    exact = of_pairs(_bound(0), pairs.geom[spheres], model, data)
    others = of_pairs(_bound(steps), pairs.geom[~spheres], model, data)
    # Back in the order of the pairs.
    order = np.argsort(np.argsort(~spheres, kind="stable"))
    return jnp.concatenate([exact, others], axis=-1)[..., order]


def of_pairs(query: Query, geom: Ids, model: Any, data: Any) -> Scalars:
    """What a query says of the pairs (P, 2) of ids: (..., P).

    As a choice from every ellipsoid against every box, see `_xla.MAX_TABLE_RATIO`.
    """
    ellipsoids, row = np.unique(geom[:, 0], return_inverse=True)
    boxes, column = np.unique(geom[:, 1], return_inverse=True)
    if len(ellipsoids) * len(boxes) > _xla.MAX_TABLE_RATIO * len(geom):
        box, ellipsoid = bodies(geom[:, 0], geom[:, 1], model, data)
        found = query(box, ellipsoid)
        return _xla.cut(found, box.center[..., 0])
    table = query(*bodies(ellipsoids[:, None], boxes[None, :], model, data))
    # No -1: there may be no state at all.
    flat = table.reshape(*table.shape[:-2], len(ellipsoids) * len(boxes))
    return flat[..., row * len(boxes) + column]


def _bound(steps: int) -> Query:
    return lambda box, ellipsoid: distance_lower_bound(box, ellipsoid, steps)


def _are_spheres(pairs: Pairs, model: Any) -> Mask:
    """Which pairs are known to have an ellipsoid of equal semi-axes, (P,)."""
    if not is_readable(model.geom_size) or model.geom_size.ndim != 2:
        return np.zeros(len(pairs), bool)
    a = np.asarray(model.geom_size)[pairs.geom[:, 0]]
    return np.asarray((a == a[:, :1]).all(axis=1))
