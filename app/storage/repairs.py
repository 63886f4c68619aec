"""Repairs between recordings: what was heard before one and what was heard after it are not of one state of wear."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from datetime import datetime

from jointplay.app.storage.asset_rows import FindingRow


def repairs_of(findings: Iterable[FindingRow]) -> list[datetime]:
    """Return when a joint was made as new, whichever it was."""
    return [row.at for row in findings if any(joint.get("repaired") for joint in row.joints.values())]


def is_between(repairs: Iterable[datetime], moments: Collection[datetime]) -> bool:
    """Return whether a repair lies between the first and the last of some moments."""
    first, last = min(moments), max(moments)
    # What is heard or found at the very moment of a repair is of the machine before it.
    return any(first <= repair < last for repair in repairs)
