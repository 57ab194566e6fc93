"""Reads what XLA's compilers write: kernels, instructions, registers, bytes."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

KEPT = "kept"
"""The folder with what NVIDIA's assembler was given and what it said."""

ENDS = (".ptx", ".txt")

FUNCTION = re.compile(
    r"^(?:\.visible\s+|\.weak\s+)?\.(entry|func)\s+(?:\([^)]*\)\s*)?([\w$.]+)", re.M
)
CALL = re.compile(r"(?:@!?\S+\s+)?call(?:\.uni)?\s+(?:\([^)]*\)\s*,\s*)?([\w$.]+)")
LAUNCH = re.compile(
    r"(?:kernel = |\] )([\w$.]+)(?:, launch dimensions = blocks: \{| grid: \[)"
    r"([\d, ]+)[\]}],?\s*threads(?:/block)?: [\[{]([\d, ]+)"
)
"""A line of a listing of thunks, as jax 0.6 and as 0.10 have it."""
THUNK = re.compile(r"^\s*(?:\d+: )?(k(?!CommandBuffer|Sequential)[A-Z]\w*)", re.M)
INSTRUCTION = re.compile(r"^\s*(?:ROOT )?%?([\w.\-]+) = (\(.*?\)|\S+) ([\w\-]+)\((.*)")
ARRAY = re.compile(r"\b(pred|bf16|[sufc]\d+)\[([\d,]*)\]")
PREALLOCATED = re.compile(r"^allocation \d+: size (\d+),.* preallocated-temp", re.M)


class Function(NamedTuple):
    """A kernel or device function in PTX.

    Attributes:
        is_kernel: whether it can be launched.
        instructions: its own, each counted once, in a loop or not.
        calls: the functions called, as often as they are.
    """

    is_kernel: bool
    instructions: int
    calls: list[str]


def ptx_functions(text: str) -> dict[str, Function]:
    """All that a PTX file defines, by name."""
    text = re.sub(r"//[^\n]*", "", text)
    heads = list(FUNCTION.finditer(text))
    ends = [*(head.start() for head in heads), len(text)][1:]
    found = {}
    for head, end in zip(heads, ends, strict=True):
        _, is_defined, body = text[head.end() : end].partition("{")
        if is_defined:
            statements = [s for s in map(_statement, body.split(";")) if s]
            calls = [m[1] for m in map(CALL.match, statements) if m]
            found[head[2]] = Function(head[1] == "entry", len(statements), calls)
    return found


def _statement(text: str) -> str:
    """An instruction without labels and braces before it; nothing for a directive."""
    text = re.sub(r"^(?:\s|[{}]|[$\w]+:)*", "", text)
    return "" if text.startswith(".") else text


def instructions(functions: Mapping[str, Function]) -> dict[str, int]:
    """Those that a thread of each kernel executes, calls followed."""

    @functools.cache
    def total(name: str) -> int:
        if name not in functions:
            return 0
        return functions[name].instructions + sum(map(total, functions[name].calls))

    return {name: total(name) for name, f in functions.items() if f.is_kernel}


def assembled(text: str) -> dict[str, dict[str, int]]:
    """Registers and spilled bytes by kernel, of what `ptxas -v` says.

    The bytes are those stored, with those of the functions that the kernel calls.
    """
    parts = text.split("Compiling entry function '")[1:]
    return {
        part.partition("'")[0]: {
            "registers": max(map(int, re.findall(r"Used (\d+) registers", part))),
            "spilled": sum(map(int, re.findall(r"(\d+) bytes spill stores", part))),
        }
        for part in parts
    }


def launches(listing: str) -> list[tuple[str, int]]:
    """Name and threads of each kernel launched, in order, of a listing of thunks."""
    return [
        (name, math.prod(int(n) for n in f"{grid},{threads}".split(",")))
        for name, grid, threads in LAUNCH.findall(listing)
    ]


def other_thunks(listing: str) -> list[str]:
    """Kinds of what is run beside kernels: copies and calls of libraries."""
    lines = [line for line in listing.splitlines() if not LAUNCH.search(line)]
    return THUNK.findall("\n".join(lines))


