"""Readers of recordings, one a kind of file, found by content and by ending."""

from __future__ import annotations

from typing import Any

from jointplay.catalogue.measurements.readers.cell import CELL
from jointplay.catalogue.measurements.readers.csv import read_csv
from jointplay.catalogue.measurements.readers.kinds import ending_for, kind_of, known_ending
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording, Reader, SpectrumForm, check

__all__ = ["Limits", "RawColumn", "RawRecording", "Reader", "SpectrumForm", "ending_for", "known_ending", "read_raw"]


def read_raw(data: bytes, source: str, limits: Limits, **table: Any) -> RawRecording:
    """Read a file: a table of text here, everything else in a capped process; what comes back is checked.

    Parameters
    ----------
    data : bytes
        Decompressed.
    source : str
        Its name, whose ending says what kind of file it is where the content does not.
    limits : Limits
    **table
        What is known of a table of text; see :func:`jointplay.catalogue.measurements.readers.csv.read_csv`.

    Raises
    ------
    MeasurementError
    """
    kind = kind_of(data, source)
    raw = read_csv(data, source, limits, **table) if kind is None else CELL.read(kind, data, source, limits)
    return check(raw, limits)
