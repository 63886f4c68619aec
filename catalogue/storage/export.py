"""A catalogue as one file for other programs: HDF5, NumPy's NPZ, or a table in CSV."""

from __future__ import annotations

import csv
import json
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.errors import EntryNotFoundError
from jointplay.catalogue.storage.cross_power import CHANNELS, CYCLIC, PACKED
from jointplay.catalogue.storage.directory import replacing
from jointplay.catalogue.storage.hdf5 import write_growing
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.table import EntryTable
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.spectra.bands import LEAST_POWER

_UNITS = {
    "band_edges": "orders",
    "clearance": "m",
    "parameters": "SI",
    "drive_speed": "rad/s",
    "transient": "s",
    "guard_db": "dB",
    "power": "x, y: m/s2; theta: rad/s2; their products",
    "spread_db": "dB",
    "cyclic": "x, y: m/s2; theta: rad/s2; their products",
}


@dataclass(frozen=True, eq=False)
class _Chosen:
    """The cases of some hypotheses, in the order in which their shards hold them."""

    catalogue: Catalogue
    rows: IntArray

    @classmethod
    def of(cls, catalogue: Catalogue, hypotheses: Sequence[str] | None) -> _Chosen:
        matrix = catalogue.matrix
        rows = matrix.every_row
        if hypotheses is not None:
            for label in hypotheses:
                if label not in matrix.labels:
                    raise EntryNotFoundError(label)
            rows = rows[np.isin(matrix.table(rows).hypothesis, hypotheses)]
        places = matrix.places(rows)
        first = np.full(places[:, 0].max(initial=0) + 1, matrix.every_row.size)
        np.minimum.at(first, places[:, 0], rows)  # shards in the order of their first rows: by hypothesis and draw
        return cls(catalogue, rows[np.lexsort((places[:, 1], first[places[:, 0]]))])

    @cached_property
    def table(self) -> EntryTable:
        """What the cases are."""
        return self.catalogue.matrix.table(self.rows)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything but the spectra."""
        table = self.table
        parameters = np.array(list(table.parameters.values())).reshape(len(table.parameters), len(table)).T
        columns = ("key", "hypothesis", "status", "message", "stratum", "law", "draw", "speed", "drive_speed")
        return {
            "band_edges": np.array(self.catalogue.scheme.edges),
            "joints": np.array(table.joints),
            "parameter_names": np.array(list(table.parameters), dtype=np.str_),
            "power_columns": np.array(PACKED),
            "cyclic_columns": np.array(CYCLIC),
            **{name: getattr(table, name) for name in (*columns, "segments", "period", "transient", "guard_db")},
            "clearance": table.clearance,
            "worn": table.worn,
            "parameters": parameters,
        }

    def attributes(self) -> dict[str, str]:
        """What the catalogue is."""
        manifest = self.catalogue.manifest
        return {
            "format": "jointplay catalogue export",
            "catalogue": self.catalogue.id,
            "machine": manifest.machine_content,
            "recipe": json.dumps(manifest.recipe.content),
            "plan": json.dumps(manifest.plan.content),
            "numbers_version": str(manifest.numbers_version),
            "versions": json.dumps(dict(manifest.versions)),
            "units": json.dumps(_UNITS),
        }

    def spectra(self) -> Iterator[dict[str, NDArray[np.float32]]]:
        """Packed spectra, their spread and cyclic powers, shard by shard; NaN for a case that failed."""
        for shard, positions in self.catalogue.parts(self.rows):
            row = shard.row[positions]
            found = {}
            for name, (_, *shape) in self.shapes.items():
                found[name] = np.full((len(row), *shape), np.nan, np.float32)
                found[name][row >= 0] = getattr(shard, name)[row[row >= 0]]
            yield found

    @property
    def shapes(self) -> dict[str, tuple[int, int, int]]:
        """Of spectra, their spread, and cyclic powers."""
        count, bands, groups = len(self.rows), self.catalogue.scheme.count, len(self.catalogue.matrix.cuts) - 1
        return {
            "power": (count, bands, len(PACKED)),
            "spread_db": (count, bands, 3),
            "cyclic": (count, groups, len(CYCLIC)),
        }


def export(catalogue: Catalogue, path: str | Path, hypotheses: Sequence[str] | None = None) -> int:
    """Write a catalogue, or some of its hypotheses, into one file, which takes its name when it is complete.

    HDF5 and NPZ hold everything: the table, and full spectra with their spread (NaN where a case failed). CSV is one
    row a case: what it is, and levels of x, y and theta in feature bands [dB re 1 (m/s2)^2, 1 (rad/s2)^2]. Memory holds
    one shard and the table.

    Parameters
    ----------
    catalogue : Catalogue
    path : str or Path
        Its ending, one of :data:`ENDINGS`, says the format.
    hypotheses : sequence of str, optional
        Labels; all by default.

    Returns
    -------
    int
        Number of cases written.

    Raises
    ------
    KeyError
        Another ending.
    EntryNotFoundError
        A hypothesis of which there is no case.
    CatalogueFileError
        A shard is damaged, or the file cannot be written.
    """
    path = Path(path)
    write = _WRITERS[path.suffix.lower()]
    chosen = _Chosen.of(catalogue, hypotheses)
    with replacing(path) as partial:
        write(partial, chosen)
    return len(chosen.rows)


def _write_hdf5(path: Path, chosen: _Chosen) -> None:
    write_growing(path, chosen.arrays(), chosen.shapes, chosen.spectra(), units=_UNITS, attributes=chosen.attributes())


def _write_npz(path: Path, chosen: _Chosen) -> None:
    texts = {"attributes": np.array(json.dumps(chosen.attributes())), "units": np.array(json.dumps(_UNITS))}
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in {**chosen.arrays(), **texts}.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
        for name, shape in chosen.shapes.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                head = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, head)
                for part in chosen.spectra():
                    file.write(np.ascontiguousarray(part[name], "<f4").tobytes())


def _write_csv(path: Path, chosen: _Chosen) -> None:
    matrix, table = chosen.catalogue.matrix, chosen.table
    bands = [f"order {low:g} to {high:g}" for low, high in zip(matrix.edges[:-1], matrix.edges[1:], strict=True)]
    head = [
        *("key", "hypothesis", "status", "message", "stratum", "law", "draw", "drive speed [rad/s]"),
        *(f"clearance {joint} [m]" for joint in table.joints),
        *(f"{name} [SI]" for name in table.parameters),
        *(f"{channel} {band} [dB]" for channel in CHANNELS for band in bands),
    ]
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        for start in range(0, len(chosen.rows), 256):
            rows = chosen.rows[start : start + 256]
            part = table.rows(np.arange(start, start + len(rows)))
            levels = _levels(chosen.catalogue, rows)
            for i in range(len(rows)):
                numbers = [part.drive_speed[i], *part.clearance[i], *(column[i] for column in part.parameters.values())]
                texts = (part.key[i], part.hypothesis[i], part.status[i], part.message[i], part.stratum[i], part.law[i])
                shown = (f"{level:.3f}" if np.isfinite(level) else "" for level in levels[i])
                writer.writerow([*texts, part.draw[i], *(f"{number:.9g}" for number in numbers), *shown])


def _levels(catalogue: Catalogue, rows: IntArray) -> FloatArray:
    """Levels (m, 3 G) of x, then y, then theta in feature bands; NaN for a case that failed."""
    matrix = catalogue.matrix
    levels = np.full((len(rows), 3, len(matrix.edges) - 1), np.nan)
    good = rows < len(matrix)
    power = np.maximum(matrix.packed(rows[good])[..., :3].astype(np.float64), LEAST_POWER)
    levels[good] = np.swapaxes(10.0 * np.log10(power), 1, 2)
    return levels.reshape(len(rows), -1)


_WRITERS: dict[str, Callable[[Path, _Chosen], None]] = {
    ".h5": _write_hdf5,
    ".hdf5": _write_hdf5,
    ".npz": _write_npz,
    ".csv": _write_csv,
}

ENDINGS = tuple(_WRITERS)
"""Of the files that can be written."""
