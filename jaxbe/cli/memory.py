"""Is there room for a batch?"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import jax

from jaxbe.cli.errors import InputError

BYTES_PER_PAIR = 400
"""Of each pair in each state of a batch, about."""


@contextlib.contextmanager
def room_for(batch: int, pairs_or_geoms: int) -> Iterator[None]:
    """Refuses a batch that this machine has no memory for, before or when it fails.

    Before, where it is known: systems that promise more than they have end the process.

    Raises:
        InputError: too large, with what to do.
    """
    needed, there = BYTES_PER_PAIR * batch * pairs_or_geoms, _memory()
    if there is not None and needed > there:
        raise _too_large(batch, f"some {needed / 1e9:.0f} GB")
    try:
        yield
    except MemoryError:
        raise _too_large(batch, "more than there is") from None
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise _too_large(batch, "more than there is") from None


def _too_large(batch: int, needed: str) -> InputError:
    return InputError(
        f"{batch:,} states at a time take {needed} of memory: give a smaller --batch"
    )


def _memory() -> int | None:
    """Bytes of this machine, None where it does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None
