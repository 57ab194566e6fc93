"""What griffe cannot see of jaxbe without importing it: for the API pages.

`jaxbe.margin` is a function and the module it comes from; at run time the function
wins, as it does here. Defaults that are named constants show their values, and types
that are short names without a page what they stand for.
"""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Iterator
from typing import Any

import griffe


class Public(griffe.Extension):
    """Names the public objects as a program does."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called once all modules of jaxbe are read."""
        public = [
            (module, name, _defined(pkg, module, name))
            for module in (pkg, pkg["mjx"], pkg["viz"])
            for name in map(str, module.exports or ())
        ]
        for _module, _name, found in public:
            for described in _with_members(found):
                _spell_out(described)
        for module, name, found in public:
            module.members[name] = griffe.Alias(name, found, parent=module)


def _defined(pkg: griffe.Module, module: griffe.Module, name: str) -> Any:
    """The object itself, where it is defined."""
    member = module.members[name]
    if member.is_alias:
        return pkg[member.target_path.removeprefix(f"{pkg.name}.")]
    return member[name] if member.is_module else member


def _with_members(found: Any) -> Iterator[Any]:
    yield found
    if found.is_class:
        yield from (m for m in found.members.values() if not m.is_alias)


def _spell_out(found: Any) -> None:
    names = found.module.members
    if found.is_function:
        found.returns = _expanded(found.returns, names)
        for parameter in found.parameters:
            parameter.annotation = _expanded(parameter.annotation, names)
            parameter.default = _value(parameter, names)
    elif found.is_attribute:
        found.annotation = _expanded(found.annotation, names)


def _expanded(annotation: Any, names: dict[str, Any]) -> Any:
    """With what undocumented names of the module stand for."""
    if isinstance(annotation, griffe.ExprName):
        meant = names.get(annotation.name)
        is_short = isinstance(meant, griffe.Attribute) and not meant.has_docstring
        return _expanded(meant.value, names) if is_short else annotation
    if isinstance(annotation, griffe.Expr):
        parts = {
            field.name: _expanded(getattr(annotation, field.name), names)
            for field in dataclasses.fields(annotation)
        }
        return dataclasses.replace(annotation, **parts)
    if isinstance(annotation, list):
        return [_expanded(part, names) for part in annotation]
    return annotation


def _value(parameter: griffe.Parameter, names: dict[str, Any]) -> Any:
    """The default, if it is a number, string or tuple that the module names."""
    if parameter.kind is griffe.ParameterKind.var_positional:
        return None
    constant = names.get(str(parameter.default))
    try:
        return repr(ast.literal_eval(str(constant.value)))
    except (AttributeError, ValueError, griffe.AliasResolutionError):
        return parameter.default
