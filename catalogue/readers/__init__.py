"""Readers of recordings, one a kind of file, found by suffix."""

from __future__ import annotations

from pathlib import PurePath

from catalogue.errors import MeasurementError
from catalogue.readers.csv import read_csv
from catalogue.readers.raw import Limits, RawColumn, RawRecording, Reader

__all__ = ["READERS", "Limits", "RawColumn", "RawRecording", "Reader", "reader_for"]

#: Suffix in small letters to reader; a new kind of file is a new row.
READERS: dict[str, Reader] = {".csv": read_csv, ".tsv": read_csv, ".txt": read_csv}


def reader_for(name: str) -> Reader:
    """Reader for a file of this name; ``.gz`` at its end does not count.

    Parameters
    ----------
    name : str

    Returns
    -------
    Reader

    Raises
    ------
    MeasurementError
        When no reader has the suffix.
    """
    path = PurePath(name)
    suffix = path.suffix.lower()
    if suffix == ".gz":
        suffix = PurePath(path.stem).suffix.lower()
    if suffix not in READERS:
        known = ", ".join(sorted(READERS))
        raise MeasurementError(name, rule=f"kind of file {suffix or 'without suffix'!s} is not read; known: {known}")
    return READERS[suffix]