def moved(hlo: str) -> dict[str, int]:
    """Bytes of operands and results of each instruction, by name.

    Whole arrays: of what a kernel gathers from, or repeats, every element once. Names
    are as kernels have them.
    """
    rows = [INSTRUCTION.match(line) for line in hlo.splitlines()]
    found = {row[1]: row for row in rows if row}
    size = {name: array_bytes(row[2]) for name, row in found.items()}
    for name, row in found.items():
        # jax 0.12 writes NAME#1 for a part of a tuple, without an instruction for it.
        parts = enumerate(ARRAY.finditer(row[2])) if row[2].startswith("(") else ()
        size |= {f"{name}#{i}": array_bytes(part[0]) for i, part in parts}
    return {
        re.sub(r"[.\-]", "_", name): size[name]
        + sum(_known(size, x, row[3]) for x in set(_operands(row[4])))
        for name, row in found.items()
    }


def _known(size: Mapping[str, int], operand: str, operation: str) -> int:
    """The bytes of an operand; none of what is no array, as a constant's number."""
    if operation == "fusion" and operand not in size:
        raise ValueError(f"no array of the name {operand!r} in XLA's program")
    return size.get(operand, 0)


def _operands(rest: str) -> list[str]:
    inside = re.sub(r"/\*.*?\*/", "", rest.partition(")")[0])
    return [x.strip().split()[-1].lstrip("%") for x in inside.split(",") if x.strip()]


def array_bytes(shape: str) -> int:
    """Of a shape of HLO, all parts of a tuple together."""
    return sum(
        math.prod(int(n) for n in dims.split(",") if n) * _width(kind)
        for kind, dims in ARRAY.findall(shape)
    )


def _width(kind: str) -> int:
    return 1 if kind == "pred" else -(-int(re.findall(r"\d+", kind)[0]) // 8)


def of_gpu(compiled: Any, folder: Path, name: str) -> dict[str, Any]:
    """A program for a GPU.

    Args:
        compiled: by jax.
        folder: of `absent_device.environment`, with what was kept and dumped meanwhile.
        name: of the function.

    Raises:
        ValueError: XLA's listing of launches is not as it was.
    """
    files = sorted((folder / KEPT).iterdir())
    texts = {end: [f.read_text() for f in files if f.suffix == end] for end in ENDS}
    functions: dict[str, Function] = {}
    for text in texts[".ptx"]:
        functions |= ptx_functions(text)
    counted, said = instructions(functions), assembled("\n".join(texts[".txt"]))
    listing = _dumped(folder, name, "thunk_sequence.txt")
    bytes_of = moved(_dumped(folder, name, "gpu_after_optimizations.txt"))
    kernels = [
        {
            "name": kernel,
            "threads": threads,
            "instructions": counted.get(kernel),
            "bytes": bytes_of.get(kernel),
            "registers": None,
            "spilled": None,
        }
        | said.get(kernel, {})
        for kernel, threads in launches(listing)
    ]
    if not kernels:
        raise ValueError(f"no launch found in XLA's listing: {listing}")
    return {
        "kernels": kernels,
        "device_functions": sum(not f.is_kernel for f in functions.values()),
        "others": other_thunks(listing),
        "temporary_bytes": _temporary_bytes(compiled, folder, name),
    }


def _temporary_bytes(compiled: Any, folder: Path, name: str) -> int:
    memory = compiled.memory_analysis()
    if memory:
        return int(memory.temp_size_in_bytes)
    # jax 0.6 does not know.
    assignment = _dumped(folder, name, "after_optimizations-buffer-assignment.txt")
    return sum(map(int, PREALLOCATED.findall(assignment)))


def _dumped(folder: Path, name: str, what: str) -> str:
    """A file of XLA's dump; one is written for a function."""
    (file,) = folder.glob(f"*jit_{name}.*{what}")
    return file.read_text()


def of_tpu(compiled: Any) -> dict[str, Any]:
    """What jax says of a program for a TPU."""
    cost, text = compiled.cost_analysis() or {}, compiled.as_text()
    return {
        "fusions": re.split(r"^ENTRY ", text, flags=re.M)[-1].count(" fusion("),
        "temporary_bytes": compiled.memory_analysis().temp_size_in_bytes,
        "flops": cost.get("flops"),
        "bytes": cost.get("bytes accessed"),
    }
