"""Names that docstrings refer to are there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted(
    f"jointplay.{'.'.join(path.relative_to(ROOT).with_suffix('').parts)}"
    for package in ("app", "catalogue", "solver")
    for path in (ROOT / package).rglob("*.py")
    if path.name not in ("__init__.py", "__main__.py") and "migrations" not in path.parts
)
ROLE = re.compile(r":(?:func|class|meth|data|mod|attr|exc):`~?([\w.]+)`")


def is_there(name: str) -> bool:
    """Whether a dotted name leads to something that can be imported."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ImportError:
            continue
        for part in parts[count:]:
            if part in getattr(found, "__annotations__", {}):
                return True
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


def members_of(kind: type) -> set[str]:
    """Members of a class that its docstrings name alone."""
    return {*vars(kind), *getattr(kind, "__annotations__", {})}


@pytest.mark.parametrize("module", MODULES)
def test_what_docstrings_refer_to_is_there(module: str) -> None:
    loaded = importlib.import_module(module)
    members = {each for kind in vars(loaded).values() if isinstance(kind, type) for each in members_of(kind)}
    for name in ROLE.findall(Path(loaded.__file__ or "").read_text(encoding="utf-8")):
        assert name in members or is_there(name) or is_there(f"{module}.{name}"), name
