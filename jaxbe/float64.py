"""Float64 for a while, whatever the user's setting of `jax_enable_x64`."""

from __future__ import annotations

import contextlib
from typing import Any

import jax


def float64_allowed() -> contextlib.AbstractContextManager[Any]:
    """Lets arrays be float64 inside `with`; those that are float32 stay so."""
    if hasattr(jax, "enable_x64"):
        allowed: contextlib.AbstractContextManager[Any] = jax.enable_x64(True)
        return allowed
    import jax.experimental as older

    return older.enable_x64()  # type: ignore[no-any-return, attr-defined]
