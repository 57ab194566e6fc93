"""The scene: a MuJoCo model and its box-ellipsoid pairs."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import mujoco

from jaxbe.cli.errors import InputError
from jaxbe.mjx import Pairs, find_pairs
from jaxbe.mjx.pairs import geom_names


def load(path: Path) -> Any:
    """Loads a model.

    Raises:
        InputError: the file is missing or not a model; with MuJoCo's message.
    """
    if not path.is_file():
        raise InputError(f"no such file: {path}")
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path} is not a MuJoCo model: {error}") from None


def pairs_of(model: Any, geoms: list[str] | None) -> Pairs:
    """The pairs to test.

    Raises:
        InputError: there are none, or a name is unknown.
    """
    try:
        with warnings.catch_warnings():
            # Here it is an error.
            warnings.simplefilter("ignore", UserWarning)
            pairs = find_pairs(model, geoms)
    except ValueError as error:
        raise InputError(error) from None
    if not len(pairs):
        of_these = f" with {', '.join(geoms)}" if geoms else ""
        raise InputError(
            f"the scene has no box-ellipsoid pair{of_these} that may collide"
        )
    return pairs


def labels(model: Any) -> list[str]:
    """A name for every geom: its own, or that of its body and its id."""
    return [
        name or f"{model.body(body).name}/geom{i}"
        for i, (name, body) in enumerate(
            zip(geom_names(model), model.geom_bodyid, strict=True)
        )
    ]
