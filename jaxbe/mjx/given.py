"""Whether what is given is a model, its data, and pairs that were found in it."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from jaxbe.mjx.geom_types import BOX, ELLIPSOID, a_geom
from jaxbe.validate import is_readable


def check_given(pairs: Any, model: Any, data: Any) -> None:
    """All that a query of a state gets.

    Raises:
        TypeError: one of them is something else.
        ValueError: the pairs are those of another model.
    """
    check_pairs(pairs, model)
    if not (hasattr(data, "geom_xpos") or hasattr(data, "x")):
        raise TypeError(
            "data must be a mujoco.MjData, an mjx.Data or a Brax pipeline state, "
            f"got {_described(data)}"
        )


def check_model(model: Any, *fields: str) -> None:
    """A model has these fields, whatever else it is.

    Raises:
        TypeError: it has not.
    """
    if not all(hasattr(model, field) for field in fields):
        raise TypeError(
            f"model must be a mujoco.MjModel or an mjx.Model, got {_described(model)}"
        )


def check_pairs(pairs: Any, model: Any) -> None:
    """Whether pairs whose ids are known are the model's, as far as one can tell.

    Raises:
        TypeError: these are no pairs, or that is no model.
        ValueError: the model has no such geoms, or of other types.
    """
    check_model(model, "geom_size")
    geom = getattr(pairs, "geom", None)
    if not hasattr(geom, "shape"):
        raise TypeError(
            f"pairs must be from find_pairs or filter_contacts, got {_described(pairs)}"
        )
    ngeom = model.geom_size.shape[-2]
    if not isinstance(geom, np.ndarray) or not geom.size:
        return
    # JAX would clamp an index that is out of range and answer for another geom.
    if geom.max() >= ngeom:
        raise ValueError(
            f"pairs name geom {geom.max()}, the model has {ngeom} geoms: find them in "
            "this model"
        )
    _check_types(geom, getattr(model, "geom_type", None))


def _check_types(geom: Any, types: Any) -> None:
    if types is None or not is_readable(types) or np.ndim(types) != 1:
        return
    found = np.asarray(types)[geom]
    wrong = (found != (ELLIPSOID, BOX)) & (geom >= 0)
    if wrong.any():
        first = np.argmax(wrong.any(axis=-1))
        ids, kinds = geom.reshape(-1, 2)[first], found.reshape(-1, 2)[first]
        raise ValueError(
            f"pairs name geoms {ids[0]} and {ids[1]} as an ellipsoid and a box, the "
            f"model has {a_geom(kinds[0])} and {a_geom(kinds[1])} there: find them in "
            "this model"
        )


def _described(given: Any) -> str:
    """What it is, and what to do about it."""
    if isinstance(given, str | os.PathLike):
        return f"{os.fspath(given)!r}: load it with mujoco.MjModel.from_xml_path"
    name = "None" if given is None else type(given).__name__
    if hasattr(given, "geom_xpos"):
        return f"{name}, which is data, not a model"
    if hasattr(given, "geom_size"):
        return f"{name}, which is a model, not data"
    return f"{name}: compile it first" if hasattr(given, "compile") else name
