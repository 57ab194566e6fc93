"""Ellipsoids against boxes in MJX: a switch that a program may turn on and off."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from jaxbe.mjx.driver import register, unregister

_lock = threading.Lock()
_holders: set[object] = set()
"""Who wants the pair at present: `with` blocks, and the switch."""

_switch = object()


@contextlib.contextmanager
def collision_enabled() -> Iterator[None]:
    """Lets MJX collide ellipsoids with boxes inside a `with` block.

    Inside, `mjx.put_model`, `make_data`, `put_data`, `collision` and `step`, and Brax's
    pipelines, accept models in which an ellipsoid and a box may collide; outside they
    raise what they always raise. MJX reads its table of functions when it loads a
    model, makes data, and when JAX traces a step: what was compiled inside runs outside
    too, but JAX traces anew for arguments of other types. Also a decorator.

    Blocks nest: the pair is there until the last one ends, in whatever way. The table
    is one for all threads. A function for the pair that is there already, that of a
    later MJX, say, is left in place, with a warning.

    A pair has one contact, as in MuJoCo C, that of `jaxbe.contact`, in MuJoCo's
    conventions: the distance, negative when they overlap; the point half way between
    the witness points; a frame with the normal from the ellipsoid to the box. It can be
    differentiated, forward and reverse. So can `mjx.step` in forward mode (`jax.jvp`,
    `jax.jacfwd`); in reverse mode (`jax.grad`) only if the model has no constraints
    that MJX solves for, or `<option iterations="1"/>`: the solver's loop is a
    `while_loop`, which JAX cannot run backwards.

    With a mujoco-mjx newer than 3.17, which jaxbe was not tested with, it warns.

    Raises:
        ImportError: there is no mujoco-mjx.
        RuntimeError: its version is older than 3.3.5, or its private table, into
            which the function is put, is not as expected.
    """
    holder = object()
    _hold(holder)
    try:
        yield
    finally:
        _release(holder)


def enable_collision() -> None:
    """`collision_enabled` without a block: from now on, until `disable_collision`.

    A switch, not a counter: turned on twice, it is on.

    Raises:
        ImportError: as `collision_enabled`.
        RuntimeError: as `collision_enabled`.
    """
    _hold(_switch)


def disable_collision() -> None:
    """Turns the switch of `enable_collision` off; fine if it is off.

    Inside a `collision_enabled` block the pair stays until the block ends.
    """
    _release(_switch)


def _hold(holder: object) -> None:
    with _lock:
        register()
        _holders.add(holder)


def _release(holder: object) -> None:
    with _lock:
        if holder not in _holders:
            return
        _holders.remove(holder)
        if not _holders:
            unregister()
