"""HDF5 files: what `jointplay simulate` writes, files of named arrays, MAT files of version 7.3."""

from __future__ import annotations

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.arrays import recording_of
from jointplay.catalogue.measurements.readers.raw import Limits, RawRecording


def read_hdf5(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the arrays of an HDF5 file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    from jointplay.catalogue.storage.hdf5 import foreign_arrays

    try:
        arrays, units = foreign_arrays(data, limits.decoded_bytes)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise MeasurementError(source, rule=f"cannot be read as HDF5: {error}") from None
    return recording_of(arrays, units, source, limits, ("HDF5 file",))
