"""python examples/1_push_out.py --json FILE  # this file is imported, not run.

What the examples' command lines share: options, and what is said and written last.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import jax

import jaxbe

START = time.monotonic()


def parser(doc: str | None, output: str) -> argparse.ArgumentParser:
    """The options that all examples have."""
    parser = argparse.ArgumentParser(
        description=(doc or "").partition("\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", type=Path, default=Path(output))
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers")
    parser.add_argument("--quick", action="store_true", help="much shorter")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def say(options: argparse.Namespace, text: str, **numbers: Any) -> None:
    """Prints the text with the numbers in it; writes all of them to --json."""
    print(text.format(**numbers))
    if options.json:
        found = {
            "command": shlex.join(["python", *sys.orig_argv[1:]]),
            "machine": {
                "jaxbe": jaxbe.__version__,
                "jax": jax.__version__,
                "device": jax.devices()[0].device_kind,
                "cores": os.cpu_count(),
            },
            "seconds": round(time.monotonic() - START, 1),
            **numbers,
        }
        options.json.write_text(json.dumps(found, indent=1) + "\n")
