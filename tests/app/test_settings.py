"""Settings as the documents name them are those there are, with the same defaults; bad ones are refused by name."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import assert_refused, invoke
from pydantic_core import PydanticUndefined

from jointplay.app.settings import ServiceSettings

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "settings.md"


def documented() -> dict[str, str]:
    """Name and default of every row of the table of settings."""
    section = DOCUMENT.read_text(encoding="utf-8").partition("## Settings\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \|([^|]*)\| [^|]+ \|$", section, re.MULTILINE)
    assert len(dict(rows)) == len(rows)
    return {name: default.strip().strip("`") for name, default in rows}


def shown(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return json.dumps(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def test_the_document_names_every_setting_with_its_default() -> None:
    assert documented() == {name: shown(field.default) for name, field in ServiceSettings.model_fields.items()}


def test_every_setting_has_a_default_and_says_what_it_is() -> None:
    for name, field in ServiceSettings.model_fields.items():
        assert field.default is not PydanticUndefined, name
        assert field.description, name
        assert field.description.endswith("."), name


@pytest.mark.parametrize("name", sorted(ServiceSettings.model_fields))
def test_every_setting_comes_from_the_environment(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    field = ServiceSettings.model_fields[name]
    given = {"keys": "off", "log_format": "json", "log_level": "error", "webhooks_private": "true", "proxies": "::1"}
    other = given.get(name, "7")
    monkeypatch.setenv(f"JOINTPLAY_{name.upper()}", other)
    assert shown(getattr(ServiceSettings(), name)) == other != shown(field.default)


def test_a_setting_may_stand_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "jointplay_database").write_text("postgresql://me:secret@host/x\n")
    (tmp_path / "jointplay_workers").write_text("5")
    monkeypatch.setenv("JOINTPLAY_SECRETS", str(tmp_path))
    monkeypatch.setenv("JOINTPLAY_WORKERS", "7")
    settings = ServiceSettings()
    assert (settings.database, settings.workers) == ("postgresql://me:secret@host/x", 7)
    monkeypatch.setenv("JOINTPLAY_SECRETS", str(tmp_path / "none"))
    assert_refused(invoke("serve", "--port", "0"), 2, "none: is no folder")


@pytest.mark.parametrize(
    ("name", "given", "rule"),
    [
        ("workers", "0", "greater than or equal to 1"),
        ("log_level", "loud", "'debug'"),
        ("stop_limit_s", "soon", "number"),
    ],
)
def test_a_setting_that_cannot_be_is_refused_by_name(
    name: str, given: str, rule: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"JOINTPLAY_{name.upper()}", given)
    result = invoke("serve", "--port", "0")
    assert_refused(result, 2, f"JOINTPLAY_{name.upper()}: ")
    assert rule in result.stderr
