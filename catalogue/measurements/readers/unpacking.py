"""Gzip, and what no recording is: a line without end, or a file that unpacks to many times its size."""

from __future__ import annotations

import contextlib
import gzip
import io
import zlib
from collections.abc import Iterator

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.raw import Limits

PACKED = b"\x1f\x8b"
#: Longest line of a text: 256 columns take a hundredth of it.
LINE_BYTES = 1_000_000
#: A recording unpacks to 3 to 15 times its size, one of zeros alone to 200; what is smaller is read whatever it is.
RATIO, UNASKED_BYTES = 100, 16_000_000
#: Bytes that say what kind of file it is.
BEGINNING = 1024


def beginning_of(data: bytes, title: str) -> bytes:
    """First bytes of a file's content.

    Raises
    ------
    MeasurementError
        No gzip file, though it is called one, or a damaged one.
    """
    _check_name(data, title)
    return next(_parts(data, title, BEGINNING, data.startswith(PACKED)), b"")


def small_content(data: bytes) -> bytes | None:
    """Content of a file of at most `UNASKED_BYTES`; None of a larger or a damaged one."""
    if not data.startswith(PACKED):
        return data if len(data) <= UNASKED_BYTES else None
    with contextlib.suppress(OSError, EOFError, zlib.error), gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
        content = packed.read(UNASKED_BYTES + 1)
        return content if len(content) <= UNASKED_BYTES else None
    return None


def unpack(data: bytes, title: str, limits: Limits, *, text: bool) -> bytes:
    """Content of a gzip file, anything else as it is; given up as soon as it is plain that it is no recording.

    Parameters
    ----------
    data : bytes
    title : str
        What messages call it.
    limits : Limits
    text : bool
        Whether it is to have lines.

    Raises
    ------
    MeasurementError
        As of :func:`beginning_of`; larger than is read; a line without end; too much from too little.
    """
    _check_name(data, title)
    return check_content(data, title, limits, text=text, packed=data.startswith(PACKED))


def check_content(data: bytes, title: str, limits: Limits, *, text: bool, packed: bool = False) -> bytes:
    """As :func:`unpack`, of what is unpacked already, or said to be packed."""
    whole, line, size = io.BytesIO(), 0, 0
    for part in _parts(data, title, LINE_BYTES, packed):
        size += len(part)
        if size > limits.decoded_bytes:
            rule = f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
            raise MeasurementError(title, rule=rule)
        if packed and size > max(UNASKED_BYTES, RATIO * len(data)):
            raise MeasurementError(title, rule=f"unpacks to more than {RATIO} times its size, as no recording does")
        if text:
            end = max(part.rfind(b"\n"), part.rfind(b"\r"))
            line = line + len(part) if end < 0 else len(part) - end - 1
            if line >= LINE_BYTES:
                rule = f"holds a line of more than {LINE_BYTES / 1e6:g} MB, as no table of numbers does"
                raise MeasurementError(title, rule=rule)
        if packed:
            whole.write(part)
    return whole.getvalue() if packed else data


def _check_name(data: bytes, title: str) -> None:
    if title.lower().endswith(".gz") and not data.startswith(PACKED):
        raise MeasurementError(title, rule="is not a gzip file")


def _parts(data: bytes, title: str, size: int, packed: bool) -> Iterator[bytes]:
    if not packed:
        for at in range(0, len(data), size):
            yield data[at : at + size]
        return
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            while part := file.read(size):
                yield part
    except (OSError, EOFError, zlib.error) as error:
        raise MeasurementError(title, rule=f"is a damaged gzip file: {error}") from None
