"""Entries of the catalogues on offer: pages of them, and single ones in their forms.

The same entry always gives the same bytes. Pages and entity tags come from the mapped matrix; a shard is opened only
for a body that nobody asked for lately.
"""

from __future__ import annotations

import hashlib
import threading
from contextlib import suppress
from dataclasses import dataclass
from math import pi
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from cachetools import LRUCache, cachedmethod

from jointplay.app.errors import BadCursorError, BadFieldError
from jointplay.app.schemas.entries import EntryFilter, EntryItem, EntryLevels, LevelQuery
from jointplay.app.shelves.entry_forms import FORMS, RENDERING, levels_of, micrometres
from jointplay.solver.arrays import BoolArray

if TYPE_CHECKING:
    from jointplay.app.shelves.catalogues import Offer
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.catalogue.storage.table import EntryTable


OPEN_CATALOGUES = 4
KEPT_BYTES = 64_000_000
TAG_BYTES = 3200  # what a tag counts for, beside its body
BLOCK = 2048  # rows of a table made at once


@dataclass(frozen=True)
class Rendered:
    """An entry in one form: its entity tag, and its bytes once somebody needed them."""

    key: str
    body: bytes | None = None


class EntryShelf:
    """Reads entries; keeps the last catalogues open and the last bodies in memory. Safe to use from many threads."""

    def __init__(self) -> None:
        self._open: LRUCache[tuple[str, str], Catalogue] = LRUCache(OPEN_CATALOGUES)
        self._kept: LRUCache[tuple[str, str, str, str], Rendered] = LRUCache(
            KEPT_BYTES, lambda rendered: TAG_BYTES + len(rendered.body or b"")
        )
        self._lock = threading.Lock()
        self._reading = threading.Lock()  # a catalogue keeps its last shard, and belongs to one thread at a time

    def recall(self, offer: Offer, key: str, kind: str) -> Rendered | None:
        """Return what is in memory of an entry in a form; it takes no time."""
        place = (str(offer.path), offer.stamp, key, kind)
        with self._lock:
            return self._kept.get(place)

    def find_tagged(self, offer: Offer, key: str, kind: str) -> Rendered:
        """Return an entry in a form, with a body only if that is in memory; no shard is opened.

        Raises
        ------
        EntryNotFoundError
            When there is none of this key.
        """
        found = self.recall(offer, key, kind)
        if found is None:
            with self._reading:
                shard, position = self._catalogue(offer).address(key)
            content = f"{shard} {position} {kind} {RENDERING}"
            found = self._keep(offer, key, kind, Rendered(hashlib.sha256(content.encode()).hexdigest()[:40]))
        return found

    def whole(self, offer: Offer, key: str, kind: str) -> Rendered:
        """Return an entry in a form with its body.

        Raises
        ------
        EntryNotFoundError
            When there is none of this key.
        CatalogueFileError
            When its shard is damaged.
        """
        found = self.find_tagged(offer, key, kind)
        if found.body is None:
            with self._reading:
                entry = self._catalogue(offer).entry(key)
            found = self._keep(offer, key, kind, Rendered(found.key, FORMS[kind](entry)))
        return found

    def levels(self, offer: Offer, key: str, wanted: LevelQuery) -> EntryLevels:
        """Return the levels of an entry as a quantity and a scaling.

        Raises
        ------
        EntryNotFoundError
            When there is none of this key.
        CatalogueFileError
            When its shard is damaged.
        """
        with self._reading:
            return levels_of(self._catalogue(offer).entry(key), wanted)

    def page(self, offer: Offer, wanted: EntryFilter, after: str | None, size: int) -> tuple[list[EntryItem], bool]:
        """Return entries in the order of the catalogue, and whether there are more.

        Parameters
        ----------
        offer : Offer
        wanted : EntryFilter
        after : str, optional
            Key of the last entry of the page before; it keeps its place when the catalogue grows.
        size : int

        Raises
        ------
        BadCursorError
            When there is no entry of the key `after`.
        BadFieldError
            When the catalogue has no such hypothesis or joint.
        """
        with self._reading:
            catalogue = self._catalogue(offer)
            matrix = catalogue.matrix
            check(wanted, matrix.labels, matrix.joints)
            start = 0 if after is None else following(catalogue, after)
            found: list[EntryItem] = []
            total = len(matrix.every_row)
            while start < total and len(found) <= size:
                table = matrix.table(np.arange(start, min(start + BLOCK, total)))
                rows = np.flatnonzero(fits(table, wanted))[: size + 1 - len(found)]
                found += [item(table, row) for row in rows.tolist()]
                start += BLOCK
        return found[:size], len(found) > size

    def list_failed(self, offer: Offer, size: int) -> tuple[list[EntryItem], int]:
        """Return the first cases of a catalogue that have no spectrum, and how many there are of them."""
        with self._reading:
            matrix = self._catalogue(offer).matrix
            rows = matrix.failed_rows
            table = matrix.table(rows[:size])
        return [item(table, row) for row in range(len(table))], len(rows)

    @cachedmethod(attrgetter("_open"), key=lambda _, offer: (str(offer.path), offer.stamp))
    def _catalogue(self, offer: Offer) -> Catalogue:
        from jointplay.catalogue.storage.store import Catalogue

        return Catalogue.open(offer.path)

    def _keep(self, offer: Offer, key: str, kind: str, rendered: Rendered) -> Rendered:
        place = (str(offer.path), offer.stamp, key, kind)
        with self._lock, suppress(ValueError):  # larger than all that is kept
            self._kept[place] = rendered
        return rendered


