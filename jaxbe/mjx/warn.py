"""Warnings that name the line of the program that called jaxbe."""

from __future__ import annotations

import sys
import warnings
from types import FrameType

PASSED_OVER = ("jaxbe", "contextlib")
"""Packages between that line and the warning."""


def warn_caller(message: str) -> None:
    """Warns with the nearest line that is not jaxbe's own."""
    frame: FrameType | None = sys._getframe()
    level = 1
    while frame and frame.f_globals.get("__name__", "").split(".")[0] in PASSED_OVER:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, UserWarning, stacklevel=level)
