"""The manifest: what a catalogue is of, and whether a build may go on in its folder; and its seal.

The seal says which shards a catalogue consists of, with one hash over all of them.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, Self

from jointplay import solver
from jointplay.catalogue.errors import CatalogueFileError, CatalogueMismatchError, PlanError
from jointplay.catalogue.plans.entry import DRAWS_VERSION, Recipe, content_digest
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.plans.plan import Plan, parse_plan
from jointplay.catalogue.storage.directory import CatalogueDirectory, publish
from jointplay.catalogue.storage.hdf5 import LAYOUT_VERSION, check_layout
from jointplay.catalogue.storage.shard import ShardHeader
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.version import __version__


@dataclass(frozen=True)
class SealedShard:
    """One shard: its SHA-256, which is its name, its size in bytes and its number of entries."""

    sha256: str
    size: int
    entries: int


@dataclass(frozen=True)
class Seal:
    """What a catalogue consisted of when a build or a check ended.

    Parameters
    ----------
    root : str
        Root hash, see :func:`root_hash`: the catalogue's id.
    content : str
        SHA-256 over all entries with their spectra, however they are divided into shards: two catalogues with the same
        content answer every question alike.
    shards : tuple of SealedShard
        In the order of their names.
    hypotheses : mapping of str to int
        Entries with a spectrum, by hypothesis, in the catalogue's order.
    failed : mapping of str to int
        Entries without, by status.
    guard : mapping of str to float, or None
        Number of entries that were computed once more and more finely, and mean and 90th percentile of their mean
        differences of band levels [dB]; None if there are none.
    """

    root: str
    content: str
    shards: tuple[SealedShard, ...]
    hypotheses: Mapping[str, int]
    failed: Mapping[str, int]
    guard: Mapping[str, float] | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shards, sorted."""
        return tuple(shard.sha256 for shard in self.shards)

    @property
    def plain(self) -> dict[str, Any]:
        """As plain data; :meth:`from_plain` reads it back."""
        return {
            "root": self.root,
            "content": self.content,
            "hypotheses": dict(self.hypotheses),
            "failed": dict(self.failed),
            "guard": None if self.guard is None else dict(self.guard),
            "shards": [f"{shard.sha256} {shard.size} {shard.entries}" for shard in self.shards],
        }

    @classmethod
    def from_plain(cls, content: Mapping[str, Any]) -> Self:
        """Read what :attr:`plain` wrote.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is something else.
        """
        lines = (str(line).split(" ") for line in content["shards"])
        shards = tuple(SealedShard(name, int(size), int(count)) for name, size, count in lines)
        return cls(**{**content, "shards": shards})


def root_hash(layout_version: int, machine_key: str, recipe: Mapping[str, Any], shards: tuple[str, ...]) -> str:
    """SHA-256 over everything a catalogue holds: machine, recipe, and the checksums of all shards.

    Parameters
    ----------
    layout_version : int
    machine_key : str
        Content key of the machine.
    recipe : mapping
        How the entries were computed, as plain data.
    shards : tuple of str
        SHA-256 of each, sorted.
    """
    return content_digest(
        {"layout_version": layout_version, "machine": machine_key, "recipe": recipe, "shards": list(shards)}
    )


_FORMAT = "jointplay catalogue"
_PACKAGES = ("casadi", "numba", "llvmlite", "numpy", "scipy")


def package_versions() -> dict[str, str]:
    """Versions of Python, of this program, and of the packages that shape simulated numbers."""
    own = {"python": platform.python_version(), "jointplay": __version__}
    return {**own, **{name: metadata.version(name) for name in _PACKAGES}}


def this_platform() -> str:
    """System and processor of this computer: sums round alike where both are alike."""
    from llvmlite import binding

    return f"{platform.platform()}, {binding.get_host_cpu_name()}"


