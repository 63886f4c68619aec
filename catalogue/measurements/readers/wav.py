"""WAV files. They hold fractions of a full scale that they do not state: it comes from a profile or an option."""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.moments import RawMoment
from jointplay.catalogue.measurements.readers.raw import Limits, RawColumn, RawRecording

_BITS = {"PCM_U8": 8, "PCM_S8": 8, "PCM_16": 16, "PCM_24": 24, "PCM_32": 32}


def read_wav(data: bytes, source: str, limits: Limits) -> RawRecording:
    """Read a WAV file of whole or floating-point numbers; see
    :data:`jointplay.catalogue.measurements.readers.raw.Reader`.
    """
    declared = frames_declared(data, source)
    import soundfile

    try:
        with soundfile.SoundFile(io.BytesIO(data)) as file:
            if file.channels > limits.columns:
                raise MeasurementError(source, rule=f"{file.channels} channels; at most {limits.columns} are read")
            if 8 * file.frames * file.channels > limits.decoded_bytes:
                rule = f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
                raise MeasurementError(source, rule=rule)
            values = file.read(dtype="float64", always_2d=True)
            rate, coding = float(file.samplerate), str(file.subtype)
    except soundfile.LibsndfileError as error:
        raise MeasurementError(source, rule=f"is a damaged WAV file: {error.error_string}") from None
    if coding not in _BITS and coding not in ("FLOAT", "DOUBLE"):
        raise MeasurementError(source, value=coding, rule="is a lossy coding: levels in it mean nothing")
    columns = tuple(RawColumn(f"ch{i}", f"ch{i}", None, f"channel {i}") for i in range(1, values.shape[1] + 1))
    ceiling = 1.0 - 2.0 ** (1 - _BITS[coding]) if coding in _BITS else None
    return RawRecording(
        source,
        columns,
        np.asarray(values, dtype=np.float64),
        rate,
        (f"WAV, {coding.replace('_', ' ')}, {values.shape[1]} channels, {rate:g} Hz",),
        declared=declared,
        relative=coding in _BITS,
        ceiling=ceiling,
        moment=find_moment(data),
    )


def find_moment(data: bytes) -> RawMoment | None:
    """Return what a file says of when it was made: its broadcast extension (EBU Tech 3285), else its information."""
    found: dict[bytes, RawMoment] = {}
    for name, place, size in _chunks(data):
        if name == b"bext" and size >= 338:
            day, clock = (_text(data[place + first : place + last]) for first, last in ((320, 330), (330, 338)))
            found[name] = RawMoment(f"{_spaced(day)} {clock.replace('-', ':')}", "chunk bext")
        if name == b"LIST" and data[place : place + 4] == b"INFO":
            for inner, at, length in _chunks(data, place + 4, place + size):
                if inner == b"ICRD":
                    found[inner] = RawMoment(_spaced(_text(data[at : at + length])), "chunk ICRD")
    dated = [found[name] for name in (b"bext", b"ICRD") if name in found and any(map(str.isdigit, found[name].text))]
    return dated[0] if dated else None


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode("latin-1").strip()


def _spaced(text: str) -> str:
    """A date whose parts stand apart by any sign, as its format allows."""
    return re.sub(r"^(\d{4})[_:. ](\d\d)[_:. ](\d\d)", r"\1-\2-\3", text)


def _chunks(data: bytes, place: int = 12, end: int | None = None) -> Iterator[tuple[bytes, int, int]]:
    """Name, first byte and size of the chunks."""
    while place + 8 <= (len(data) if end is None else min(end, len(data))):
        name, size = struct.unpack_from("<4sI", data, place)
        yield name, place + 8, size
        place += 8 + size + size % 2


def frames_declared(data: bytes, source: str) -> int:
    """Samples a channel that the file's own header says it holds; the library would take what is left in silence.

    Raises
    ------
    MeasurementError
        It is truncated, or no WAV file.
    """
    block = 0
    for name, place, size in _chunks(data):
        if name == b"fmt " and place + 14 <= len(data):
            block = struct.unpack_from("<H", data, place + 12)[0]
        if name == b"data":
            if not block:
                break
            here = len(data) - place
            if size > here:
                rule = f"is truncated: it declares {size // block} samples, {here // block} are there"
                raise MeasurementError(source, rule=rule)
            return size // block
    raise MeasurementError(source, rule="is a truncated WAV file: it ends before its samples begin")
