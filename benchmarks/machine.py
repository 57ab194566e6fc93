"""What a measurement was taken with: versions and hardware."""

from __future__ import annotations

import os
import platform
import time
from pathlib import Path
from typing import Any

import jax
import jaxlib
import numpy as np

import jaxbe


def describe() -> dict[str, Any]:
    """Versions, JAX's backend and device, the processor, and its cores."""
    return {
        "jaxbe": jaxbe.__version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "numpy": np.__version__,
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 0,
    }


def summary(described: dict[str, Any]) -> str:
    """What `describe` said, in a line."""
    return f"{described['processor']}, {described['cores']} cores, {described['device']}, jax {described['jax']}"  # noqa: E501


def _processor() -> str:
    """The processor's name; `platform` does not know it on Linux."""
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


class OtherLoad:
    """How many cores other processes keep busy; Linux only.

    Timings of a program that uses all cores are no better than what it was left.
    """

    def __init__(self) -> None:
        self._start = self._read()

    def cores(self) -> float:
        """Cores busy with others, on average since construction; 0 if unknown.

        Less one tick of the kernel's clock a core, which is all it can resolve.
        """
        if self._start is None:
            return 0.0
        busy, own, wall = (
            b - a for a, b in zip(self._start, self._read(), strict=True)
        )
        resolution = (os.cpu_count() or 1) / os.sysconf("SC_CLK_TCK")
        return max(0.0, round((busy - own - resolution) / wall, 2))

    def _read(self) -> tuple[float, float, float] | None:
        """Seconds of all cores busy, of this process and its children, of the clock."""
        listing = Path("/proc/stat")
        if not listing.exists():
            return None
        ticks = [int(x) for x in listing.read_text().split(maxsplit=9)[1:9]]
        idle_and_waiting = ticks[3] + ticks[4]
        busy = (sum(ticks) - idle_and_waiting) / os.sysconf("SC_CLK_TCK")
        return busy, sum(os.times()[:4]), time.monotonic()