@dataclass(frozen=True)
class Manifest:
    """What stands in ``manifest.json``.

    Parameters
    ----------
    machine_content : str
        Canonical JSON of the machine.
    recipe : Recipe
        How every entry is computed.
    plan : Plan
        The plan that last added to the catalogue.
    numbers_version : int
        :data:`jointplay.solver.NUMBERS_VERSION` of the program that began it; no other may add to it.
    versions : mapping of str to str
        Python, this program and packages at the first build.
    platform : str
        Computer and system of the first build.
    created : str
        RFC 3339, UTC.
    seal : Seal, optional
        What it consisted of at the end of the last build or check; None before the first.
    draws_version : int
        :data:`jointplay.catalogue.plans.entry.DRAWS_VERSION` of that program, likewise.
    """

    machine_content: str
    recipe: Recipe
    plan: Plan
    numbers_version: int
    versions: Mapping[str, str]
    platform: str
    created: str
    seal: Seal | None = None
    draws_version: int = DRAWS_VERSION

    @classmethod
    def of(cls, machine: Machine, plan: Plan) -> Self:
        """The manifest of a new catalogue, see :meth:`jointplay.catalogue.plans.plan.Plan.recipe`."""
        return cls(
            machine_content=machine.canonical_json(),
            recipe=plan.recipe(machine),
            plan=plan,
            numbers_version=solver.NUMBERS_VERSION,
            versions=package_versions(),
            platform=this_platform(),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
        )

    @classmethod
    def of_shard(cls, header: ShardHeader, created: str) -> Self:
        """The manifest that fits a shard, for one that was lost."""
        return cls(
            machine_content=header.machine,
            recipe=header.recipe,
            plan=parse_plan(header.plan, "plan of a shard"),
            numbers_version=header.numbers_version,
            versions=header.versions,
            platform="not known",
            created=created,
        )

    @classmethod
    def read(cls, directory: CatalogueDirectory) -> Self:
        """Read the manifest of a catalogue.

        Raises
        ------
        CatalogueFileError
            There is none, or it cannot be understood.
        CatalogueMismatchError
            It has another layout.
        """
        path = directory.manifest
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            rule = "is not a catalogue: it has no manifest.json"
            raise CatalogueFileError(directory.root, rule) from None
        except (OSError, ValueError) as error:
            raise CatalogueFileError(path, f"cannot be read as JSON ({error})") from None
        if not isinstance(content, dict) or content.get("format") != _FORMAT:
            raise CatalogueFileError(path, "is not the manifest of a catalogue")
        check_layout(content.get("layout_version"), directory.root)
        try:
            if content.pop("checksum") != content_digest(content):
                raise ValueError("it does not match its checksum")
            seal = content["seal"]
            return cls(
                machine_content=parse_machine(content["machine"], str(path)).canonical_json(),
                recipe=Recipe.from_content(content["recipe"]),
                plan=parse_plan(content["plan"], str(path)),
                numbers_version=int(content["numbers_version"]),
                versions=dict(content["versions"]),
                platform=str(content["platform"]),
                created=str(content["created"]),
                seal=None if seal is None else Seal.from_plain(seal),
                draws_version=int(content.get("draws_version", 1)),
            )
        except (KeyError, TypeError, ValueError, MachineError, PlanError) as error:
            raise CatalogueFileError(path, f"is damaged ({error})") from None

    def to_json(self) -> bytes:
        """As it is written, with a checksum over everything else in it."""
        content: dict[str, Any] = {
            "format": _FORMAT,
            "layout_version": LAYOUT_VERSION,
            "machine_key": self.machine.content_key,
            "recipe": self.recipe.content,
            "plan": self.plan.content,
            "plan_hash": self.plan.hash,
            "band_edges_orders": list(self.recipe.scheme.edges),
            "numbers_version": self.numbers_version,
            "draws_version": self.draws_version,
            "versions": dict(self.versions),
            "platform": self.platform,
            "created": self.created,
            "machine": json.loads(self.machine_content),
            "seal": None if self.seal is None else self.seal.plain,
        }
        content["checksum"] = content_digest(content)
        return (json.dumps(content, indent=1) + "\n").encode()

    def write(self, directory: CatalogueDirectory) -> None:
        """Write the manifest; the old one stays until the new one is complete."""
        publish(directory.manifest, self.to_json())

    def root_of(self, shards: tuple[str, ...]) -> str:
        """Root hash of the catalogue if it consists of these shards (names, sorted)."""
        return root_hash(LAYOUT_VERSION, self.machine.content_key, self.recipe.content, shards)

    @property
    def other_numbers(self) -> str:
        """That the catalogue holds other numbers than this program computes, in words; empty if it does not."""
        theirs, ours = self.numbers_version, solver.NUMBERS_VERSION
        return "" if theirs == ours else f"holds numbers of version {theirs}, this program computes version {ours}"

    @cached_property
    def machine(self) -> Machine:
        """The machine; its links and joints are in alphabetical order."""
        return parse_machine(self.machine_content, "machine of the catalogue")

    def header(self, plan: Plan) -> ShardHeader:
        """What a shard written now says of itself."""
        return ShardHeader(
            machine=self.machine_content,
            recipe=self.recipe,
            plan=plan.content,
            numbers_version=self.numbers_version,
            versions=package_versions(),
        )

    def check_accepts(self, machine: Machine, plan: Plan, where: Path) -> None:
        """Refuse what must not be mixed into this catalogue.

        Raises
        ------
        CatalogueMismatchError
            Another machine, version of numbers, setting of the computation, or scatter of the uncertain numbers.
        """
        if machine.content_key != self.machine.content_key:
            raise CatalogueMismatchError(where, f"is a catalogue of another machine: {self._difference(machine)}")
        if self.other_numbers:
            raise CatalogueMismatchError(where, f"{self.other_numbers}: build into another folder")
        if self.draws_version != DRAWS_VERSION:
            rule = "was drawn with other machines in order than worn, not the same: build into another folder"
            raise CatalogueMismatchError(where, rule)
        self.recipe.check_same(plan.recipe(machine), str(where))
        different = self.plan.difference(plan, machine)
        if different:
            raise CatalogueMismatchError(where, f"was drawn with another {different}: build into another folder")

    def _difference(self, machine: Machine) -> str:
        if machine.name != self.machine.name:
            return f"{self.machine.name}, not {machine.name}"
        ours, theirs = MachineNumbers(self.machine).by_path, MachineNumbers(machine).by_path
        for path in sorted({*ours, *theirs}):
            if ours.get(path) != theirs.get(path):
                return f"{machine.name} with {path} {ours.get(path, 'missing')}, not {theirs.get(path, 'missing')}"
        return f"{machine.name} with other names or kinds of parts"
