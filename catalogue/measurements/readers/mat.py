"""MAT files up to version 7.2 by scipy, 7.3 (which is HDF5) by the module that holds h5py."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.arrays import recording_of
from jointplay.catalogue.measurements.readers.raw import Limits, RawRecording

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_COMPRESSED = 15


def read_mat(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read a MAT file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    if data[512:520] == HDF5_SIGNATURE or data.startswith(HDF5_SIGNATURE):
        from jointplay.catalogue.measurements.readers.hdf5_file import read_hdf5

        return read_hdf5(data, source, limits)
    if data.startswith(b"MATLAB 5.0"):
        check_elements(data, source, limits)
    import scipy.io

    try:
        stream: Any = io.BytesIO(data)  # scipy's stubs know paths only
        held = scipy.io.loadmat(stream, squeeze_me=False, struct_as_record=True, chars_as_strings=True)
    except Exception as error:  # scipy raises whatever its parser stumbles over
        raise MeasurementError(source, rule=f"is a damaged MAT file: {error}") from None
    arrays: dict[str, Any] = {}
    for name, value in held.items():
        if not name.startswith("__"):
            _flatten(name, value, arrays)
    return recording_of(arrays, {}, source, limits, ("MAT file up to version 7.2",))


def check_elements(data: bytes, source: str, limits: Limits) -> None:
    """Walk through the elements of a version 5 file: all of them whole, and not too large when unpacked.

    Raises
    ------
    MeasurementError
    """
    order = ">" if data[126:128] == b"MI" else "<"
    place, unpacked = 128, 0
    while place < len(data):
        if place + 8 > len(data):
            raise MeasurementError(source, rule="is truncated: it ends within the head of an element")
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if place + 8 + size > len(data):
            rule = f"is truncated: an element of {size} bytes, {len(data) - place - 8} are there"
            raise MeasurementError(source, rule=rule)
        if kind == _COMPRESSED:
            unpacked += _unpacked(data[place + 8 : place + 8 + size], limits.decoded_bytes - unpacked, source)
        else:
            unpacked += size
        if unpacked > limits.decoded_bytes:
            rule = f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
            raise MeasurementError(source, rule=rule)
        place += 8 + size


def _unpacked(packed: bytes, most: int, source: str) -> int:
    """Size of a compressed element, counted no further than the limit."""
    stream, total = zlib.decompressobj(), 0
    try:
        rest = packed
        while rest and not stream.eof and total <= most:
            total += len(stream.decompress(rest, 1 << 20))
            rest = stream.unconsumed_tail
    except zlib.error as error:
        raise MeasurementError(source, rule=f"is a damaged MAT file: {error}") from None
    if not stream.eof and total <= most:
        raise MeasurementError(source, rule="is a damaged MAT file: a compressed element has no end")
    return total


def _flatten(name: str, value: Any, into: dict[str, Any], depth: int = 0) -> None:
    """Members of structures under dotted names; cells of text become lists."""
    array = np.asarray(value)
    if array.dtype.names and array.size == 1 and depth < 4:
        for member in array.dtype.names:
            _flatten(f"{name}.{member}", array.reshape(-1)[0][member], into, depth + 1)
    elif array.dtype.kind in "US":
        texts = [str(each) for each in array.reshape(-1)]
        into[name] = texts[0] if len(texts) == 1 else texts
    elif array.dtype.kind == "O":
        cells = [np.asarray(each) for each in array.reshape(-1)]
        if cells and all(cell.dtype.kind in "US" for cell in cells):
            into[name] = [str(cell.reshape(-1)[0]) if cell.size else "" for cell in cells]
    elif array.dtype.kind in "iufc":
        into[name] = array
