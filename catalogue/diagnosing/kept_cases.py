"""Cases that were simulated for one machine, kept as files in the folder of its catalogue: none is simulated twice."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from jointplay.catalogue.diagnosing.found_cases import simulate_cases
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.matching.modelfile import read_arrays, write_arrays
from jointplay.catalogue.plans.entry import Entry, content_digest
from jointplay.catalogue.storage.matrix_header import MATRIX_VERSION
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.machine import Machine

KEPT = 2048
"""Files of single machines that a catalogue keeps, those used last: some 3 MB for each set of joints of a machine at a
speed, so that a hundred machines of four joints have theirs."""


def simulate_once(
    catalogue: Catalogue, machine: Machine, cases: Sequence[Entry], progress: Callable[[int], None] | None = None
) -> FoundSpectra:
    """Return what :func:`~jointplay.catalogue.diagnosing.found_cases.simulate_cases` does, from a file if there is one.

    The same numbers either way; a file that cannot be read, or written, only costs time.

    Parameters
    ----------
    catalogue, machine, cases, progress
        As there; nothing is called where there is a file.

    Returns
    -------
    FoundSpectra
        Whose ``id`` says which cases they are.
    """
    matrix, folder = catalogue.matrix, catalogue.layout.machines
    key = content_digest([MATRIX_VERSION, [entry.key for entry in cases], list(matrix.cuts)])
    name = f"cases-{key[:32]}"
    kept = _read(folder, name, len(cases))
    if kept is None:
        found = simulate_cases(catalogue, machine, cases, progress)
        places = {entry.key: place for place, entry in enumerate(cases)}
        kept = np.array([places[entry.key] for entry in found.entries], np.int64), found.spectra
        with suppress(CatalogueFileError):
            write_arrays(folder, name, {"rows": kept[0], "spectra": kept[1]}, KEPT)
    rows, spectra = kept
    entries = tuple(cases[row] for row in rows.tolist())
    return FoundSpectra(matrix, entries, spectra, id=key)


def _read(folder: Path, name: str, count: int) -> tuple[IntArray, FloatArray] | None:
    """Which of so many cases could be simulated (n,), and their spectra (n, G, 33); None where that is not known."""
    found = read_arrays(folder, name)
    if found is None or found.keys() != {"rows", "spectra"}:
        return None
    rows, spectra = found["rows"], found["spectra"]
    if len(rows) != len(spectra) or (len(rows) and not 0 <= rows.min() <= rows.max() < count):
        return None
    with suppress(OSError):  # in a folder that cannot be written
        os.utime(folder / f"{name}.npz")
    return rows, spectra
