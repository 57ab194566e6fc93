"""MuJoCo's warnings on standard error."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import mujoco


@contextlib.contextmanager
def warnings_to(tell: Callable[[str], None]) -> Iterator[None]:
    """Hands MuJoCo's warnings over; else it appends them to ./MUJOCO_LOG.TXT.

    Args:
        tell: called with each, in the thread that warns.
    """
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(tell)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
