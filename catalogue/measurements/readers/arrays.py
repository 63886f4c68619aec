"""Files of named arrays: HDF5 (what `jointplay simulate` writes, MAT of version 7.3), NPZ, and MAT before 7.3.

Nothing that would have to be executed is read.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.moments import find_in_members
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording
from jointplay.solver.arrays import FloatArray

_RATES = frozenset(
    (
        "fs",
        "rate",
        "sr",
        "samplerate",
        "samplerate_hz",
        "samplingrate",
        "samplefrequency",
        "samplingfrequency",
        "sample_rate",
        "sample_rate_hz",
        "sampling_rate",
        "sampling_frequency",
    )
)
_STEPS = frozenset({"dt", "ts", "wf_increment", "increment", "sample_interval"})
_TIMES = frozenset({"t", "time", "zeit"})
_FREQUENCIES = frozenset({"f", "freq", "frequency", "frequency_hz"})
_NAMES = frozenset({"channels", "channel_names", "channelnames", "names", "labels", "columns"})
_UNITS = frozenset({"unit", "units"})
#: Prefix that `jointplay simulate` gives sensors.
_SENSOR = "sensor_"


def recording_of(
    arrays: Mapping[str, Any],
    units: Mapping[str, str],
    source: str,
    limits: Limits,
    facts: Sequence[str] = (),
    attributes: Mapping[str, str] | None = None,
) -> RawRecording:
    """Make a recording of named arrays.

    Parameters
    ----------
    arrays : mapping of str to ndarray, list of str or str
        Numbers; texts are names or units. Dotted names are members of a structure, whose last part counts.
    units : mapping of str to str
        Of arrays, where the file has them beside the arrays.
    source : str
        For messages.
    limits : Limits
    facts : sequence of str
        What was understood so far.
    attributes : mapping of str to str, optional
        Texts beside the arrays, which may say when it was measured.

    Raises
    ------
    MeasurementError
        Nothing is a signal, or it is not clear what is.
    """
    told = list(facts)
    scalars, texts, large = _sort(arrays, source)
    rate = _rate(scalars, source, told)
    moment, dated = find_in_members(
        {**scalars, **{name: words[0] for name, words in texts.items() if len(words) == 1}, **(attributes or {})}
    )
    texts = {name: words for name, words in texts.items() if name not in dated}
    ours = {name: array for name, array in large.items() if _last(name).startswith(_SENSOR)}
    if ours:
        left = sorted(set(large) - set(ours) - {name for name in large if _last(name) in _TIMES})
        told += [f"arrays not used: {', '.join(left)}"] if left else []
        large = {name: array for name, array in large.items() if name not in left}
    times = [name for name in large if _last(name).lower() in _TIMES]
    spectral = [name for name in large if _last(name).lower() in _FREQUENCIES]
    if len(times) + len(spectral) > 1:
        raise MeasurementError(source, value=", ".join(times + spectral), rule="more than one array is an axis")
    axis = (times + spectral)[0] if times or spectral else None
    signals = [name for name in large if name != axis]
    if not signals:
        shown = ", ".join(f"{name} {np.shape(array)}" for name, array in arrays.items() if not isinstance(array, str))
        raise MeasurementError(source, value=shown[:120] or None, rule="holds no array that could be a recording")
    shaped = {name: _upright(large[name], name, source, told) for name in signals}
    lengths = {name: len(array) for name, array in shaped.items()}
    if axis is not None:
        lengths[axis] = large[axis].size
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise MeasurementError(source, value=shown, rule="arrays of different length: it is not clear which to read")
    columns, values = _columns(shaped, texts, units, source, told)
    if axis is not None:
        unit = units.get(axis)
        columns.insert(0, RawColumn(axis, _last(axis), unit, f"array {axis}"))
        values.insert(0, large[axis].reshape(-1))
    if len(columns) > limits.columns:
        raise MeasurementError(source, rule=f"{len(columns)} columns; at most {limits.columns} are read")
    return RawRecording(source, tuple(columns), np.column_stack(values), rate, tuple(told), moment=moment)


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _sort(
    arrays: Mapping[str, Any], source: str
) -> tuple[dict[str, float], dict[str, list[str]], dict[str, FloatArray]]:
    """Scalars, texts and arrays of numbers; integers and single precision become double."""
    scalars: dict[str, float] = {}
    texts: dict[str, list[str]] = {}
    large: dict[str, FloatArray] = {}
    for name, value in arrays.items():
        if isinstance(value, str):
            texts[name] = [value]
            continue
        if isinstance(value, list):
            texts[name] = [str(part) for part in value]
            continue
        array = np.asarray(value)
        if array.dtype.kind in "iuf" and array.size == 1:
            scalars[name] = float(array.reshape(-1)[0])
        elif array.dtype.kind == "c":
            raise MeasurementError(source, None, name, rule="holds complex numbers: not a recording")
        elif array.dtype.kind in "iuf" and array.size:
            large[name] = array.astype(np.float64)
    return scalars, texts, large


def _rate(scalars: Mapping[str, float], source: str, told: list[str]) -> float | None:
    found: dict[str, float] = {}
    for name, value in scalars.items():
        last = _last(name).lower()
        if last in _RATES or last in _STEPS:
            if not (np.isfinite(value) and value > 0):
                raise MeasurementError(source, None, name, value, "must be positive and finite")
            found[name] = value if last in _RATES else 1.0 / value
    if not found:
        return None
    name, rate = next(iter(found.items()))
    for other, value in found.items():
        if abs(value / rate - 1.0) > 1e-6:
            rule = f"states {value:.9g} Hz, but {name} states {rate:.9g} Hz"
            raise MeasurementError(source, None, other, rule=rule)
    if abs(rate - round(rate)) < 1e-6 * rate:  # 1 / 0.0001 is 10000.000000000002
        rate = float(round(rate)) if round(rate) else rate
    told.append(f"{name}: sample rate {rate:.9g} Hz")
    return rate


def _upright(array: FloatArray, name: str, source: str, told: list[str]) -> FloatArray:
    """Time along the first axis; the longer side is time."""
    squeezed = array.reshape([size for size in array.shape if size != 1] or [1])
    if squeezed.ndim > 2:
        raise MeasurementError(source, None, name, array.shape, "has more than two dimensions")
    if squeezed.ndim < 2:
        return squeezed.reshape(-1, 1)
    if squeezed.shape[0] < squeezed.shape[1]:
        told.append(f"{name}: {squeezed.shape[0]} rows of {squeezed.shape[1]}: rows are channels")
        return squeezed.T
    return squeezed


def _columns(
    shaped: Mapping[str, FloatArray],
    texts: Mapping[str, list[str]],
    units: Mapping[str, str],
    source: str,
    told: list[str],
) -> tuple[list[RawColumn], list[FloatArray]]:
    """Columns with names and units from the texts, where those are as many."""
    total = sum(array.shape[1] for array in shaped.values())
    names = next((texts[each] for each in texts if _last(each).lower() in _NAMES and len(texts[each]) == total), None)
    common = next((texts[each] for each in texts if _last(each).lower() in _UNITS and len(texts[each]) in (1, total)),
                  None)  # fmt: skip
    if common is not None:
        told.append(f"units: {', '.join(common)}")
    for each, words in texts.items():
        if words is not names and words is not common:
            told.append(f"{each}: {' '.join(words)[:80]!r}: not used")
    columns: list[RawColumn] = []
    values: list[FloatArray] = []
    for name, array in shaped.items():
        own = [part.strip() for part in units.get(name, "").split(",")] if units.get(name) else []
        for index in range(array.shape[1]):
            place = len(columns)
            plain = _last(name).removeprefix(_SENSOR) if array.shape[1] == 1 else f"{_last(name)}-{index + 1}"
            title = names[place].strip() if names else plain
            if len(own) == array.shape[1]:
                unit: str | None = own[index]
            else:
                unit = None if common is None else common[place if len(common) == total else 0].strip() or None
            columns.append(
                RawColumn(title, title, unit, f"array {name}" + (f", {index + 1}" if array.shape[1] > 1 else ""))
            )
            values.append(array[:, index])
    twice = {column.name for column in columns if sum(each.name == column.name for each in columns) > 1}
    if twice:
        raise MeasurementError(source, None, min(twice), rule="two channels have this name")
    return columns, values


def read_hdf5(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read the arrays of an HDF5 file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    from jointplay.catalogue.storage.hdf5 import foreign_arrays

    try:
        arrays, units, attributes = foreign_arrays(data, limits.decoded_bytes)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise MeasurementError(source, rule=f"cannot be read as HDF5: {error}") from None
    return recording_of(arrays, units, source, limits, ("HDF5 file",), attributes)


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
    texts, said = (
        {name: value for name, value in each.items() if isinstance(value, str)} for each in (units, attributes)
    )
    return recording_of(arrays, texts, source, limits, ("NPZ file",), said)


def _document(texts: Any) -> dict[str, Any]:
    if not (isinstance(texts, list) and len(texts) == 1):
        return {}
    try:
        found = json.loads(texts[0])
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_COMPRESSED = 15


def read_mat(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read a MAT file; see :data:`jointplay.catalogue.measurements.readers.raw.Reader`."""
    if data[512:520] == HDF5_SIGNATURE or data.startswith(HDF5_SIGNATURE):
        from jointplay.catalogue.measurements.readers.arrays import read_hdf5

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
    facts = ["MAT file up to version 7.2"]
    written = re.match(rb"MATLAB 5\.0[^\0]*?Created on: ([ -~]+)", data[:116])
    if written:  # by whatever program, perhaps years after the measurement
        facts.append(f"written on {written[1].decode().strip()!r}: not taken for the time of measurement")
    return recording_of(arrays, {}, source, limits, facts)


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
            unpacked += _unpack_size(data[place + 8 : place + 8 + size], limits.decoded_bytes - unpacked, source)
        else:
            unpacked += size
        if unpacked > limits.decoded_bytes:
            rule = f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
            raise MeasurementError(source, rule=rule)
        place += 8 + size


def _unpack_size(packed: bytes, most: int, source: str) -> int:
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
