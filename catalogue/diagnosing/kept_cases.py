"""Cases that were simulated for one machine, kept as files in the folder of its catalogue: none is simulated twice."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from jointplay.catalogue.diagnosing.found_cases import simulate_cases
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.matching.modelfile import age_key
from jointplay.catalogue.plans.entry import Entry, content_digest
from jointplay.catalogue.storage.directory import publish
from jointplay.catalogue.storage.matrix_header import MATRIX_VERSION
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.machine import Machine

KEPT = 512
"""Files of single machines that a catalogue keeps, those used last: some 2 MB for each set of joints of a machine."""


def simulate_once(catalogue: Catalogue, machine: Machine, cases: Sequence[Entry]) -> FoundSpectra:
    """Return what :func:`~jointplay.catalogue.diagnosing.found_cases.simulate_cases` does, from a file if there is one.

    The same numbers either way; a file that cannot be read, or written, only costs time.

    Parameters
    ----------
    catalogue : Catalogue
    machine : Machine
        Of the cases.
    cases : sequence of Entry
        One at least.

    Returns
    -------
    FoundSpectra
        Whose ``id`` says which cases they are.
    """
    matrix = catalogue.matrix
    key = content_digest([MATRIX_VERSION, [entry.key for entry in cases], list(matrix.cuts)])
    file = catalogue.layout.machines / f"cases-{key[:32]}.npz"
    kept = _read(file, len(cases))
    if kept is None:
        found = simulate_cases(catalogue, machine, cases)
        places = {entry.key: place for place, entry in enumerate(cases)}
        kept = np.array([places[entry.key] for entry in found.entries], np.int64), found.spectra
        _write(file, *kept)
    rows, spectra = kept
    entries = tuple(cases[row] for row in rows.tolist())
    return FoundSpectra(matrix, entries, spectra, id=key)


def _read(file: Path, count: int) -> tuple[IntArray, FloatArray] | None:
    """Which of so many cases could be simulated (n,), and their spectra (n, G, 33); None where that is not known."""
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as found:
            rows, spectra = found["rows"], found["spectra"]
        if len(rows) != len(spectra) or (len(rows) and not 0 <= rows.min() <= rows.max() < count):
            return None
        with suppress(OSError):  # in a folder that cannot be written
            os.utime(file)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        return None
    return rows, spectra


def _write(file: Path, rows: IntArray, spectra: FloatArray) -> None:
    """Write a file, and delete those that have not been used for long."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, rows=rows, spectra=spectra)
    with suppress(OSError, CatalogueFileError):
        file.parent.mkdir(parents=True, exist_ok=True)
        publish(file, content.getvalue())
        for old in sorted(file.parent.glob("*.npz"), key=age_key)[:-KEPT]:
            old.unlink(missing_ok=True)
