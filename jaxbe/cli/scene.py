"""The scene: a MuJoCo model and its box-ellipsoid pairs."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from jaxbe.cli.errors import InputError
from jaxbe.cli.files import check_is_file
from jaxbe.cli.shown import shown
from jaxbe.mjx import Pairs, find_pairs
from jaxbe.mjx.pairs import geom_names, names_at


def load(path: Path) -> Any:
    """Loads a model.

    Raises:
        InputError: the file is missing or not a model; with MuJoCo's message.
    """
    check_is_file(path)
    try:
        # As bytes: the name of a file need not be UTF-8.
        return mujoco.MjModel.from_xml_path(os.fsencode(path))
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(
            f"{shown(path)} is not a MuJoCo model: {_message(error)}"
        ) from None


def _message(error: Exception) -> str:
    """What MuJoCo says, which quotes the file and so need not be UTF-8."""
    if isinstance(error, UnicodeDecodeError):
        return error.object.decode(errors="surrogateescape")
    return str(error)


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
        of_these = f" with {', '.join(map(shown, geoms))}" if geoms else ""
        raise InputError(
            f"the scene has no box-ellipsoid pair{of_these} that may collide"
        )
    return pairs


def check_sizes(model: Any, pairs: Pairs, dtype: str) -> None:
    """Checks that the bodies have sizes in the dtype; MuJoCo lets them be infinite.

    Raises:
        InputError: a size that overflows, or a semi-axis that is lost.
    """
    smallest = np.array([np.finfo(dtype).tiny, 0])  # A box may be a plate.
    sizes = model.geom_size[pairs.geom].astype(float)
    largest = float(np.finfo(dtype).max)
    fits = (sizes >= smallest[:, None]) & (sizes <= largest)
    for pair, body in np.argwhere(~fits.all(axis=2))[:1]:
        geom = pairs.geom[pair, body]
        raise InputError(
            f"{shown(labels(model)[geom])}: size {sizes[pair, body].tolist()} m is "
            f"beyond {dtype}"
        )


def labels(model: Any) -> list[str]:
    """A name for every geom: its own, or that of its body and its id."""
    bodies = names_at(model, model.name_bodyadr)
    return [
        name or f"{bodies[body]}/geom{i}"
        for i, (name, body) in enumerate(
            zip(geom_names(model), model.geom_bodyid, strict=True)
        )
    ]
