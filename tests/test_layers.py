"""What is here because of a compiler is in `jaxbe._xla`, and nowhere else."""

import ast
import re
from pathlib import Path

import pytest

import jaxbe

FOLDER = Path(jaxbe.__file__).parent
LAYER = {"_xla.py", "_xla_primitives.py"}
MODULES = sorted(x.name for x in FOLDER.glob("*.py") if x.name not in LAYER)
EVERYWHERE = sorted(
    str(x.relative_to(FOLDER)) for x in FOLDER.rglob("*.py") if x.name not in LAYER
)

WORDS = re.compile(
    r"(?<![a-z])(backends?|fus(?:e|es|ed|ing|ions?)|opaque|xla|[cgt]pus?)(?![a-z])",
    re.IGNORECASE,
)
CALLS = re.compile(r"_xla(\.\w+)?")
"""What names an entry of the layer is no word of the mathematics."""

TO_USERS = {"chunked.py": {"xla"}, "margin.py": {"cpu", "gpu", "tpu"}}
"""What public docstrings say of devices, and the name of a report."""

COMPILER_MODULES = ("jax.interpreters", "jax.extend", "jax._src")


def words_of(text):
    return {x.lower() for x in WORDS.findall(CALLS.sub("", text))}


def test_the_words_are_found():
    text = "One fusion on GPUs; _xla.stay_fused(x), `jaxbe._xla`; XLA refuses. is_fused"
    assert words_of(text) == {"fusion", "gpus", "xla", "fused"}


@pytest.mark.parametrize("name", MODULES)
def test_mathematics_names_no_compiler(name):
    found = words_of((FOLDER / name).read_text())
    assert found - TO_USERS.get(name, set()) == set()


def modules_of(node):
    """The modules that a statement imports, or might, by their full names."""
    if isinstance(node, ast.Import):
        return [x.name for x in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{x.name}" for x in node.names]
    return []


@pytest.mark.parametrize("name", EVERYWHERE)
def test_one_module_speaks_to_the_compiler(name):
    for node in ast.walk(ast.parse((FOLDER / name).read_text())):
        assert getattr(node, "attr", None) != "optimization_barrier"
        for module in modules_of(node):
            assert not module.startswith(COMPILER_MODULES)
            assert not module.endswith(".optimization_barrier")
