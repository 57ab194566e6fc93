"""A hand-written C loop for the exact test, built with the system's compiler.

The yardstick of `benchmarks.against_c`: `c_loop.c`, vectorised by the compiler and
shared among threads by OpenMP, called through ctypes.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

COMPILERS = ("cc", "gcc", "clang")
SOURCE = Path(__file__).with_name("c_loop.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp", "-fPIC")

Loop = Callable[[Sequence[np.ndarray], int], np.ndarray]
"""A function of component arrays (see `benchmarks.layouts`), contiguous and of float32,
and of a number of threads: uint8 verdicts (n,)."""


class BuildError(RuntimeError):
    """No compiler, or one that cannot build the loop; the message says which."""


def compiler(names: Sequence[str] = COMPILERS) -> str:
    """The path of the first compiler there is.

    Raises:
        BuildError: there is none.
    """
    for name in names:
        if path := shutil.which(name):
            return path
    raise BuildError(f"no compiler: none of {', '.join(names)} is on the path")


def version(path: str) -> str:
    """The first line of what a compiler says of itself."""
    done = subprocess.run([path, "--version"], capture_output=True, text=True)
    return done.stdout.partition("\n")[0]


def shared_library(
    source: Path, folder: Path, flags: Sequence[str], with_compiler: str
) -> ctypes.CDLL:
    """Compiles one file and loads it.

    In two steps: to link with -ffast-math would make the library flush denormal
    numbers to zero in the whole process.

    Raises:
        BuildError: the compiler fails.
    """
    unit, library = folder / f"{source.stem}.o", folder / f"{source.stem}.so"
    openmp = [flag for flag in flags if flag == "-fopenmp"]
    run([with_compiler, *flags, "-c", str(source), "-o", str(unit)])
    run([with_compiler, "-shared", *openmp, str(unit), "-o", str(library)])
    return ctypes.CDLL(str(library))


def run(command: Sequence[str]) -> None:
    """Runs a compiler; its complaint is the error's message."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise BuildError(f"{Path(command[0]).name} failed: {last}")


def build(folder: Path) -> Loop:
    """Builds the loop in a folder.

    Raises:
        BuildError: no compiler, or one that fails.
    """
    # Idle threads that spin would take cores from what runs next.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    library = shared_library(SOURCE, folder, FLAGS, compiler())
    pointers = [ctypes.c_void_p] * 7
    library.overlaps.argtypes = [ctypes.c_ssize_t, ctypes.c_int, *pointers]
    library.overlaps.restype = None

    def loop(arrays: Sequence[np.ndarray], threads: int) -> np.ndarray:
        n = arrays[0].shape[-1]
        out = np.empty(n, np.uint8)
        addresses = [x.ctypes.data for x in (*arrays, out)]
        library.overlaps(n, threads, *addresses)
        return out

    return loop
