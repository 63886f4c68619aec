"""The catalogues the service offers: those found in one directory."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointplay.app.errors import AppError, DamagedCatalogueError, UnknownCatalogueError
from jointplay.app.schemas.resources import CatalogueDetail, SensorItem
from jointplay.catalogue.errors import CatalogueError
from jointplay.catalogue.storage.directory import CatalogueDirectory

if TYPE_CHECKING:
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.machines.machine import Machine

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Offer:
    """One catalogue as it was when it was last looked at.

    Parameters
    ----------
    path : Path
        Its folder.
    stamp : str
        Changes when its files do.
    machine : Machine
        Whose spectra it holds.
    description : CatalogueDetail
        What the service says about it.
    """

    path: Path
    stamp: str
    machine: Machine
    description: CatalogueDetail

    @cached_property
    def document(self) -> dict[str, Any]:
        """The machine as JSON values."""
        document: dict[str, Any] = json.loads(self.machine.canonical_json())
        return document


@dataclass(frozen=True)
class Damage:
    """A catalogue that cannot be used.

    Parameters
    ----------
    name : str
        Of its folder.
    reason : str
        In one line.
    """

    name: str
    reason: str


class CatalogueShelf:
    """Finds catalogues and remembers their descriptions until they change.

    Parameters
    ----------
    directory : Path
        Holds one folder for each catalogue, or is a catalogue itself.
    missing : callable, optional
        Returns why there is no catalogue of a name, from the name and the error for one that never was.
    """

    def __init__(self, directory: Path, missing: Callable[[str, AppError], AppError] = lambda _, never: never) -> None:
        self._directory = directory
        self._missing = missing
        self._offers: dict[Path, Offer] = {}
        self._damages: dict[Path, Damage] = {}
        self._lock = threading.Lock()

    def offers(self) -> list[Offer]:
        """Return all catalogues that can be used, by name."""
        return [each for each in self._found() if isinstance(each, Offer)]

    def damages(self) -> list[Damage]:
        """Return all catalogues that cannot be used, by name, with the reason."""
        return [each for each in self._found() if isinstance(each, Damage)]

    def _found(self) -> Iterator[Offer | Damage]:
        for path in self._paths():
            try:
                yield self._look(path)
            except CatalogueError as error:
                yield self._note(path, str(error))

    def _note(self, path: Path, reason: str) -> Damage:
        """Remember a catalogue that cannot be used; it is logged once, not at every look."""
        damage = Damage(path.name, reason)
        with self._lock:
            known = self._damages.get(path)
            self._damages[path] = damage
        if known != damage:
            log.warning("catalogue %s is damaged: %s", path.name, reason)
        return damage

    def find(self, name: str) -> Offer:
        """Return the catalogue of an id or folder name.

        Raises
        ------
        UnknownCatalogueError
            When there is none.
        DamagedCatalogueError
            When there is one of this name that cannot be used.
        """
        known = self.find_unchanged(name)
        if known is not None:
            return known
        for each in self._found():
            if isinstance(each, Damage):
                if name == each.name:
                    raise DamagedCatalogueError(f"catalogue: {name}: is damaged: {each.reason}", field="catalogue")
            elif name in (each.description.id, each.description.name):
                return each
        unknown = UnknownCatalogueError(f"catalogue: {name[:80]}: there is none of this id or name", field="catalogue")
        raise self._missing(name, unknown)

    def place_of(self, name: str) -> tuple[str, tuple[str, str]]:
        """Return the id of the catalogue of an id or folder name, and its folder and stamp; raises as :meth:`find`."""
        offer = self.find(name)
        return offer.description.id, (str(offer.path), offer.stamp)

    def find_unchanged(self, name: str) -> Offer | None:
        """Return the catalogue of an id or folder name if it was looked at before and is as it was; a few stats."""
        with self._lock:
            known = [each for each in self._offers.values() if name in (each.description.id, each.description.name)]
        return next((each for each in known if stamp_of(each.path) == each.stamp), None)

    def _paths(self) -> list[Path]:
        if CatalogueDirectory(self._directory).manifest.is_file():
            return [self._directory]
        if not self._directory.is_dir():
            return []
        found = (path for path in self._directory.iterdir() if not path.name.startswith("."))  # one that is deleted
        return sorted(path for path in found if CatalogueDirectory(path).manifest.is_file())

    def _look(self, path: Path) -> Offer:
        stamp = stamp_of(path)
        with self._lock:
            offer = self._offers.get(path)
        if offer is None or offer.stamp != stamp:
            offer = describe(path, stamp)
            with self._lock:
                self._offers[path] = offer
                self._damages.pop(path, None)
        return offer


def stamp_of(path: Path) -> str:
    """Return a text that changes when the catalogue does: at the end of a build, and all the time during the first."""
    directory = CatalogueDirectory(path)
    grows = directory.matrices if directory.matrices.exists() else directory.shards
    files = [file for file in (directory.manifest, grows, directory.quality) if file.exists()]
    return ";".join(f"{file.name}:{file.stat().st_mtime_ns}" for file in files)


def describe(path: Path, stamp: str) -> Offer:
    """Open a catalogue and say what is in it.

    Raises
    ------
    CatalogueError
        When it cannot be opened.
    """
    from jointplay.catalogue.storage.store import Catalogue

    catalogue = Catalogue.open(path)
    return Offer(path, stamp, catalogue.machine, describe_open(catalogue, path.name))


def describe_open(catalogue: Catalogue, name: str) -> CatalogueDetail:
    """Return the description of an open catalogue under a name."""
    from jointplay.catalogue.diagnosing.quality_card import kept_card

    machine = catalogue.machine
    speed = getattr(machine.drive, "speed", None)
    return CatalogueDetail(
        id=catalogue.id,
        name=name,
        machine=machine.name,
        machine_content_key=machine.content_key,
        hypotheses=list(catalogue.hypotheses),
        entries=len(catalogue.matrix),
        turning_joints=list(machine.turning_joints),
        sensors=[
            SensorItem(name=sensor.name, at_m=sensor.at, direction=sensor.direction) for sensor in machine.sensors
        ],
        nominal_speed_rpm=abs(speed) * 30 / pi if isinstance(speed, float) else None,
        plan=catalogue.plan.model_dump(mode="json"),
        statuses=catalogue.matrix.statuses(),
        quality=kept_card(catalogue),
    )
