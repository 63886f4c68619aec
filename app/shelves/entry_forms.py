"""One entry of a catalogue as JSON, CSV, HDF5 or NPY, and its levels as another quantity."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from jointplay.app.schemas.entries import ComplexSeries, EntryDetail, EntryLevels, EntrySpectrum, LevelQuery
from jointplay.solver.spectra.spectrum import frame_units, value_units

if TYPE_CHECKING:
    from jointplay.catalogue.storage.store import StoredEntry


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
        period=entry.period,
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
            "period": entry.period,
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
