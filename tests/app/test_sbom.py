"""What the installed program is made of."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from pathlib import Path

import pytest
from command_line import invoke
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from jointplay.app import main
from jointplay.app.commands.sbom import components, licence_of

ROOT = Path(__file__).parents[2]

# What may be built on without giving one's own source away: permissive ones, and those that bind a library alone.
ALLOWED = re.compile(
    r"(MIT|BSD|Apache|Zero-Clause BSD|0BSD|Zlib|CC0|PSF|Python Software Foundation|MPL-2\.0|LGPL|GNU Lesser)[^()]*"
    r"( \(LGPLv3\+?\))?"
)


def test_every_licence_is_stated_and_one_that_we_may_build_on() -> None:
    found = components()
    assert len(found) > 60
    assert [(each.name, each.licence) for each in found if not ALLOWED.fullmatch(each.licence)] == []


@pytest.mark.parametrize(
    "licence", ["", "GPL-3.0-only", "GNU General Public License v3 (GPLv3)", "AGPL-3.0", "Proprietary"]
)
def test_other_licences_are_told_apart(licence: str) -> None:
    assert not ALLOWED.fullmatch(licence)


def test_all_that_is_asked_for_by_name_is_listed() -> None:
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = asked["optional-dependencies"]
    names = {
        canonicalize_name(Requirement(line).name)
        for line in [*asked["dependencies"], *extras["cluster"], *extras["tables"]]
    }
    listed = {canonicalize_name(each.name) for each in components()}
    assert names <= listed and "h11" in listed  # which uvicorn asks for, not we
    assert {canonicalize_name(Requirement(line).name) for line in extras["docs"]}.isdisjoint(listed)


def test_bill_of_materials_is_one() -> None:
    text = invoke("sbom", "--json").stdout
    form = JsonStrictValidator(SchemaVersion.V1_6)
    assert form.validate_str(text) is None and form.validate_str('{"bomFormat": "Other"}') is not None
    bill = json.loads(text)
    refs = [each["bom-ref"] for each in bill["components"]]
    assert sorted(refs) == sorted(set(refs)) == sorted(bill["dependencies"][0]["dependsOn"])
    files = {each["name"]: each["hashes"][0]["content"] for each in bill["components"] if each["type"] == "file"}
    folder = main.STATIC / "vendor"
    assert {path.name for path in folder.iterdir() if path.suffix in (".js", ".css")} == set(files)
    assert all(hashlib.sha256((folder / name).read_bytes()).hexdigest() == files[name] for name in files)


def test_table_has_a_row_for_each() -> None:
    rows = invoke("sbom").stdout.splitlines()
    assert len(rows) == 1 + len(components())
    assert any(re.fullmatch(r"numpy +[\d.]+ +BSD-3-Clause.*", row) for row in rows)


class Package:
    """Metadata of a package."""

    def __init__(self, *lines: tuple[str, str]) -> None:
        self.lines = lines

    @property
    def metadata(self) -> Package:
        return self

    def get_all(self, name: str) -> list[str]:
        return [value for key, value in self.lines if key == name]


@pytest.mark.parametrize(
    ("lines", "licence"),
    [
        ([("License-Expression", "MIT AND 0BSD"), ("License", "x")], "MIT AND 0BSD"),
        ([("License", "BSD"), ("Classifier", "License :: OSI Approved :: Other")], "BSD"),
        ([("License", "Copyright\nall"), ("Classifier", "License :: OSI Approved :: BSD License")], "BSD License"),
        ([("Classifier", "License :: OSI Approved :: A"), ("Classifier", "License :: OSI Approved :: B")], "A AND B"),
        ([("License", "Copyright\nall")], "Copyright\nall"),
        ([("Classifier", "Topic :: x")], ""),
    ],
)
def test_licence_of_a_package(lines: list[tuple[str, str]], licence: str) -> None:
    assert licence_of(Package(*lines)) == licence  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["constraints.txt", "benchmarks/constraints.txt"])
def test_everything_is_pinned_with_hashes_and_without_addresses(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    pinned = [line for line in text.replace(" \\\n", " ").splitlines() if not line.startswith("#")]
    assert pinned
    row = re.compile(r"[\w.-]+==[\w.]+( ; [^@]+?)?( +--hash=sha256:[0-9a-f]{64})+")
    assert [line[:60] for line in pinned if not row.fullmatch(line)] == []
    assert "://" not in text
