"""What the README links exists, and no placeholder was left."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_linked_and_named_files_exist():
    links = re.findall(r"\]\(([^)]+)\)", README)
    named = re.findall(r"`((?:benchmarks|examples|jaxbe|tests)/[\w./-]+\.\w+)`", README)
    assert links
    assert named
    missing = [name for name in (*links, *named) if not (ROOT / name).exists()]
    assert not missing


def test_no_placeholder_is_left():
    words = re.findall(r"\b[A-Z]{7,}\b", README)
    assert set(words) <= {"CITATION", "CONTRIBUTING", "ELLIPSOID"}, words
