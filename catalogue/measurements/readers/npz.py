"""NPZ files: named arrays of numpy; nothing that would have to be executed is read."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from typing import Any

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.arrays import recording_of
from jointplay.catalogue.measurements.readers.raw import Limits, RawRecording


def read_npz(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the arrays of an NPZ file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    arrays: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(member.file_size for member in packed.infolist()) > limits.decoded_bytes:
                rule = f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
                raise MeasurementError(source, rule=rule)
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            for name in held.files:
                array = held[name]
                arrays[name] = [str(each) for each in array.reshape(-1)] if array.dtype.kind in "US" else array
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, KeyError, zlib.error, RuntimeError) as error:
        # RuntimeError is how zipfile refuses encrypted members, and compression that it does not know.
        raise MeasurementError(source, rule=f"is a damaged or foreign NPZ file: {error}") from None
    # What `jointplay simulate` adds as texts.
    units, attributes = _document(arrays.pop("units", None)), _document(arrays.pop("attributes", None))
    arrays.update({name: np.array(value) for name, value in attributes.items() if type(value) in (int, float)})
    texts = {name: value for name, value in units.items() if isinstance(value, str)}
    return recording_of(arrays, texts, source, limits, ("NPZ file",))


def _document(texts: Any) -> dict[str, Any]:
    if not (isinstance(texts, list) and len(texts) == 1):
        return {}
    try:
        found = json.loads(texts[0])
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
