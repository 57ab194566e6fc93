"""What mkdocs calls: the pages of `sources.py`, the navigation, the links."""

from __future__ import annotations

from typing import Any

import links
import sources
from mkdocs.structure.files import File, Files


def on_config(config: Any) -> Any:
    """Reads the sources anew; puts a folder's pages where the navigation has a star."""
    sources.pages.cache_clear()
    sources.scripts.cache_clear()
    for entry in config.nav:
        for section, pattern in entry.items():
            if isinstance(pattern, str) and pattern.endswith("*"):
                entry[section] = sources.listed(pattern.removesuffix("*"))
    return config


def on_files(files: Files, config: Any) -> Files:
    """Adds the pages and pictures that are in no file of docs/."""
    for page, text in sources.pages().items():
        files.append(File.generated(config, page, content=text))
    for picture in sources.pictures():
        name = sources.path(picture)
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    return files


def on_page_content(content: str, page: Any, files: Files, **_: Any) -> str:
    """Adds the links."""

    def url(path: str) -> str:
        return files.get_file_from_path(path).url_relative_to(page.file)

    return links.link_names(content, page.file.src_uri, url)
