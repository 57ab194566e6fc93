"""What the functions that draw are given."""

from __future__ import annotations

from typing import Any

from jaxbe.shapes import Box, Ellipsoid


def check_box(body: Any) -> None:
    """Checks that it is a box.

    Raises:
        TypeError: it is not.
    """
    _check("box", Box, body)


def check_ellipsoid(body: Any) -> None:
    """Checks that it is an ellipsoid.

    Raises:
        TypeError: it is not.
    """
    _check("ellipsoid", Ellipsoid, body)


def _check(name: str, kind: type, body: Any) -> None:
    if not isinstance(body, kind):
        given = type(body).__name__
        raise TypeError(f"{name} must be a jaxbe.{kind.__name__}, got {given}")
