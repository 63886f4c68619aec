"""The site of the pages: built without a warning, and without anything that is loaded from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

#: What a page loads by itself, not what it links to.
LOADED = re.compile(
    r"<(?:script|img|iframe|source|embed|audio|video)\b[^>]*?\bsrc=\"([^\"]*)\""
    r"|<link\b[^>]*?\brel=\"(?:stylesheet|icon|preload|preconnect|dns-prefetch)\"[^>]*?\bhref=\"([^\"]*)\""
)
IMPORTED = re.compile(r"@import\s+(?:url\()?[\"']?([^\"');]+)|url\([\"']?([^\"')]+)")


@pytest.mark.long
def test_the_site_is_built_and_loads_from_its_own_origin_only(tmp_path: Path) -> None:
    site = tmp_path / "site"
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "--fail-on-warning",
        "--keep-going",
        "--nitpicky",
        "--quiet",
        "-b",
        "html",
    ]
    done = subprocess.run(
        [*command, "-d", tmp_path / "trees", ROOT / "docs", site], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    pages, sheets = sorted(site.rglob("*.html")), sorted(site.rglob("*.css"))
    assert len(pages) > 150 and sheets
    for file, pattern in [*((page, LOADED) for page in pages), *((sheet, IMPORTED) for sheet in sheets)]:
        for found in pattern.findall(file.read_text(encoding="utf-8")):
            address = next(filter(None, found), "")
            assert not re.match(r"(?:[a-z]+:)?//", address), f"{file.name}: {address}"
    assert (site / "guide" / "own-machine.html").exists()
    assert "Radial clearance" in (site / "reference" / "command-line.html").read_text(encoding="utf-8")
