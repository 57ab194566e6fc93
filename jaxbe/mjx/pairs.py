"""Which ellipsoids and boxes of a model may collide."""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxbe.mjx.geom_types import BOX, ELLIPSOID, counts
from jaxbe.mjx.given import check_model
from jaxbe.mjx.warn import warn_caller

Ids = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]

AT_ONCE = 1 << 18
"""Pairs that the rules are applied to at once: what they need fits a cache."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pairs:
    """The ellipsoid-box pairs of a model, chosen once and static under `jit`.

    Attributes:
        geom: (P, 2) geom ids in MJX's order, [ellipsoid, box]. Read-only; those of
            `find_pairs` are sorted by ellipsoid, then box, no pair twice.
        explicit: (n, 2), for each `<pair>` element of the model that names one of
            them: the pair's row in `geom`, and the element's id. Read-only.

    Raises:
        TypeError: ids that are not integers.
        ValueError: negative ids, or another shape.
    """

    geom: Ids
    explicit: Ids = dataclasses.field(default_factory=lambda: np.zeros((0, 2), int))

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            ids = _as_ids(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, ids)

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

    Warns if there is no pair, and says what geoms there are: without pairs nothing is
    ever near. Only where `only_enabled` finds contacts disabled that is an answer.

    Args:
        model: a `mujoco.MjModel` or an `mjx.Model`.
        geoms: names or ids of geoms of any type; keeps the pairs in which at
            least one of them takes part. All pairs if None.
        only_enabled: find no pairs in a model that disables contacts or constraints.

    Raises:
        TypeError: what is not a model; `geoms` that is not several, or has what is
            neither a name nor an integer.
        ValueError: `geoms` has a name or an id that the model has not.
    """
    check_model(model, "geom_type", "geom_contype")
    chosen = _chosen(model, geoms)
    if only_enabled and _is_disabled(model, "CONTACT", "CONSTRAINT"):
        return Pairs(np.zeros((0, 2), int))
    elements, ids = _explicit(model)
    pairs = _pairs(model, chosen, elements)
    if not len(pairs):
        _warn_of_none(model, None if geoms is None else chosen)
    wanted = chosen[elements].any(axis=1)
    rows = _rows(pairs, elements[wanted], model.ngeom)
    return Pairs(pairs, np.stack([rows, ids[wanted]], axis=1))


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


def _as_ids(name: str, given: Any) -> Ids:
    ids = np.asarray(given)
    if ids.dtype.kind not in "iu":
        raise TypeError(f"Pairs: {name} must be of integer ids, got {ids.dtype}")
    if ids.ndim != 2 or ids.shape[1] != 2:
        raise ValueError(f"Pairs: {name} must have shape (P, 2), got {ids.shape}")
    if ids.min(initial=0) < 0:
        raise ValueError(f"Pairs: {name} ids must not be negative, got {ids.min()}")
    # What can still be written to belongs to somebody else.
    ids = ids.copy() if ids.flags.writeable else ids
    ids.flags.writeable = False
    return ids


def _pairs(model: Any, chosen: Mask, elements: Ids) -> Ids:
    """The pairs (P, 2) that may collide, a portion of the ellipsoids at a time."""
    types = np.asarray(model.geom_type)
    ellipsoid, box = np.flatnonzero(types == ELLIPSOID), np.flatnonzero(types == BOX)
    portion = max(1, AT_ONCE // max(1, len(box)))
    found = [
        _pairs_of(model, ellipsoid[i : i + portion], box, chosen, elements)
        for i in range(0, len(ellipsoid), portion)
    ]
    pairs = np.concatenate([np.zeros((0, 2), int), *found])
    pairs.flags.writeable = False
    return pairs


def _pairs_of(model: Any, ellipsoid: Ids, box: Ids, chosen: Mask, elements: Ids) -> Ids:
    """Those of some ellipsoids (n,) with the boxes (m,), both sorted."""
    allowed = _may_collide(model, ellipsoid[:, None], box)
    explicit = elements[np.isin(elements[:, 0], ellipsoid)]
    rows, columns = (
        np.searchsorted(x, y) for x, y in zip((ellipsoid, box), explicit.T, strict=True)
    )
    allowed[rows, columns] = True
    rows, columns = np.nonzero(allowed & (chosen[ellipsoid, None] | chosen[box]))
    return np.stack([ellipsoid[rows], box[columns]], axis=1)


def _rows(pairs: Ids, elements: Ids, ngeom: int) -> Ids:
    """Where the elements (n, 2) are among the pairs (P, 2), which are sorted."""
    if not len(elements):
        return np.zeros(0, int)
    first, second = pairs.T
    key = first * ngeom + second
    return np.searchsorted(key, elements[:, 0] * ngeom + elements[:, 1])


def _warn_of_none(model: Any, chosen: Mask | None) -> None:
    of_them = ""
    if chosen is not None:
        some = np.asarray(model.geom_type)[chosen]
        of_them = f" with one of the {len(some)} chosen (they are {counts(some)})"
    warn_caller(
        f"find_pairs: the model has no ellipsoid-box pair{of_them} that may collide, "
        f"nothing will ever be near: it has {counts(model.geom_type)}, and only boxes "
        "against ellipsoids take part, if contype, conaffinity, <exclude> and their "
        "bodies allow it"
    )


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


def _chosen(model: Any, geoms: Iterable[str | int] | None) -> Mask:
    """Which geoms are wanted, (ngeom,)."""
    if geoms is None:
        return np.ones(int(model.ngeom), bool)
    chosen = np.zeros(int(model.ngeom), bool)
    chosen[_geom_ids(model, geoms)] = True
    return chosen


def _geom_ids(model: Any, geoms: Iterable[str | int]) -> list[int]:
    if isinstance(geoms, str | bytes) or not isinstance(geoms, Iterable):
        raise TypeError(f"geoms must be a list of names or ids, got {geoms!r}")
    ids = {name: i for i, name in enumerate(geom_names(model)) if name}
    return [_geom_id(geom, ids, int(model.ngeom)) for geom in geoms]


def _geom_id(geom: str | int, ids: dict[str, int], ngeom: int) -> int:
    if isinstance(geom, str):
        if geom not in ids:
            raise ValueError(f"geoms: the model has no geom named {geom!r}")
        return ids[geom]
    number = _integer(geom)
    if not 0 <= number < ngeom:
        raise ValueError(f"geoms: ids must be from 0 to {ngeom - 1}, got {number}")
    return number


def _integer(geom: Any) -> int:
    """A bool would be an integer for Python; it comes of a mask."""
    try:
        if isinstance(geom, bool | np.bool_):
            raise TypeError
        return operator.index(geom)
    except TypeError:
        raise TypeError(f"geoms must be names or integer ids, got {geom!r}") from None
