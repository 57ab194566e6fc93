"""The report of `benchmarks.accuracy`: one table for each kind of answer."""

from __future__ import annotations

from typing import Any

from benchmarks import report, settings

QUANTITIES = ("50 %", "99 %", "99.9 %", "max")
COUNTS = ("false overlaps", "missed")


def _header(quantities: tuple[str, ...]) -> tuple[str, ...]:
    columns = (f"{d}, {q}" for d in settings.DTYPES for q in quantities)
    return ("scene", "setting", *columns)


def text(numbers: dict[str, Any]) -> str:
    """The report in Markdown."""
    tables = "\n\n".join(
        f"## {answer.capitalize()}\n\n{_table(numbers['errors'], answer)}"
        for answer in settings.ANSWERS
    )
    return f"""\
# Accuracy

{numbers["pairs"]:,} pairs of each kind (seed {numbers["seed"]}), judged on the very \
numbers given. Errors of margins are relative to max(1, growth distance), of distances \
to the longest length of the pair or the distance, of gradients to the true one's size \
(all 30 numbers, lengths in units of the longest). Distances and their gradients: of \
pairs apart; the depth of an overlapping pair is compared with the least one known. \
Verdicts: how many pairs; "false overlap" is what a \
user must take for an overlap who may not miss one (the value not above zero, the \
certificate not of separation), "missed" the reverse.

{tables}

{report.machine_lines(numbers["machine"])}"""


def _table(errors: list[dict[str, Any]], answer: str) -> str:
    rows: dict[tuple[str, str], list[str]] = {}
    for entry in (e for e in errors if e["answer"] == answer):
        rows.setdefault((entry["scene"], entry["setting"]), []).extend(_cells(entry))
    header = _header(COUNTS if answer == settings.VERDICT else QUANTITIES)
    return report.table(header, [(*key, *cells) for key, cells in rows.items()])


def _cells(entry: dict[str, Any]) -> list[str]:
    if "missed" in entry:
        return [f"{entry['false_overlap']:,}", f"{entry['missed']:,}"]
    nan = f" ({entry['nan']} NaN)" if entry["nan"] else ""
    *cells, last = (f"{x:.1e}" if x else "0" for x in entry["error"].values())
    return [*cells, last + nan]
