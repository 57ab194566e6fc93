"""The errors that `jaxbe.plan` and its table speak of: what relative to what."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def longest_length(half_extents: Floats, semi_axes: Floats) -> Floats:
    """The longest half extent or semi-axis of each pair: (n,) of (n, 3) each."""
    lengths = np.concatenate([half_extents, semi_axes], axis=1)
    longest: Floats = lengths.astype(np.float64).max(axis=1)
    return longest


def margin_error(found: Any, exact: Floats) -> Floats:
    """Of margins, relative to max(1, growth distance)."""
    return _difference(found, exact) / np.maximum(1, 1 + exact)


def distance_error(found: Any, exact: Floats, longest: Floats) -> Floats:
    """Of signed distances, relative to the longest length or the distance."""
    return _difference(found, exact) / np.maximum(longest, exact)


def gradient_error(found: Any, exact: Floats, longest: Floats) -> Floats:
    """Of gradients by box and ellipsoid, relative to the size of the exact one.

    Args:
        found: a box and an ellipsoid of derivatives.
        exact: as `flat_gradient` has it.
        longest: of each pair.
    """
    lost = _norm(flat_gradient(found, longest) - exact)
    return lost / np.maximum(_norm(exact), 1e-30)


def flat_gradient(gradient: Any, longest: Floats) -> Floats:
    """(n, 30): derivatives in lengths times the longest length of the pair."""
    parts = []
    for body in gradient:
        for name, x in body.fields().items():
            rows = np.asarray(x, np.float64).reshape(len(longest), -1)
            parts.append(rows if name == "axes" else rows * longest[:, None])
    return np.concatenate(parts, axis=1)


def _difference(found: Any, exact: Floats) -> Floats:
    return np.abs(np.asarray(found, np.float64) - exact)


def _norm(x: Floats) -> Floats:
    length: Floats = np.sqrt(np.sum(x * x, axis=1))
    return length
