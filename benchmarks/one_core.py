"""Runs a benchmark again in a child process that has one core.

XLA reads its flags once, when it starts.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence

from benchmarks.margin_one_core import pin_to_one_core
from benchmarks.margin_speed import ONE_CORE_FLAGS

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Else NumPy's linear algebra starts a thread for each core there is, and they wait."""

CHILD = "JAXBE_BENCHMARK_ON_ONE_CORE"


def done_by_child(module: str, arguments: Sequence[str] | None) -> bool:
    """Whether a child did the work; in the child it pins the process and says no.

    Args:
        module: what `python -m` runs.
        arguments: those of its `main`; None are the command line's.
    """
    if CHILD in os.environ:
        pin_to_one_core()
        return False
    given = sys.argv[1:] if arguments is None else list(arguments)
    flags = " ".join((os.environ.get("XLA_FLAGS", ""), *ONE_CORE_FLAGS)).strip()
    environment = os.environ | ONE_THREAD | {"XLA_FLAGS": flags, CHILD: "1"}
    environment["JAX_PLATFORMS"] = "cpu"
    command = [sys.executable, "-m", module, *given]
    subprocess.run(command, env=environment, check=True)
    return True