def check(wanted: EntryFilter, labels: tuple[str, ...], joints: tuple[str, ...]) -> None:
    """Refuse a hypothesis or joint that the catalogue does not have."""
    for name, given, known in (("hypothesis", wanted.hypothesis, labels), ("joint", wanted.joint, joints)):
        if given is not None and given not in known:
            shown = ", ".join(known[:20]) + (", ..." if len(known) > 20 else "")
            raise BadFieldError(f"{name}: {given[:80]}: must be one of {shown}", field=name)
    least, most = wanted.min_clearance_um, wanted.max_clearance_um
    if least is not None and most is not None and least > most:
        raise BadFieldError(
            f"min_clearance_um: {least:g}: must not be above max_clearance_um, {most:g}", field="min_clearance_um"
        )


def following(catalogue: Catalogue, key: str) -> int:
    """Return the row after an entry."""
    found = catalogue.matrix.find(key) if len(key) == 64 else ()
    if len(found) != 1:
        raise BadCursorError("cursor: is not a cursor of this list", field="cursor")
    return found[0] + 1


def fits(table: EntryTable, wanted: EntryFilter) -> BoolArray:
    """Return which rows of a table are wanted."""
    keep = np.ones(len(table), dtype=np.bool_)
    for name in ("hypothesis", "stratum", "status", "law"):
        value = getattr(wanted, name)
        if value is not None:
            keep &= getattr(table, name) == value
    clearance = table.clearance.max(axis=1, initial=0.0)
    if wanted.joint is not None:
        column = table.joints.index(wanted.joint)
        keep &= table.worn[:, column]
        clearance = table.clearance[:, column]
    shown = np.round(clearance * 1e6, 6)  # as it is shown, so that a shown number finds its entry
    if wanted.min_clearance_um is not None:
        keep &= shown >= wanted.min_clearance_um
    if wanted.max_clearance_um is not None:
        keep &= shown <= wanted.max_clearance_um
    return keep


def item(table: EntryTable, row: int) -> EntryItem:
    """Return what a list says about an entry."""
    clearances = zip(table.joints, table.clearance[row].tolist(), strict=True)
    return EntryItem(
        key=str(table.key[row]),
        hypothesis=str(table.hypothesis[row]),
        worn=list(table.worn_of(row)),
        clearances_um={joint: micrometres(clearance) for joint, clearance in clearances if clearance > 0},
        status=str(table.status[row]),
        message=str(table.message[row]),
        stratum=str(table.stratum[row]),
        law=str(table.law[row]),
        draw=int(table.draw[row]),
        drive_speed_rpm=float(table.drive_speed[row]) * 30 / pi,
    )
