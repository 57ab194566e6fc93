"""Compiles for an accelerator that is not there.

jax's compilers for NVIDIA and TPU come from PyPI (extra `compilers`) and take a device
by its description. jax and XLA read their settings when they start: `environment` makes
them, for a process of its own.

What XLA writes for a GPU is read from the text that it hands to NVIDIA's assembler: in
its place stands a script that keeps the text and what the assembler says of it. Other
ways fail with some jax: 0.12 dumps no PTX, 0.6 says nothing of a compiled program.
"""

from __future__ import annotations

import importlib.util
import shlex
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
from jax.experimental import topologies
from jax.sharding import SingleDeviceSharding

from benchmarks import kernels

H100 = """
gpu_device_info {
  cuda_compute_capability { major: 9 }
  threads_per_warp: 32 threads_per_block_limit: 1024 threads_per_core_limit: 2048
  shared_memory_per_block: 49152 shared_memory_per_block_optin: 232448
  shared_memory_per_core: 233472 core_count: 132 fpus_per_core: 128
  block_dim_limit_x: 2147483647 block_dim_limit_y: 65535 block_dim_limit_z: 65535
  registers_per_core_limit: 65536 registers_per_block_limit: 65536
  memory_bandwidth: 3352320000000 l2_cache_size: 52428800 clock_rate_ghz: 1.98
  device_memory_size: 84942979072
}
platform_name: "CUDA"
dnn_version_info { major: 9 minor: 8 }
device_description_str: "NVIDIA H100 80GB HBM3"
"""
"""A `GpuTargetConfigProto` of the fields that every XLA since jax 0.6 knows."""

DEVICES = {"h100": "NVIDIA H100 (SXM)", "v5e": "TPU v5e"}

NAME = "measured"
"""Of the function compiled, in what XLA writes."""

ASSEMBLER = """#!/bin/sh
# In the place of ptxas: keeps what it is given, and what it says of it.
case "$1" in -*) exec {ptxas} "$@" ;; esac
kept=$(mktemp {folder}/{kept}/XXXXXX) && cp "$1" "$kept.ptx"
{ptxas} -v "$@" 2>"$kept.txt"
code=$?
cat "$kept.txt" >&2
exit $code
"""


def missing(device: str) -> str:
    """What is not installed, and how to install it; nothing if all is there."""
    needed = {
        "h100": ("jax_plugins.xla_cuda12", "nvidia.cuda_nvcc"),
        "v5e": ("libtpu",),
    }
    lacking = [name for name in needed[device] if not _folder(name)]
    if not lacking:
        return ""
    return (
        f"no compiler for {device}, {', '.join(lacking)} not found: "
        "pip install '.[compilers]'"
    )


def _folder(package: str) -> str:
    """Where a package lies, which is not imported."""
    try:
        spec = importlib.util.find_spec(package)
    except ModuleNotFoundError:
        return ""
    return next(iter(spec.submodule_search_locations or ()), "") if spec else ""


def environment(device: str, folder: Path) -> dict[str, str]:
    """The variables with which a process must start to compile for the device.

    Args:
        device: a name of DEVICES.
        folder: where what XLA writes goes; it gets a script, too.
    """
    common = {
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_COMPILATION_CACHE": "false",
        "JAX_TRACEBACK_FILTERING": "off",
        "TF_CPP_MIN_LOG_LEVEL": "2",
    }
    if device == "v5e":
        return common | {
            "TPU_SKIP_MDS_QUERY": "1",
            "TPU_ACCELERATOR_TYPE": "v5litepod-4",
            "TPU_WORKER_HOSTNAMES": "localhost",
        }
    _write_assembler(folder)
    dump = f"--xla_dump_to={folder} --xla_dump_hlo_module_re={NAME}"
    return common | {"JAX_SKIP_CUDA_CONSTRAINTS_CHECK": "1", "XLA_FLAGS": dump}


def _write_assembler(folder: Path) -> None:
    toolkit = Path(_folder("nvidia.cuda_nvcc"))
    script = folder / "bin" / "ptxas"
    script.parent.mkdir()
    (folder / kernels.KEPT).mkdir()
    script.write_text(
        ASSEMBLER.format(
            ptxas=shlex.quote(str(toolkit / "bin" / "ptxas")),
            folder=shlex.quote(str(folder)),
            kept=kernels.KEPT,
        )
    )
    script.chmod(0o755)
    (folder / "nvvm").symlink_to(toolkit / "nvvm")


def described(device: str) -> Any:
    """The device, from its description; in a process with its `environment`."""
    if device == "v5e":
        return topologies.get_topology_desc("v5e:2x2", platform="tpu").devices[0]
    # Nothing public makes a plugin known without its device.
    from jax._src import xla_bridge

    xla_bridge.discover_pjrt_plugins()
    topology = topologies.get_topology_desc(
        platform="cuda", topology_name="", topology="1x1x1", target_config=H100
    )
    return topology.devices[0]


def compile_for(
    device: str, folder: Path, function: Callable[..., Any], arguments: Any
) -> Mapping[str, Any]:
    """Compiles a function and reads the program; in a process with its `environment`.

    Args:
        device: a name of DEVICES.
        folder: as for `environment`.
        function: of arrays.
        arguments: a `jax.ShapeDtypeStruct` for each, or trees of them.

    Returns:
        `compile_seconds` and what `kernels` reads of the program.
    """
    place = SingleDeviceSharding(described(device))
    arguments = jax.tree.map(
        lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=place), arguments
    )

    def measured(*given: Any) -> Any:
        return function(*given)

    is_gpu = device == "h100"
    lowered = (
        jax.jit(measured, out_shardings=place)
        .trace(*arguments)
        .lower(lowering_platforms=("cuda" if is_gpu else "tpu",))
    )
    # jax names a folder of its own, whatever XLA_FLAGS say.
    options = {"xla_gpu_cuda_data_dir": str(folder)} if is_gpu else None
    start = time.perf_counter()
    compiled = lowered.compile(compiler_options=options)
    seconds = {"compile_seconds": time.perf_counter() - start}
    if is_gpu:
        return seconds | kernels.of_gpu(compiled, folder, NAME)
    return seconds | kernels.of_tpu(compiled)
