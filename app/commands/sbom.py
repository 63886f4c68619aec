"""``jointplay sbom``: what the installed program is made of, as a table or as a bill of materials."""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import click

from jointplay.app.commands.parameters import json_option, print_json
from jointplay.app.tables import table
from jointplay.version import __version__

PRODUCT = "jointplay"
EXTRAS = ("", "cluster", "tables")
"""Extras that a user may have installed; the others are for work on the program."""

VENDORED = Path(__file__).parent.parent / "static" / "vendor" / "README.md"
"""Names the files of other authors that pages load."""

LICENCE_NAME = 60
"""Longest text that is the name of a licence [characters]; a longer one is the licence itself."""


@dataclass(frozen=True)
class Component:
    """A piece of other people's work that the program runs on.

    Parameters
    ----------
    name, version, licence : str
        The licence in the words of its authors: an expression of SPDX where they give one.
    purl : str
        Its package URL.
    sha256 : str
        Of its file, where it is one file; else empty.
    """

    name: str
    version: str
    licence: str
    purl: str
    sha256: str = ""


@click.command("sbom")
@json_option
def command(as_json: bool) -> None:
    """List the packages and vendored files that this installation runs on, with versions and licences.

    With --json it is a bill of materials in the form of CycloneDX 1.6.
    """
    found = components()
    if as_json:
        print_json(bill_of_materials(found))
        return
    click.echo(table(("component", "version", "licence"), [(each.name, each.version, each.licence) for each in found]))


def components() -> list[Component]:
    """Return what is installed and needed, and what is vendored, by name."""
    return sorted([*packages(), *vendored()], key=lambda each: (each.name.lower(), each.version, each.sha256))


def packages() -> list[Component]:
    """Return the packages that the program needs, directly or not, as far as they are installed."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    reached: dict[str, Distribution] = {}
    seen: set[tuple[str, str]] = set()
    waiting = [(PRODUCT, extra) for extra in EXTRAS]
    while waiting:
        name, extra = waiting.pop()
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        try:
            found = reached[name] = reached.get(name) or distribution(name)
        except PackageNotFoundError:  # of an extra that is not installed
            continue
        for line in found.requires or ():
            needed = Requirement(line)
            if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                waiting += [(canonicalize_name(needed.name), each) for each in ("", *needed.extras)]
    del reached[PRODUCT]
    return [
        Component(each.metadata["Name"], each.version, licence_of(each), f"pkg:pypi/{name}@{each.version}")
        for name, each in reached.items()
    ]


def licence_of(found: Distribution) -> str:
    """Return the licence that a package states; empty where it states none."""
    told = found.metadata.get_all
    said = str((told("License-Expression") or told("License") or [""])[0])
    approved = "License :: OSI Approved :: "
    classified = [text.removeprefix(approved) for text in told("Classifier") or () if text.startswith(approved)]
    # Some write the whole licence where its name belongs.
    return said if said and len(said) <= LICENCE_NAME and "\n" not in said else " AND ".join(classified) or said[:1000]


def vendored() -> Iterator[Component]:
    """Give the vendored files, as their table has them."""
    row = re.compile(r"^\| `([^`]+)` \| ([\w.]+), `[^`]+` \| (\S+) \| ([^,|]+), [^|]*\| `([0-9a-f]{64})` \|$", re.M)
    for file, package, version, licence, sha256 in row.findall(VENDORED.read_text(encoding="utf-8")):
        yield Component(file, version, licence, f"pkg:npm/{package}@{version}", sha256)


def bill_of_materials(found: list[Component]) -> dict[str, Any]:
    """Return components in the form of CycloneDX 1.6."""
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid4()}",
        "version": 1,
        "metadata": {
            "timestamp": datetime.now(UTC).isoformat(timespec="seconds"),
            "component": {"type": "application", "name": PRODUCT, "version": __version__, "bom-ref": PRODUCT},
        },
        "components": [
            {
                "type": "file" if each.sha256 else "library",
                "name": each.name,
                "version": each.version,
                "purl": each.purl,
                "bom-ref": f"{each.purl}#{each.name}",
                "licenses": [{"license": {"name": each.licence}}],
                **({"hashes": [{"alg": "SHA-256", "content": each.sha256}]} if each.sha256 else {}),
            }
            for each in found
        ],
        "dependencies": [{"ref": PRODUCT, "dependsOn": [f"{each.purl}#{each.name}" for each in found]}],
    }
