"""Pages made of the repository's own files, so that nothing is written twice.

A file's path is its page's, too, and so the links between files hold between pages:
README.md is the home page, the results of benchmarks, the changes and CONTRIBUTING.md
are pages as they are; each example that can be run is one, of its docstring, picture
and code; and the command line's help is one. Needs Python alone.
"""

from __future__ import annotations

import ast
import functools
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
RESULTS = ROOT / "benchmarks" / "results"
FILES = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")

EXTRAS = {
    "brax": "brax",
    "matplotlib": "viz",
    "mujoco": "brax",
    "optax": "examples",
    "rich": "examples",
}
"""What to install for what an example imports; `examples` has `viz`."""

COMMAND = re.compile(r"^ *(python examples/\S+.*?)(?:  +\((.*)\)\.?)?$", re.MULTILINE)
"""A line of a docstring; options may follow in brackets."""

HELP = """\
import sys, types
package = types.ModuleType("jaxbe")
package.__path__, package.__version__ = ["jaxbe"], ""
sys.modules["jaxbe"] = package
from jaxbe.cli import main
main(["--help"])
"""
"""The help without `import jaxbe`, which would need JAX."""


@functools.cache
def pages() -> dict[str, str]:
    """The Markdown of every page that no file in docs/ has, by its path."""
    made = {name: (ROOT / name).read_text() for name in FILES}
    made |= {path(file): _result(file) for file in sorted(RESULTS.glob("*.md"))}
    made["examples/index.md"] = _gallery()
    made |= {f"examples/{file.stem}.md": _example(file) for file in scripts()}
    made["api/command.md"] = f"# Command line\n\n```text\n{_help()}```\n"
    return made


def listed(folder: str) -> list[str | dict[str, str]]:
    """The pages of a folder for the navigation: by heading, if no other has that."""
    found = {p: text for p, text in pages().items() if p.startswith(folder)}
    headings = [text.partition("\n")[0] for text in found.values()]
    return [
        {Path(p).stem: p} if headings.count(heading) > 1 else p
        for p, heading in zip(found, headings, strict=True)
    ]


def path(file: Path) -> str:
    """From the repository's root."""
    return file.relative_to(ROOT).as_posix()


def pictures() -> list[Path]:
    """Of examples and results."""
    folders = (EXAMPLES, RESULTS)
    found = (folder.glob(end) for folder in folders for end in ("*.png", "*.gif"))
    return sorted(file for files in found for file in files)


@functools.cache
def scripts() -> tuple[Path, ...]:
    """The examples that are run; the others are imported by them."""
    files = sorted(EXAMPLES.glob("*.py"))
    return tuple(file for file in files if '"__main__"' in file.read_text())


def modules(file: Path) -> list[Path]:
    """What an example imports from its own folder, and what that imports."""
    found: list[Path] = []
    waiting = [file]
    while waiting:
        beside = (EXAMPLES / f"{name}.py" for name in _imports(waiting.pop()))
        new = [other for other in beside if other.exists() and other not in found]
        found += new
        waiting += new
    return found


def title(file: Path) -> str:
    """1_push_out.py is "1. Push out"."""
    words = file.stem.replace("_", " ").replace("ppo", "with PPO")
    number, rest = re.fullmatch(r"(\d*) ?(.*)", words).groups()
    return f"{number}. {rest}".removeprefix(". ").replace(rest[0], rest[0].upper(), 1)


def _imports(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (name.name.split(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]


def _result(file: Path) -> str:
    """A table of results with the pictures that are named after it."""
    names = [p.name for p in pictures() if p.parent == RESULTS]
    shown = [f"![{n}]({n})" for n in names if n.startswith(file.stem)]
    return "\n\n".join([file.read_text(), *shown])


def _picture(file: Path) -> str:
    names = (file.stem, file.stem.replace("_", "-"))
    found = [p.name for p in pictures() if p.parent == EXAMPLES and p.stem in names]
    return "".join(f"![{title(file)}]({name}){{ loading=lazy }}\n" for name in found)


def _example(file: Path) -> str:
    command, text = _docstring(file)
    if not command:
        raise ValueError(f"the docstring of {path(file)} has no command")
    parts = [
        f"# {title(file)}",
        f"```sh\npip install '.[{_extras(file)}]'\n{command}\n```",
        text,
        _picture(file),
        f"## Code\n\n{_code(file)}",
    ]
    for module in modules(file):
        code = _indented(_code(module))
        heading = f"## {module.name}\n\n{_docstring(module)[1]}"
        parts.append(f'{heading}\n\n??? note "Code"\n{code}')
    return "\n\n".join(parts)


def _extras(file: Path) -> str:
    needed = {name for each in (file, *modules(file)) for name in _imports(each)}
    extras = {EXTRAS[name] for name in needed if name in EXTRAS}
    return ",".join(sorted(extras - ({"viz"} if "examples" in extras else set())))


def _docstring(file: Path) -> tuple[str, str]:
    """Its command, wherever it stands, if it has one; and the rest."""
    text = ast.get_docstring(ast.parse(file.read_text())) or ""
    found = COMMAND.search(text)
    if found is None:
        return "", text
    options = re.sub(r"--\w+( \d+)?", r"`\g<0>`", found[2] or "")
    rest = text.replace(found[0], "").strip()
    return found[1], f"{rest}\n\nOptions: {options}." if options else rest


def _code(file: Path) -> str:
    return f'```python title="{path(file)}"\n{file.read_text()}```\n'


def _indented(text: str) -> str:
    return "".join(
        f"    {line}" if line.strip() else line for line in text.splitlines(True)
    )


def _gallery() -> str:
    parts = ["# Examples"]
    for file in scripts():
        _, text = _docstring(file)
        head = f"## [{title(file)}]({file.stem}.md)"
        parts += [head, text.split("\n\n")[0], _picture(file)]
    return "\n\n".join(parts)


def _help() -> str:
    return subprocess.run(
        [sys.executable, "-c", HELP],
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "88", "NO_COLOR": "1"},
        capture_output=True,
        check=True,
        text=True,
    ).stdout
