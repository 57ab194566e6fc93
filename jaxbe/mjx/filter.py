"""Which pairs may touch? The nearest ones, certified and of a fixed number."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbe.components import with_rank
from jaxbe.lower_bound import MAX_STEPS
from jaxbe.mjx.bounds import pair_distances
from jaxbe.mjx.given import check_given
from jaxbe.mjx.margins import contact_distance
from jaxbe.mjx.pairs import Pairs
from jaxbe.types import ArrayLike, Flags, Scalars
from jaxbe.validate import as_count

DEFAULT_STEPS = 1
MAX_PAIRS = 1 << 24


class Candidates(NamedTuple):
    """The pairs that a filter kept, nearest first by their lower bounds.

    Attributes:
        geom: (..., max_pairs, 2) geom ids, [ellipsoid, box]. Where not `valid` they are
            those of some pair, perhaps one listed already, so that gathering its bodies
            is safe; -1 only in a model without pairs.
        distance: (..., max_pairs) metres: a certified lower bound of the signed
            distance, rounding included. NaN for poses that are NaN, which come first;
            infinity where not `valid`.
        valid: (..., max_pairs), which entries are filled.
        overflow: (...), how many of the pairs to keep had no place left. They are no
            nearer than `distance[..., -1]`, the largest lower bound of those kept: the
            smaller of that and the smallest exact distance of those kept is a lower
            bound of the nearest distance, whatever overflows. The exact one alone can
            be too large, where the bound of an overlapping pair is too deep: in 4,000
            states of the scene shipped with jaxbe 21 times with one place, once with
            two, never with three. What needs every pair, a sum or a count, lacks them.
    """

    geom: jax.Array
    distance: Scalars
    valid: Flags
    overflow: jax.Array


def filter_contacts(
    pairs: Pairs,
    model: Any,
    data: Any,
    *,
    distance: ArrayLike = None,
    max_pairs: int | None = None,
    steps: int = DEFAULT_STEPS,
    mask: ArrayLike = None,
) -> Candidates:
    """Keeps every pair that is nearer than a distance, and few others.

    A pair is dropped only if a direction proves, rounding included, that the very
    poses and sizes given are further apart (see `jaxbe.lower_bound`), with axes that
    have drifted from orthonormal, too; or if more pairs are kept than fit, which
    `overflow` says: then those with the largest lower bounds go. A pair that cannot be
    decided, because a number is NaN or infinite, is kept. So ask `~(distance >= 0)`
    whether one may touch, not `distance < 0`, which NaN is not.

    Args:
        pairs: from `find_pairs`, of the same model.
        model: as for `gather`; without `distance` it has the geoms' margins too.
            Ellipsoids whose semi-axes are equal take a shorter way if the sizes are
            known when this is traced: not batched, nor arguments of `jit`.
        data: as for `gather`. After a step MuJoCo's poses are those before the joints
            moved: `mjx.kinematics` brings them up to date.
        distance: metres, a number or an array that broadcasts to (..., P). By default
            that at which MuJoCo's C engine makes a contact: margin plus gap of the
            `<pair>`, else of both geoms; the margin of the model where it overrides
            theirs. Before 3.5.0, where the larger of two margins counted and not their
            sum, and 3.9.0, where the gap was part of the margin, that is more than
            needed.
        max_pairs: how many candidates to return; all pairs if None.
        steps: 0 to 24, evaluations of the kernel. At distance 0 one step keeps no more
            than it must but for rounding; no step 3 % more in the scene shipped with
            jaxbe, and many more where pairs nearly touch (`benchmarks.filter`).
        mask: bools that broadcast to (..., P), in the order of `pairs`: False drops a
            pair, for obstacles that come and go.

    Returns:
        Candidates, with the batch axes of the poses and sizes. Derivatives of
        `distance` are those of the distance along the direction found.

    Raises:
        TypeError: poses that are not float32 or float64, a distance that is not of
            real numbers, a mask that is not of bools,
            `steps` or `max_pairs` that are not Python integers; what is not a model,
            its data or pairs.
        ValueError: shapes that do not fit together, counts out of range, and as
            `gather`: pairs of another model, poses that were never computed.
    """
    if not isinstance(pairs, Pairs):
        raise TypeError(f"pairs must be from find_pairs, got {type(pairs).__name__}")
    check_given(pairs, model, data)
    steps = as_count("steps", steps, 0, MAX_STEPS)
    count = len(pairs)
    if max_pairs is not None:
        count = as_count("max_pairs", max_pairs, 1, MAX_PAIRS)
    bound = contact_distance(pairs, model) if distance is None else distance
    found = pair_distances(pairs, model, data, steps)
    bound = _broadcast("distance", _as_metres(bound, found.dtype), found)
    kept = ~(found > bound)
    if mask is not None:
        kept = kept & _as_mask(mask, found)
    return nearest_candidates(pairs, found, kept, count)


def _as_metres(given: ArrayLike, dtype: Any) -> jax.Array:
    bound = jnp.asarray(given)
    if bound.dtype == bool or jnp.iscomplexobj(bound):
        raise TypeError(f"distance must be of real numbers, got {bound.dtype}")
    return bound.astype(dtype)


def _as_mask(given: ArrayLike, found: Scalars) -> Flags:
    mask = jnp.asarray(given)
    if mask.dtype != bool:
        raise TypeError(f"mask must be of bools, got {mask.dtype}")
    return _broadcast("mask", mask, found)


def _broadcast(name: str, x: jax.Array, found: Scalars) -> jax.Array:
    """With as many axes as (..., P) has."""
    try:
        if lax.broadcast_shapes(x.shape, found.shape) == found.shape:
            return with_rank(x, found.ndim)
    except ValueError:
        pass
    raise ValueError(
        f"{name} must broadcast to {found.shape}, the batch axes and the pairs, "
        f"got {x.shape}"
    )


def nearest_candidates(
    pairs: Pairs, found: Scalars, kept: Flags, count: int
) -> Candidates:
    """The nearest of those kept, in a fixed number of places."""
    # One more than wanted: choosing some is faster than sorting all.
    missing = max(0, count + 1 - len(pairs))
    last = pairs.geom[-1:] if len(pairs) else np.full((1, 2), -1)
    geom = np.concatenate([pairs.geom, np.repeat(last, missing, axis=0)])
    places = [(0, 0)] * (found.ndim - 1) + [(0, missing)]
    found, kept = jnp.pad(found, places), jnp.pad(kept, places)
    # What cannot be decided comes first: it may be the nearest.
    order = jnp.where(jnp.isnan(found), -jnp.inf, lax.stop_gradient(found))
    _, index = lax.top_k(jnp.where(kept, -order, -jnp.inf), count)
    valid = jnp.take_along_axis(kept, index, axis=-1)
    distance = jnp.take_along_axis(found, index, axis=-1)
    # As an array over the batch, or JAX could not say along which axis of a mesh it is.
    ids = with_rank(jnp.asarray(geom), kept.ndim + 1)
    ids = ids + 0 * jnp.expand_dims(kept, -1).astype(ids.dtype)
    return Candidates(
        geom=jnp.take_along_axis(ids, jnp.expand_dims(index, -1), axis=-2),
        distance=jnp.where(valid, distance, jnp.inf),
        valid=valid,
        overflow=jnp.maximum(jnp.sum(kept, axis=-1, dtype=jnp.int32) - count, 0),
    )
