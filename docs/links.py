"""Names in code that have a page become links: of functions, results and examples."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path

import sources

DOCS = Path(__file__).parent

CODE = re.compile(
    # What is a link, a block, a heading or a parameter's name already stays as it is.
    r"<(?P<kept>a|pre|h\d|b)\b.*?</(?P=kept)>|<code>(?P<code>[^<]+)</code>",
    re.DOTALL,
)
EXTRAS = ("mjx", "viz")
"""These words alone are what is installed."""

CALL = re.compile(r"([A-Za-z_.]+)(\(.*\))?")


def documented() -> dict[str, str]:
    """The path of the page of every object of jaxbe that has one."""
    return {
        name: file.relative_to(DOCS).as_posix()
        for file in sorted(DOCS.rglob("*.md"))
        for name in re.findall(r"^::: (\S+)$", file.read_text(), re.M)
    }


def link_names(content: str, here: str, url: Callable[[str], str]) -> str:
    """The HTML of a page with links.

    Args:
        content: the HTML.
        here: the page's path.
        url: the address of a page's path, from this page.
    """
    names, files = documented(), _files()

    def linked(match: re.Match[str]) -> str:
        code = html.unescape(match["code"] or "")
        if page := files.get(code):
            return match[0] if page == here else f'<a href="{url(page)}">{match[0]}</a>'
        call = CALL.fullmatch(code)
        first = ("jaxbe.mjx.", "jaxbe.") if here == "api/mjx.md" else ("jaxbe.",)
        for scope in (*first, "", "jaxbe.mjx.", "jaxbe.viz."):
            if call and call[1] not in EXTRAS and (name := scope + call[1]) in names:
                return f'<a href="{url(names[name])}#{name}">{match[0]}</a>'
        return match[0]

    return CODE.sub(linked, content)


def _files() -> dict[str, str]:
    """The page of each file that is named in code."""
    files = {page: page for page in sources.pages() if (sources.ROOT / page).exists()}
    for script in sources.scripts():
        for file in (script, *sources.modules(script)):
            for name in (file.name, sources.path(file)):
                files.setdefault(name, f"examples/{script.stem}.md")
    return files
