"""Files of a simulation: HDF5, NPZ and CSV."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np

from jointplay.app.errors import OutputError
from jointplay.app.figures.simulation_file import SimulationFile
from jointplay.catalogue.storage.hdf5 import write_arrays
from jointplay.solver.cases.history import MOTIONS


def write_hdf5(path: Path, recording: SimulationFile) -> None:
    """Write arrays with units and attributes."""
    write_arrays(path, recording.arrays, units=recording.units, attributes=recording.attributes)


def write_npz(path: Path, recording: SimulationFile) -> None:
    """Write arrays; units and attributes are JSON texts named ``units`` and ``attributes``."""
    texts = {
        "units": np.array(json.dumps(dict(recording.units))),
        "attributes": np.array(json.dumps(dict(recording.attributes))),
    }
    arrays = {name: np.asarray(array) for name, array in {**recording.arrays, **texts}.items()}
    replace(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))


def write_csv(path: Path, recording: SimulationFile) -> None:
    """Write the time histories of the frame and its sensors, one row an instant; names and units head the columns."""
    names = ["t [s]"]
    columns = [recording.arrays["t"]]
    for name in ("frame_displacement", "frame_velocity", "frame_acceleration"):
        for index, (motion, unit) in enumerate(zip(MOTIONS, recording.units[name].split(","), strict=True)):
            names.append(f"{name}_{motion} [{unit}]")
            columns.append(recording.arrays[name][:, index])
    for name, array in recording.arrays.items():
        if name.startswith("sensor_"):
            names.append(f"{name} [{recording.units[name]}]")
            columns.append(array)
    table = np.column_stack(columns)
    head = ",".join(quote(name) for name in names)
    replace(path, lambda file: np.savetxt(file, table, fmt="%.9g", delimiter=",", header=head, comments=""))


def quote(name: str) -> str:
    """Return a column's name as a CSV field."""
    return '"' + name.replace('"', '""') + '"' if any(mark in name for mark in ',"\n') else name


def replace(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file that takes its name only when it is complete."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as partial:
        try:
            write(partial)
            partial.flush()
            os.chmod(partial.name, 0o644)
            os.replace(partial.name, path)
        except BaseException:
            os.unlink(partial.name)
            raise


WRITERS: dict[str, Callable[[Path, SimulationFile], None]] = {
    ".h5": write_hdf5,
    ".hdf5": write_hdf5,
    ".npz": write_npz,
    ".csv": write_csv,
}


def writer_for(path: Path) -> Callable[[Path, SimulationFile], None]:
    """Return the writer that a file's ending asks for; called before the simulation, so that a typo costs no time.

    Raises
    ------
    OutputError
        For another ending, or a folder that does not exist.
    """
    return WRITERS[check_output(path, tuple(WRITERS), "must end in .h5, .csv or .npz")]


def check_output(path: Path, endings: tuple[str, ...], rule: str) -> str:
    """Return the ending of a file that is to be written, in lower case.

    Raises
    ------
    OutputError
        When it is none of `endings`, or the file's folder does not exist.
    """
    ending = path.suffix.lower()
    if ending not in endings:
        raise OutputError(f"{path}: {rule}")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder, not a file")
    return ending
