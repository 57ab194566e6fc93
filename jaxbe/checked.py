"""Value checks inside compiled code, on request."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import checkify

from jaxbe import validate
from jaxbe.shapes import Box, Ellipsoid


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a function that checks the values of every Box and Ellipsoid given.

    Who checks values: the constructors and `from_quaternion` those of concrete arrays;
    `certify`, of concrete bodies, that they mean a body, however they were made; nobody
    else, and nobody inside `jit`, where bad values give NaN or answers without a
    meaning. This wrapper finds them there too, at the price of reading the verdict
    back: use it to search for a fault, not in production.

    Args:
        function: takes pytrees with boxes and ellipsoids; bind options first, as in
            `checked(functools.partial(overlap, method="minkowski"))`.

    Returns:
        A compiled function of the same positional arguments and result (not to be
        jitted again), which raises
        `jax.experimental.checkify.JaxRuntimeError` naming argument and requirement
        if a value is not legal.
    """

    def check_then_call(*args: Any) -> Any:
        is_body = lambda x: isinstance(x, Box | Ellipsoid)  # noqa: E731
        for body in filter(is_body, jax.tree.leaves(args, is_leaf=is_body)):
            _check(body)
        return function(*args)

    compiled = jax.jit(checkify.checkify(check_then_call))

    @functools.wraps(function)
    def call(*args: Any) -> Any:
        error, result = compiled(*args)
        checkify.check_error(error)
        return result

    return call


def _check(body: Box | Ellipsoid) -> None:
    body.check_form()
    for rule in validate.value_rules(body.fields(), jnp):
        message = f"{type(body).__name__}: {rule.argument} must be {rule.requirement}"
        checkify.check(jnp.all(rule.ok), message)
