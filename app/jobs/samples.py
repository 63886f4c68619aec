"""Samples of recordings that were read, kept so that a chart can be drawn from them at once.

They lie beside the uploads in single precision; the folder is bounded, and whatever is missing is read again.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jointplay.app.errors import BadFieldError
from jointplay.app.storage.recording_files import read_bytes
from jointplay.app.storage.told import Told

if TYPE_CHECKING:
    from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
    from jointplay.catalogue.measurements.measurement import Recording

#: Size of the folder of samples at most.
KEPT_BYTES = 2_000_000_000


@dataclass(frozen=True)
class StoredRecording:
    """Where a recording lies, and how to read it.

    Parameters
    ----------
    id : str
        Of the measurement: tells apart what was read of the same bytes by other words of their sender.
    path, name, told
        As for :func:`read`.
    kept : str
        Folder of samples.
    """

    id: str
    path: str
    name: str
    told: Told
    kept: str


def read(path: str, name: str, told: Told) -> Recording | MeasuredSpectrum:
    """Read a recording, or a spectrum, by the reader that its content and name ask for."""
    from jointplay.catalogue.measurements.measured_spectrum import read_recording

    return read_recording(
        read_bytes(path),
        name=name,
        sample_rate=told.sample_rate_hz,
        units=told.units or None,
        profile=told.import_profile,
    )


def samples_of(stored: StoredRecording) -> Recording:
    """Return a recording as :func:`measured_of` does.

    Raises
    ------
    BadFieldError
        It is a spectrum, which has no samples.
    """
    from jointplay.catalogue.measurements.measurement import Recording

    measured = measured_of(stored)
    if not isinstance(measured, Recording):
        raise BadFieldError("view: this measurement is a spectrum, which has no samples", field="view")
    return measured


def measured_of(stored: StoredRecording) -> Recording | MeasuredSpectrum:
    """Return a spectrum, or a recording, its samples mapped from a file in single precision.

    It is read where there is no such file.
    """
    from jointplay.catalogue.measurements.measurement import Recording

    with suppress(OSError, ValueError):
        return _mapped(stored)
    measured = read(stored.path, stored.name, stored.told)
    if not isinstance(measured, Recording):
        return measured
    with suppress(OSError, ValueError):
        keep(stored, measured)
        return _mapped(stored)
    return measured  # there is no room for its samples


def _mapped(stored: StoredRecording) -> Recording:
    from jointplay.catalogue.measurements.measurement import Channel, Recording

    samples, facts = _places(stored)
    known = json.loads(facts.read_text())
    kept = np.load(samples, mmap_mode="r")
    if known.pop("sha256", "") != _digest(stored, known, kept):
        raise ValueError("samples or facts are not what was kept")
    signal = kept.T
    os.utime(samples)
    channels = tuple(Channel(**each) for each in known["channels"])
    turns = None if known["turns"] is None else np.array(known["turns"])
    return Recording(stored.name, known["sample_rate"], signal, channels, (), (), "", turns=turns)


def _digest(stored: StoredRecording, known: Mapping[str, Any], signal: NDArray[np.float32]) -> str:
    """Return the checksum of samples and what is known of them, as those of this recording."""
    digest = hashlib.sha256(json.dumps([stored.id, known], sort_keys=True).encode())
    digest.update(np.ascontiguousarray(signal).data)
    return digest.hexdigest()


def _places(stored: StoredRecording) -> tuple[Path, Path]:
    folder = Path(stored.kept)
    return folder / f"{stored.id}.npy", folder / f"{stored.id}.json"


def keep(stored: StoredRecording, measured: Recording) -> None:
    """Write the samples of a recording that was read.

    Raises
    ------
    OSError
        There is no room, for instance.
    """
    known = {
        "sample_rate": float(measured.sample_rate),
        "channels": [asdict(channel) for channel in measured.channels],
        "turns": None if measured.turns is None else measured.turns.tolist(),
    }
    samples, facts = _places(stored)
    samples.parent.mkdir(exist_ok=True)
    signal = np.ascontiguousarray(measured.signal.T, np.float32)
    known["sha256"] = _digest(stored, known, signal)
    put(samples, lambda file: np.save(file, signal))
    put(facts, lambda file: file.write(json.dumps(known).encode()))
    tidy(samples.parent)


def put(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file that is there as a whole or not at all."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix="partial-", delete=False) as partial:
        try:
            write(partial)
        except BaseException:
            Path(partial.name).unlink(missing_ok=True)
            raise
    os.replace(partial.name, path)


def tidy(folder: Path) -> None:
    """Delete what was not looked at for longest, until the folder is within its size."""
    found = []
    for path in folder.iterdir():
        with suppress(FileNotFoundError):
            facts = path.stat()
            found.append((facts.st_mtime, facts.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found)[:-2]:
        if total <= KEPT_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size
