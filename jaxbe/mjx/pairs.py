"""Which ellipsoids and boxes of a model may collide."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

ELLIPSOID = 4
"""`mujoco.mjtGeom.mjGEOM_ELLIPSOID`."""

BOX = 6
"""`mujoco.mjtGeom.mjGEOM_BOX`."""

Ids = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class Pairs:
    """The ellipsoid-box pairs of a model, chosen once and static under `jit`.

    Attributes:
        geom: (P, 2) geom ids in MJX's order, [ellipsoid, box]. Read-only, sorted
            by ellipsoid, then box; no pair twice.
        explicit: (n, 2), for each `<pair>` element of the model that names one of
            them: the pair's row in `geom`, and the element's id. Read-only.
    """

    geom: Ids
    explicit: Ids = dataclasses.field(default_factory=lambda: np.zeros((0, 2), int))

    def __post_init__(self) -> None:
        self.geom.flags.writeable = False
        self.explicit.flags.writeable = False

    def __len__(self) -> int:
        return len(self.geom)


def find_pairs(
    model: Any,
    geoms: Iterable[str | int] | None = None,
    *,
    only_enabled: bool = False,
) -> Pairs:
    """Finds the ellipsoid-box pairs that a model lets collide.

    The rules are MuJoCo's, as MJX applies them: contype and conaffinity,
    `<exclude>`, bodies welded together, parent and child (unless the model
    disables that filter), and `<pair>`, which overrules all of them. As in MJX
    the flags that disable contacts or constraints do not matter unless asked for:
    they are about the simulation, not about the geometry.

    Args:
        model: a `mujoco.MjModel` or an `mjx.Model`.
        geoms: names or ids of geoms of any type; keeps the pairs in which at
            least one of them takes part. All pairs if None.
        only_enabled: find no pairs in a model that disables contacts or constraints.

    Raises:
        TypeError: `geoms` is one string instead of several.
        ValueError: `geoms` has a name or an id that the model has not.
    """
    chosen = range(model.ngeom) if geoms is None else _geom_ids(model, geoms)
    if only_enabled and _is_disabled(model, "CONTACT", "CONSTRAINT"):
        return Pairs(np.zeros((0, 2), int))
    types = np.asarray(model.geom_type)
    ellipsoid, box = np.flatnonzero(types == ELLIPSOID), np.flatnonzero(types == BOX)
    allowed = np.argwhere(_may_collide(model, ellipsoid[:, None], box[None, :]))
    by_filters = np.stack([ellipsoid[allowed[:, 0]], box[allowed[:, 1]]], axis=1)
    elements, ids = _explicit(model)
    pairs, rows = np.unique(
        np.concatenate([by_filters, elements]), axis=0, return_inverse=True
    )
    rows = rows.reshape(-1)[len(by_filters) :]
    wanted = np.asarray(np.isin(pairs, chosen).any(axis=1))
    explicit = np.stack([np.cumsum(wanted)[rows] - 1, ids], axis=1)
    return Pairs(pairs[wanted], explicit[wanted[rows]])


def geom_names(model: Any) -> list[str]:
    """The name of every geom, empty where it has none; see `names_at`."""
    return names_at(model, model.name_geomadr)


def names_at(model: Any, starts: Any) -> list[str]:
    """The names that start at these places of `model.names`.

    MuJoCo takes any bytes. Those that are not UTF-8 become lone surrogates, as Python
    has them in names of files and in `sys.argv`: nothing is lost, no two names become
    one, and what the user types is found.
    """
    names = model.names
    return [
        names[i : names.index(b"\0", i)].decode(errors="surrogateescape")
        for i in np.asarray(starts)
    ]


def _may_collide(model: Any, geom1: Ids, geom2: Ids) -> Mask:
    """The filters for geoms; arrays of ids broadcast."""
    contype, conaffinity = model.geom_contype, model.geom_conaffinity
    match = contype[geom1] & conaffinity[geom2] | contype[geom2] & conaffinity[geom1]
    body1, body2 = model.geom_bodyid[geom1], model.geom_bodyid[geom2]
    return np.asarray((match != 0) & _bodies_may_collide(model, body1, body2))


def _bodies_may_collide(model: Any, body1: Ids, body2: Ids) -> Mask:
    """The filters for bodies; arrays of ids broadcast."""
    # Bodies welded together move as one and have the id of the topmost.
    weld1, weld2 = model.body_weldid[body1], model.body_weldid[body2]
    ok = (weld1 != weld2) & ~_is_excluded(model, body1, body2)
    if _is_disabled(model, "FILTERPARENT"):
        return np.asarray(ok)
    parent1 = model.body_weldid[model.body_parentid[weld1]]
    parent2 = model.body_weldid[model.body_parentid[weld2]]
    is_family = (weld1 == parent2) | (weld2 == parent1)
    # What is welded to the world is nobody's parent: else nothing hits the floor.
    touches_world = (weld1 == 0) | (weld2 == 0)
    return np.asarray(ok & (touches_world | ~is_family))


def _is_disabled(model: Any, *flags: str) -> bool:
    """Whether the model disables one of these."""
    # Where there is a model there is MuJoCo; and bits have moved between versions.
    import mujoco

    bits = (int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")) for flag in flags)
    return any(int(model.opt.disableflags) & bit for bit in bits)


def _is_excluded(model: Any, body1: Ids, body2: Ids) -> Mask:
    """Whether an `<exclude>` names the two bodies."""
    low, high = np.minimum(body1, body2), np.maximum(body1, body2)
    return np.asarray(np.isin((low << 16) + high, model.exclude_signature))


def _explicit(model: Any) -> tuple[Ids, Ids]:
    """The `<pair>` elements of an ellipsoid and a box: (n, 2) geom ids, (n,) theirs."""
    pairs = np.stack([model.pair_geom1, model.pair_geom2], axis=1).astype(np.int64)
    types = np.asarray(model.geom_type)[pairs]
    pairs = np.take_along_axis(pairs, np.argsort(types, axis=1), axis=1)
    ids = np.flatnonzero((np.sort(types, axis=1) == (ELLIPSOID, BOX)).all(axis=1))
    return pairs[ids], ids


def _geom_ids(model: Any, geoms: Iterable[str | int]) -> list[int]:
    if isinstance(geoms, str):
        raise TypeError(f"geoms must be a list of names or ids, got {geoms!r}")
    ids = {name: i for i, name in enumerate(geom_names(model)) if name}
    return [_geom_id(geom, ids, int(model.ngeom)) for geom in geoms]


def _geom_id(geom: str | int, ids: dict[str, int], ngeom: int) -> int:
    if isinstance(geom, str):
        if geom not in ids:
            raise ValueError(f"geoms: the model has no geom named {geom!r}")
        return ids[geom]
    if not 0 <= geom < ngeom:
        raise ValueError(f"geoms: ids must be from 0 to {ngeom - 1}, got {geom}")
    return int(geom)
