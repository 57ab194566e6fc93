"""Names and messages of others, fit to be shown."""

from __future__ import annotations


def shown(text: object) -> str:
    r"""Text in one line, with escapes for what a terminal would obey or not show.

    Names come from files that others wrote: `\x1b` would start a command to the
    terminal, `\n` a line of its own, and `\udcff` is a byte that is not UTF-8.
    """
    return "".join(c if c.isprintable() else _escaped(c) for c in str(text))


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
