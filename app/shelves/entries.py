"""Entries of the catalogues on offer: pages of them, and single ones as JSON, CSV, HDF5 or NPY.

The same entry always gives the same bytes. Pages and entity tags come from the mapped matrix; a shard is opened only
for a body that nobody asked for lately.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import pi
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from cachetools import LRUCache, cachedmethod

from jointplay.app.errors import BadCursorError, BadFieldError
from jointplay.app.schemas.entries import (
    ComplexSeries,
    EntryDetail,
    EntryFilter,
    EntryItem,
    EntryLevels,
    EntrySpectrum,
    LevelQuery,
)
from jointplay.solver.arrays import BoolArray
from jointplay.solver.spectra.spectrum import frame_units, value_units

if TYPE_CHECKING:
    from jointplay.app.shelves.catalogues import Offer
    from jointplay.catalogue.storage.store import Catalogue, StoredEntry
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


RENDERING = 1
"""Raised when a form changes: entity tags rest on it."""

QUANTITY = "mean square of the frame's acceleration in each band"
POINT = "centre of gravity of the frame"


def spectrum_of(entry: StoredEntry) -> EntrySpectrum | None:
    """Return the spectrum in its JSON shape; ``None`` where the case failed."""
    from jointplay.catalogue.storage.cross_power import CHANNELS, UNITS

    if entry.power is None or entry.spread_db is None:
        return None
    pairs = [(i, j) for i in range(3) for j in range(i + 1, 3)]
    return EntrySpectrum(
        quantity=QUANTITY,
        point=POINT,
        units=dict(zip(CHANNELS, UNITS, strict=True)),
        band_edges_orders=list(entry.scheme.edges),
        power={name: exact(entry.power[:, i, i].real) for i, name in enumerate(CHANNELS)},
        cross_power={
            f"{CHANNELS[i]} {CHANNELS[j]}": ComplexSeries(
                re=exact(entry.power[:, i, j].real), im=exact(entry.power[:, i, j].imag)
            )
            for i, j in pairs
        },
        spread_db={name: exact(entry.spread_db[:, i]) for i, name in enumerate(CHANNELS)},
    )


def levels_of(entry: StoredEntry, wanted: LevelQuery) -> EntryLevels:
    """Return the levels of an entry as a quantity and a scaling; none where the case failed."""
    from jointplay.catalogue.storage.cross_power import CHANNELS

    found = None
    if entry.power is not None:
        power = np.einsum("bcc->bc", entry.power).real.astype(np.float64)
        values = entry.scheme.scale(power, entry.drive_speed, wanted.quantity, wanted.scaling)
        found = {name: exact(values[:, i]) for i, name in enumerate(CHANNELS)}
    units = value_units(frame_units(CHANNELS, wanted.quantity), wanted.scaling)
    return EntryLevels(
        key=entry.key,
        quantity=wanted.quantity,
        scaling=wanted.scaling,
        point=POINT,
        units=dict(zip(CHANNELS, units, strict=True)),
        drive_speed_rpm=entry.drive_speed * 30 / pi,
        band_edges_orders=list(entry.scheme.edges),
        levels=found,
    )


def exact(numbers: npt.NDArray[np.floating[Any]]) -> list[float]:
    """Return numbers of single precision in the shortest form that reads back."""
    return [float(str(number)) for number in numbers.astype(np.float32)]


def detail_of(entry: StoredEntry) -> EntryDetail:
    """Return everything about an entry in its JSON shape."""
    return EntryDetail(
        key=entry.key,
        hypothesis=entry.hypothesis,
        worn=list(entry.worn),
        clearances_um={joint: micrometres(clearance) for joint, clearance in entry.clearances.items()},
        status=entry.status,
        message=entry.message,
        stratum=entry.stratum,
        law=entry.law,
        draw=entry.draw,
        drive_speed_rpm=entry.drive_speed * 30 / pi,
        parameters=dict(entry.parameters),
        segments=entry.segments,
        transient_s=finite(entry.transient),
        guard_db=entry.guard_db,
        spectrum=spectrum_of(entry),
    )


def micrometres(clearance: float) -> float:
    """Return a clearance in micrometres, to the thousandth of a nanometre."""
    return round(clearance * 1e6, 6)


def finite(number: float) -> float | None:
    """Return a number, or ``None`` for one that JSON cannot hold."""
    return number if np.isfinite(number) else None


def as_json(entry: StoredEntry) -> bytes:
    """Return an entry as JSON."""
    return detail_of(entry).model_dump_json().encode()


def as_npy(entry: StoredEntry) -> bytes:
    """Return the bands as a structured array, one a row; none where the case failed."""
    stream = io.BytesIO()
    np.save(stream, table_of(entry), allow_pickle=False)
    return stream.getvalue()


def table_of(entry: StoredEntry) -> npt.NDArray[np.void]:
    """Return edges [orders], cross-power and spread [dB] of the bands, one a row."""
    row = [("order_low", "<f8"), ("order_high", "<f8"), ("power", "<c8", (3, 3)), ("spread_db", "<f4", (3,))]
    table = np.zeros(0 if entry.power is None else entry.scheme.count, dtype=row)
    if len(table):
        table["order_low"], table["order_high"] = entry.scheme.edges[:-1], entry.scheme.edges[1:]
        table["power"], table["spread_db"] = entry.power, entry.spread_db
    return table


def as_csv(entry: StoredEntry) -> bytes:
    """Return the bands as a table with units in its head; only the head where the case failed."""
    from jointplay.catalogue.storage.cross_power import CHANNELS, PACKED, UNITS, pack

    motion = {"x": "m/s2", "y": "m/s2", "theta": "rad/s2"}
    products = [f"({motion[name.split()[-2]]})({motion[name.split()[-1]]})" for name in PACKED[3:]]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(
        [
            *("order low", "order high", "frequency low [Hz]", "frequency high [Hz]"),
            *(f"power {name} [{unit}]" for name, unit in zip(CHANNELS, UNITS, strict=True)),
            *(f"{name} [{unit}]" for name, unit in zip(PACKED[3:], products, strict=True)),
            *(f"spread {name} [dB]" for name in CHANNELS),
        ]
    )
    table, hertz = table_of(entry), abs(entry.drive_speed) / (2 * pi)
    for row, packed in zip(table, pack(table["power"]), strict=True):
        edges = (float(row["order_low"]), float(row["order_high"]))
        writer.writerow([*edges, *(edge * hertz for edge in edges), *exact(packed), *exact(row["spread_db"])])
    return text.getvalue().encode()


def as_hdf5(entry: StoredEntry) -> bytes:
    """Return an entry as HDF5: arrays with their units, all else as attributes."""
    from jointplay.catalogue.storage.cross_power import CHANNELS, UNITS
    from jointplay.catalogue.storage.hdf5 import arrays_image

    arrays: dict[str, npt.NDArray[Any]] = {
        "band_edges": np.array(entry.scheme.edges),
        "joints": np.array(list(entry.clearances), dtype=np.str_),
        "clearance": np.array(list(entry.clearances.values()), dtype=np.float64),
        "parameter_names": np.array(list(entry.parameters), dtype=np.str_),
        "parameters": np.array(list(entry.parameters.values()), dtype=np.float64),
    }
    if entry.power is not None and entry.spread_db is not None:
        arrays |= {"power": entry.power, "spread_db": entry.spread_db}
    return arrays_image(
        arrays,
        units={"band_edges": "orders", "clearance": "m", "parameters": "SI"}
        | ({"power": ", ".join(UNITS), "spread_db": "dB"} if "power" in arrays else {}),
        attributes={
            "format": "jointplay entry",
            "key": entry.key,
            "hypothesis": entry.hypothesis,
            "worn": json.dumps(list(entry.worn)),
            "status": entry.status,
            "message": entry.message,
            "stratum": entry.stratum,
            "law": entry.law,
            "draw": entry.draw,
            "drive_speed_rad_per_s": entry.drive_speed,
            "segments": entry.segments,
            "transient_s": entry.transient,
            "guard_db": float("nan") if entry.guard_db is None else entry.guard_db,
            "quantity": QUANTITY,
            "point": POINT,
            "channels": CHANNELS,
        },
    )


FORMS: dict[str, Callable[[StoredEntry], bytes]] = {
    "application/json": as_json,
    "text/csv": as_csv,
    "application/x-hdf5": as_hdf5,
    "application/x-npy": as_npy,
}
"""By media type, the usual one first."""
