"""The version is the same wherever it is said."""

from __future__ import annotations

import re
from pathlib import Path

from jointplay.version import __version__

ROOT = Path(__file__).parents[2]


def test_changelog_and_citation_say_the_version() -> None:
    released = re.findall(r"^## \[(\d.*?)\] - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert released[0] == __version__
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
