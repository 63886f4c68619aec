"""The recordings that tests read: made by an independent simulator, with the truth beside them."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

RECORDINGS = Path(__file__).parent / "data" / "recordings"
TRUTH: dict[str, Any] = json.loads((RECORDINGS / "truth.json").read_text())


def unpacked(name: str) -> bytes:
    """Content of a recording, its ending included in the name."""
    return gzip.decompress((RECORDINGS / f"{name}.gz").read_bytes())
