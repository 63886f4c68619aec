"""Bytes of a recording's file, no more of them than are allowed, unpacked where it is gzipped."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.raw import Limits


def file_bytes(path: Path, limits: Limits) -> bytes:
    """Bytes of a file, at most one more than the limit.

    Raises
    ------
    MeasurementError
        It cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(limits.file_bytes + 1)
    except OSError as error:
        raise MeasurementError(str(path), rule=f"cannot be read: {error.strerror or error}") from None


def decompressed(data: bytes, title: str, limits: Limits) -> bytes:
    """Content of a gzip file, anything else as it is.

    Raises
    ------
    MeasurementError
        Damaged, or larger than is read.
    """
    if not data.startswith(b"\x1f\x8b"):
        if title.lower().endswith(".gz"):
            raise MeasurementError(title, rule="is not a gzip file")
        decoded = data
    else:
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
                decoded = packed.read(limits.decoded_bytes + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise MeasurementError(title, rule=f"is a damaged gzip file: {error}") from None
    if len(decoded) > limits.decoded_bytes:
        raise MeasurementError(title, rule=f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read")
    return decoded
