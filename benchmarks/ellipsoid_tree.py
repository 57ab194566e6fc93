"""The C++ core of ellipsoid-tree, built at run time from its source distribution.

The wheel holds no headers. They come from PyPI's source distribution of the version
that is installed, by `pip download`, and Eigen's from the package cmeel-eigen or from
the system.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import c_loop, reference, scenes

COMPILERS = ("c++", "g++", "clang++")
SOURCE = Path(__file__).with_name("ellipsoid_tree_loop.cpp")
FLAGS = ("-O2", "-march=native", "-DNDEBUG", "-std=c++17", "-fPIC", "-pthread")
"""Of -O2 and -O3, with and without -march=native, the fastest here."""
PACKAGE = "ellipsoid-tree"


def version() -> str:
    """Of the package installed."""
    return importlib.metadata.version(PACKAGE)


@functools.cache
def library(folder: Path) -> ctypes.CDLL:
    """Fetches the headers, builds the loop.

    Raises:
        c_loop.BuildError: no headers, no compiler, or one that fails.
        importlib.metadata.PackageNotFoundError: the package is not installed.
    """
    include = [f"-I{headers(folder)}", f"-I{eigen()}"]
    compiler = c_loop.compiler(COMPILERS)
    built = c_loop.shared_library(SOURCE, folder, (*FLAGS, *include), compiler)
    pointer = ctypes.c_void_p
    built.make.argtypes = [ctypes.c_ssize_t, pointer, pointer, pointer]
    built.make.restype = pointer
    built.overlaps.argtypes, built.overlaps.restype = [pointer, pointer], None
    built.discard.argtypes, built.discard.restype = [pointer], None
    return built


def headers(folder: Path) -> Path:
    """The folder `include` of the source distribution."""
    # fmt: off
    c_loop.run(
        [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps",
         "--no-binary", PACKAGE, "--dest", str(folder), f"{PACKAGE}=={version()}"]
    )
    # fmt: on
    (archive,) = folder.glob("ellipsoid_tree-*.tar.gz")
    with tarfile.open(archive) as source:
        source.extractall(folder, filter="data")
    return folder / archive.name.removesuffix(".tar.gz") / "include"


def eigen() -> Path:
    """The folder of Eigen's headers."""
    packages = [Path(entry) / "cmeel.prefix" for entry in sys.path]
    for prefix in (*packages, Path("/usr"), Path("/usr/local")):
        if (folder := prefix / "include/eigen3").is_dir():
            return folder
    raise c_loop.BuildError("no Eigen: pip install cmeel-eigen")


def loop(pairs: scenes.Scene, folder: Path) -> Callable[[], np.ndarray]:
    """A function that tests all pairs in C++ and gives the verdicts.

    Raises:
        c_loop.BuildError: see `library`.
    """
    built = library(folder)
    k, R = reference.canonical(pairs)
    arrays = k, pairs.e, reference.shape_matrix(R, pairs.a)
    arrays = tuple(np.ascontiguousarray(x, np.float64) for x in arrays)
    out = np.empty(pairs.size, np.uint8)
    objects = _Objects(built, pairs.size, arrays)

    def overlaps() -> np.ndarray:
        built.overlaps(objects.handle, out.ctypes.data)
        return out.astype(bool)

    return overlaps


class _Objects:
    """Owns the pairs on the side of C++."""

    def __init__(
        self, built: ctypes.CDLL, n: int, arrays: tuple[np.ndarray, ...]
    ) -> None:
        self.handle = built.make(n, *(x.ctypes.data for x in arrays))
        self._discard = built.discard

    def __del__(self) -> None:
        self._discard(self.handle)
