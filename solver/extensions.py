"""What other installed packages add to this one, by entry points; see ``docs/guide/extending.md``."""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points


@lru_cache
def entry_points_of(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, sorted; nothing of them is loaded.

    Parameters
    ----------
    group : str
        ``contact_laws``, ``readers`` or ``matchers``: ``jointplay.contact_laws`` in a package's own metadata.
    """
    found = entry_points(group=f"jointplay.{group}")
    return {point.name: point for point in sorted(found, key=lambda point: point.name)}
