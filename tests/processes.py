"""Runs programs that need a JAX of their own: other devices, or several processes."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent


class Failed(RuntimeError):
    """A process that failed, or was not done in time; says what all wrote."""


def python(*arguments, devices=1, seconds=300) -> str:
    """What `python ARGUMENTS` prints, with so many CPU devices."""
    return together([arguments], devices, seconds)[0]


def cooperating(arguments, count=2, devices=1, seconds=120, attempts=3) -> list[str]:
    """What so many processes print that find each other on a free port.

    Args:
        arguments: of a port and a process number, the command line after `python`.
        count: of processes.
        devices: of each process.
        seconds: for all, after which all are killed.
        attempts: another program may take the port between its choice and its use.
    """
    for attempt in range(attempts):
        port = free_port()
        try:
            commands = [arguments(port, number) for number in range(count)]
            return together(commands, devices, seconds)
        except Failed:
            if attempt == attempts - 1:
                raise
    raise AssertionError("no attempt")


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def together(commands, devices, seconds) -> list[str]:
    """The standard outputs of processes that run at once; none survives this."""
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder, str(i)) for i in range(len(commands))]
        pairs = zip(commands, files, strict=True)
        running = [_start(c, file, devices) for c, file in pairs]
        try:
            _wait(running, time.monotonic() + seconds)
        finally:
            for process in running:
                process.kill()
                process.wait()
        if any(process.returncode for process in running):
            told = (f"{p.args}: {p.returncode}" for p in running)
            written = (f.with_suffix(".err").read_text()[-4000:] for f in files)
            raise Failed("\n".join([*told, *written]))
        return [f.with_suffix(".out").read_text() for f in files]


def _wait(running, deadline) -> None:
    """Until all are done, one fails, or it is too late."""
    while time.monotonic() < deadline:
        codes = [process.poll() for process in running]
        if all(code == 0 for code in codes) or any(codes):
            return
        time.sleep(0.05)


def _start(command, file: Path, devices: int) -> subprocess.Popen:
    flags = f"--xla_force_host_platform_device_count={devices}"
    paths = [str(ROOT), str(ROOT / "examples"), os.environ.get("PYTHONPATH", "")]
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith("SLURM_")},
        "XLA_FLAGS": flags,
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        # A proxy has no part in what stays on this machine.
        "no_proxy": "127.0.0.1,localhost",
    }
    with (
        file.with_suffix(".out").open("w") as out,
        file.with_suffix(".err").open("w") as err,
    ):
        return subprocess.Popen(
            [sys.executable, *map(str, command)],
            env=environment,
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
        )
