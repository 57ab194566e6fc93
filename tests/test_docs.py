"""The documentation has all that is public, and each example; it is built by CI."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import links
import pytest
import sources

import jaxbe
import jaxbe.mjx
import jaxbe.viz

DOCS = Path(links.__file__).parent
PUBLIC = {f"{m.__name__}.{n}" for m in (jaxbe, jaxbe.mjx, jaxbe.viz) for n in m.__all__}


def test_every_public_name_is_in_the_api_and_nothing_else():
    entries = [
        name
        for file in (DOCS / "api").glob("*.md")
        for name in re.findall(r"^::: (\S+)", file.read_text(), re.M)
    ]
    assert len(entries) == len(set(entries))
    assert set(entries) == PUBLIC | {"jaxbe.mjx", "jaxbe.viz", "jaxbe.types"}
    overview = (DOCS / "api" / "index.md").read_text()
    assert not [name for name in jaxbe.__all__ if f"`{name}`" not in overview]


def test_what_the_page_on_the_paper_names_exists():
    names = re.findall(r"^::: (\S+)", (DOCS / "paper.md").read_text(), re.M)
    assert all(inspect.getdoc(importlib.import_module(name)) for name in names)


def test_what_is_returned_is_not_read_as_a_type():
    """The first line of a section `Returns:` is a type up to its first colon."""
    wrong = [
        f"{file.name}: {line}"
        for file in sources.ROOT.glob("jaxbe/**/*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.FunctionDef)
        for line in re.findall(r"Returns:\n(.*)", ast.get_docstring(node) or "")
        if ": " in line
    ]
    assert not wrong


def test_every_example_is_a_page_or_imported_by_one():
    scripts = sources.scripts()
    helpers = {module for script in scripts for module in sources.modules(script)}
    assert helpers.isdisjoint(scripts)
    assert helpers | set(scripts) == set(sources.EXAMPLES.glob("*.py"))
    for script in scripts:
        page = sources.pages()[f"examples/{script.stem}.md"]
        assert f"\npython examples/{script.name}" in page
        assert script.read_text() in page
        for module in sources.modules(script):
            assert f"## {module.name}\n" in page
    assert len(scripts) >= 9


@pytest.mark.parametrize("folder", ["examples/", "benchmarks/results/"])
def test_the_navigation_lists_every_page_by_a_name_of_its_own(folder):
    listed = sources.listed(folder)
    names = [name for entry in listed if isinstance(entry, dict) for name in entry]
    pages = [page for page in sources.pages() if page.startswith(folder)]
    paths = [p for e in listed for p in (e.values() if isinstance(e, dict) else [e])]
    headings = [sources.pages()[e].split("\n")[0] for e in listed if isinstance(e, str)]
    assert paths == pages
    assert len({*names, *headings}) == len(listed) > 5


def test_every_picture_is_on_a_page():
    shown = {
        (sources.ROOT / page).parent / name
        for page, text in sources.pages().items()
        for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    }
    assert shown == set(sources.pictures())


def test_the_help_is_that_of_the_command():
    page = sources.pages()["api/command.md"]
    assert "--picture OUT.png" in page
    assert page.count("exit status:") == 1


@pytest.mark.parametrize(
    ("given", "page"),
    [
        ("<code>margin</code>", "api/margin.md#jaxbe.margin"),
        ("<code>jaxbe.margin(box, ellipsoid)</code>", "api/margin.md#jaxbe.margin"),
        ("<code>gather</code>", "api/mjx.md#jaxbe.mjx.gather"),
        ("<code>jaxbe.growth</code>", "paper.md#jaxbe.growth"),
        ("<code>placing.py</code>", "examples/1_push_out.md"),
        ("<code>examples/reach_ppo.py</code>", "examples/reach_ppo.md"),
        ("<code>CHANGELOG.md</code>", "CHANGELOG.md"),
        ("<code>steps</code>", None),
        ("<code>viz</code>", None),
        ("<code>margin &gt; 0</code>", None),
        ('<a href="x"><code>margin</code></a>', None),
        ("<pre><code>margin</code></pre>", None),
        ("<b><code>margin</code></b>", None),
    ],
)
def test_names_become_links(given, page):
    expected = given if page is None else f'<a href="{page}">{given}</a>'
    assert links.link_names(given, "README.md", lambda path: path) == expected


def test_the_citation_has_no_other_version():
    citation = (sources.ROOT / "CITATION.cff").read_text()
    assert "\ntitle:" in citation
    assert re.findall(r"^version: *(.*)$", citation, re.M) in ([], [jaxbe.__version__])
