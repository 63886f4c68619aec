"""Readers of recordings, one a kind of file, found by content and by ending."""

from __future__ import annotations

from typing import Any

from jointplay.catalogue.measurements.readers.cell import CELL
from jointplay.catalogue.measurements.readers.kinds import TEXT, ending_for, kind_of, known_ending
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording, Reader, SpectrumForm, check
from jointplay.catalogue.measurements.readers.unpacking import PACKED, beginning_of

__all__ = ["Limits", "RawColumn", "RawRecording", "Reader", "SpectrumForm", "ending_for", "known_ending", "read_raw"]


def read_raw(data: bytes, source: str, limits: Limits, **table: Any) -> RawRecording:
    """Read a file in a capped process; what comes back is checked.

    Parameters
    ----------
    data : bytes
        As it is, or gzipped.
    source : str
        Its name, whose ending says what kind of file it is where the content does not.
    limits : Limits
    **table
        What is known of a table of text; see :func:`jointplay.catalogue.measurements.readers.csv.read_csv`.

    Raises
    ------
    MeasurementError
    """
    if data.startswith(PACKED) or source.lower().endswith(".gz"):
        known_ending(source)  # what is not read anyway need not be unpacked
    kind = kind_of(beginning_of(data, source), source)
    return check(CELL.read(kind, data, source, limits, table if kind is TEXT else {}), limits)
