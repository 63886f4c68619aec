"""Fitted models as files: arrays and a few numbers, published whole, read back or left aside."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.matching.calibration import Tail
from jointplay.catalogue.matching.clearances import Ranks
from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.curve_calibration import Calibration
from jointplay.catalogue.matching.curves import ClearanceGrid, Curve, CurveModel, Tube
from jointplay.catalogue.matching.gaussian import FittedGaussian
from jointplay.catalogue.matching.network import Network, Opinion
from jointplay.catalogue.matching.sightings import Sightings
from jointplay.catalogue.storage.directory import publish

FORMAT = 1
"""Of the files; others are fitted anew."""

KEPT = 16
"""Models of a catalogue that are kept as files (some 30 MB each with 17 hypotheses)."""

_TYPES = {
    kind.__name__: kind
    for kind in (FittedGaussian, CurveModel, Curve, ClearanceGrid, Tube, Calibration, Tail, Conformal, Ranks)
} | {kind.__name__: kind for kind in (Sightings, Network, Opinion)}


def write_model(folder: Path, key: str, model: FittedGaussian) -> bool:
    """Write a model under its key; False where the folder cannot be written, which only costs time later.

    Of the models there only the last :data:`KEPT` stay.
    """
    try:
        _write(folder, key, model, KEPT)
    except CatalogueFileError:
        return False
    return True


def write_network(folder: Path, key: str, network: Network) -> None:
    """Write a network under its key.

    Raises
    ------
    CatalogueFileError
        The folder cannot be written.
    """
    _write(folder, key, network)


def _write(folder: Path, key: str, model: FittedGaussian | Network, kept: int | None = None) -> None:
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = {"format": FORMAT, "key": key, "model": _plain(model, arrays)}
    arrays["tree"] = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    write_arrays(folder, key, arrays, kept)


def write_arrays(folder: Path, key: str, arrays: Mapping[str, np.ndarray[Any, Any]], kept: int | None = None) -> None:
    """Write arrays by name under their key; of the files there only the last so many stay, all unless given.

    Raises
    ------
    CatalogueFileError
        The folder cannot be written.
    """
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CatalogueFileError(folder, f"cannot be written ({error.strerror or error})") from error
    publish(folder / f"{key}.npz", content.getvalue())
    for file in sorted(folder.glob("*.npz"), key=age_key)[:-kept] if kept else ():
        file.unlink(missing_ok=True)


def read_arrays(folder: Path, key: str) -> dict[str, np.ndarray[Any, Any]] | None:
    """Read the arrays of a key; None where there are none, or none that can be read."""
    try:
        with np.load(io.BytesIO((folder / f"{key}.npz").read_bytes()), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        return None


def age_key(file: Path) -> tuple[float, str]:
    """When a file was written, 0 if it is gone by now, and its name: sorts files by age."""
    try:
        return file.stat().st_mtime, file.name
    except OSError:
        return 0.0, file.name


def read_model(folder: Path, key: str) -> FittedGaussian | None:
    """Read the model of a key; None where there is none, or none that can be read."""
    found = _read(folder, key)
    return found if isinstance(found, FittedGaussian) else None


def read_network(folder: Path, key: str) -> Network | None:
    """Read the network of a key; None where there is none, or none that can be read."""
    found = _read(folder, key)
    return found if isinstance(found, Network) else None


def _read(folder: Path, key: str) -> Any:
    arrays = read_arrays(folder, key)
    if arrays is None:
        return None
    try:
        tree = json.loads(arrays["tree"].tobytes())
        if tree["format"] != FORMAT or tree["key"] != key:
            return None
        return _restore(tree["model"], arrays)
    except (ValueError, KeyError, TypeError):
        return None


def as_read(model: FittedGaussian) -> FittedGaussian:
    """Return the model as it comes out of a file: order of numbers in memory decides the last digit of their sums."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    again = _restore(_plain(model, arrays), arrays)
    assert isinstance(again, FittedGaussian)
    return again


def _plain(value: Any, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Replace arrays by their names, dataclasses and tuples by plain data."""
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = np.ascontiguousarray(value)
        return {"array": name}
    if is_dataclass(value):
        content = {field.name: _plain(getattr(value, field.name), arrays) for field in fields(value)}
        return {"type": type(value).__name__, "fields": content}
    if isinstance(value, tuple):
        return [_plain(item, arrays) for item in value]
    return value


def _restore(value: Any, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    if isinstance(value, list):
        return tuple(_restore(item, arrays) for item in value)
    if isinstance(value, dict) and "array" in value:
        return arrays[value["array"]]
    if isinstance(value, dict):
        content = {name: _restore(item, arrays) for name, item in value["fields"].items()}
        return _TYPES[value["type"]](**content)
    return value
