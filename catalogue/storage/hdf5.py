"""HDF5 files: the only module that knows how they are read and written.

One lock for the library, which is not safe to be called from several threads at once.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast, get_args

import h5py
import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.errors import CatalogueFileError, CatalogueMismatchError
from jointplay.catalogue.plans.entry import Hypothesis, Recipe, Stratum, canonical_json
from jointplay.catalogue.plans.variants import Variant
from jointplay.catalogue.storage.cross_power import CHANNELS, CYCLIC, PACKED, UNITS
from jointplay.catalogue.storage.directory import publish
from jointplay.catalogue.storage.shard import Shard, ShardHeader

LAYOUT_VERSION = 2
"""Of shard files and of the catalogue's folder; a change of what they hold raises it. Another one is refused."""

_FORMAT = "jointplay catalogue shard"
_TEXT = h5py.string_dtype("utf-8")
_LOCK = threading.RLock()

_TEXT_COLUMNS = ("key", "status", "message")
_NUMBER_COLUMNS = {
    "draw": "1", "segments": "1", "period": "1", "row": "1", "drive_speed": "rad/s", "transient": "s", "guard_db": "dB",
}  # fmt: skip


def encode_shard(shard: Shard) -> bytes:
    """The HDF5 file of a shard, as bytes; the same shard gives the same bytes.

    Parameters
    ----------
    shard : Shard

    Returns
    -------
    bytes
        Its groups are ``bands``, ``entries`` and ``spectra``; see ``docs/reference/catalogue-folder.md``.
    """
    header = shard.header
    with _LOCK, h5py.File.in_memory(track_order=False) as file:
        file.attrs["format"] = _FORMAT
        file.attrs["layout_version"] = LAYOUT_VERSION
        file.attrs["machine"] = header.machine
        file.attrs["recipe"] = canonical_json(header.recipe.content)
        file.attrs["plan"] = canonical_json(header.plan)
        file.attrs["numbers_version"] = header.numbers_version
        file.attrs["versions"] = canonical_json(header.versions)

        bands = file.create_group("bands")
        edges = bands.create_dataset("edges", data=np.asarray(header.recipe.scheme.edges, np.float64))
        edges.attrs["unit"] = "orders"

        entries = file.create_group("entries")
        entries.attrs["hypothesis"] = shard.hypothesis.label
        entries.attrs["worn"] = np.array(shard.hypothesis.joints, dtype=_TEXT)
        entries.attrs["stratum"] = shard.stratum
        entries.attrs["speed"] = shard.speed
        entries.attrs["variant"] = canonical_json(shard.variant.content)
        entries.attrs["joints"] = np.array(shard.joints, dtype=_TEXT)
        entries.attrs["parameter_names"] = np.array(shard.parameter_names, dtype=_TEXT)
        for name in _TEXT_COLUMNS:
            entries.create_dataset(name, data=np.array(getattr(shard, name), dtype=object), dtype=_TEXT)
        for name, unit in _NUMBER_COLUMNS.items():
            entries.create_dataset(name, data=getattr(shard, name)).attrs["unit"] = unit
        entries.create_dataset("clearance", data=shard.clearance).attrs["unit"] = "m"
        entries.create_dataset("parameters", data=shard.parameters).attrs["unit"] = "SI"

        spectra = file.create_group("spectra")
        power = spectra.create_dataset("power", data=shard.power)
        power.attrs["quantity"] = "cross-power of the frame's acceleration, integrated over each band"
        power.attrs["columns"] = np.array(PACKED, dtype=_TEXT)
        power.attrs["channels"] = np.array(CHANNELS, dtype=_TEXT)
        power.attrs["units"] = np.array(UNITS, dtype=_TEXT)
        power.attrs["point"] = "centre of gravity of the frame"
        spread = spectra.create_dataset("spread_db", data=shard.spread_db)
        spread.attrs["quantity"] = "standard deviation of the band level over the averaged windows"
        spread.attrs["unit"] = "dB"
        cyclic = spectra.create_dataset("cyclic", data=shard.cyclic)
        cyclic.attrs["quantity"] = "cyclic cross-power of the frame's acceleration, integrated over feature bands"
        cyclic.attrs["columns"] = np.array(CYCLIC, dtype=_TEXT)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def decode_shard(content: bytes, path: Path) -> Shard:
    """Read what :func:`encode_shard` wrote.

    Parameters
    ----------
    content : bytes
        The whole file.
    path : Path
        Its name, for messages.

    Raises
    ------
    CatalogueFileError
        It is no HDF5 file, or something is missing in it.
    CatalogueMismatchError
        It has another layout.
    """
    try:
        with _LOCK, h5py.File.in_memory(content) as file:
            if file.attrs.get("format") != _FORMAT:
                raise CatalogueFileError(path, "is an HDF5 file, but not a shard of a catalogue")
            check_layout(file.attrs.get("layout_version"), path)
            entries, spectra = file["entries"], file["spectra"]
            columns: dict[str, Any] = {name: tuple(map(str, entries[name].asstr()[()])) for name in _TEXT_COLUMNS}
            columns |= {name: entries[name][()] for name in _NUMBER_COLUMNS}
            return Shard(
                header=ShardHeader(
                    machine=str(file.attrs["machine"]),
                    recipe=Recipe.from_content(json.loads(file.attrs["recipe"])),
                    plan=json.loads(file.attrs["plan"]),
                    numbers_version=int(file.attrs["numbers_version"]),
                    versions=json.loads(file.attrs["versions"]),
                ),
                hypothesis=Hypothesis(str(entries.attrs["hypothesis"]), tuple(map(str, entries.attrs["worn"]))),
                stratum=_stratum(str(entries.attrs["stratum"])),
                speed=float(entries.attrs["speed"]),
                variant=Variant.from_content(json.loads(entries.attrs["variant"])),
                joints=tuple(map(str, entries.attrs["joints"])),
                parameter_names=tuple(map(str, entries.attrs["parameter_names"])),
                clearance=entries["clearance"][()],
                parameters=entries["parameters"][()],
                power=spectra["power"][()],
                spread_db=spectra["spread_db"][()],
                cyclic=spectra["cyclic"][()],
                **columns,
            )
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        # What the library and NumPy raise for a file whose bytes, or whose structure, are not what a shard has.
        raise CatalogueFileError(path, f"cannot be read as a shard ({type(error).__name__}: {error})") from error


def check_layout(found: object, path: Path) -> None:
    """Refuse another layout than that of this program; what was built before layouts had versions names none.

    Raises
    ------
    CatalogueMismatchError
        Says which layout it is, and what to do.
    """
    if found != LAYOUT_VERSION:
        shown = "a layout without a version" if found is None else f"layout {found}"
        rule = f"has {shown}; this program reads layout {LAYOUT_VERSION}: build the catalogue anew in another folder"
        raise CatalogueMismatchError(path, rule)


def _stratum(text: str) -> Stratum:
    if text not in get_args(Stratum):
        raise ValueError(f"stratum {text!r} is not known")
    return cast(Stratum, text)


def arrays_image(
    arrays: Mapping[str, NDArray[Any]],
    *,
    units: Mapping[str, str] | None = None,
    attributes: Mapping[str, str | float | int | bool | tuple[str, ...]] | None = None,
) -> bytes:
    """Return an HDF5 file of named arrays, as :func:`write_arrays` writes it; the same arrays give the same bytes."""
    with _LOCK, h5py.File.in_memory(track_order=True) as file:
        for name, array in arrays.items():
            dataset = _dataset(file, name, array)
            if units and name in units:
                dataset.attrs["unit"] = units[name]
        for name, value in (attributes or {}).items():
            file.attrs[name] = np.array(value, dtype=_TEXT) if isinstance(value, tuple) else value
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def write_arrays(
    path: str | Path,
    arrays: Mapping[str, NDArray[Any]],
    *,
    units: Mapping[str, str] | None = None,
    attributes: Mapping[str, str | float | int | bool | tuple[str, ...]] | None = None,
) -> None:
    """Write named arrays, as of a simulation: time histories, spectra, and what they are.

    The file takes its name only when it is complete.

    Parameters
    ----------
    path : str or Path
        The file; an old one is replaced.
    arrays : mapping of str to ndarray
        Numbers, or text (links, channels), each becomes a dataset.
    units : mapping of str to str, optional
        Unit of a dataset, stored as its attribute ``unit``; several units, one a column, are separated by commas.
    attributes : mapping, optional
        Attributes of the file: status, settings, versions, machine.

    Raises
    ------
    CatalogueFileError
        The file cannot be written.
    """
    publish(Path(path), arrays_image(arrays, units=units, attributes=attributes))


def write_growing(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    shapes: Mapping[str, tuple[int, ...]],
    parts: Iterable[Mapping[str, NDArray[np.float32]]],
    *,
    units: Mapping[str, str],
    attributes: Mapping[str, str],
) -> None:
    """Write named arrays, some of which are too large for memory.

    Parameters
    ----------
    path : Path
        The file; it must not exist.
    arrays : mapping of str to ndarray
        Written at once.
    shapes : mapping of str to tuple of int
        Of the large ones, float32.
    parts : iterable of mapping of str to ndarray
        Rows of the large ones, one part below the other.
    units, attributes : mapping of str to str
        As for :func:`write_arrays`.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    with _LOCK, h5py.File(path, "x") as file:
        for name, array in arrays.items():
            _dataset(file, name, array)
        large = {name: file.create_dataset(name, shape, np.float32) for name, shape in shapes.items()}
        row = 0
        for part in parts:
            count = max(len(rows) for rows in part.values())
            for name, rows in part.items():
                large[name][row : row + count] = rows
            row += count
        for name, unit in units.items():
            file[name].attrs["unit"] = unit
        for name, value in attributes.items():
            file.attrs[name] = value


def _dataset(file: h5py.File, name: str, array: NDArray[Any]) -> h5py.Dataset:
    if np.asarray(array).dtype.kind in "UO":
        return file.create_dataset(name, data=np.asarray(array, dtype=object), dtype=_TEXT)
    large = np.asarray(array).nbytes > 65536
    options: dict[str, Any] = {"compression": "gzip", "shuffle": True} if large else {}
    return file.create_dataset(name, data=array, **options)


def read_arrays(path: str | Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read what :func:`write_arrays` wrote.

    Returns
    -------
    arrays : dict of str to ndarray
        Datasets of the file's root.
    attributes : dict of str to object
        Attributes of the file; lists of text are tuples.

    Raises
    ------
    CatalogueFileError
        The file cannot be read, or is no HDF5 file.
    """
    path = Path(path)
    try:
        with _LOCK, h5py.File(path, "r") as file:
            arrays = {
                name: item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()]
                for name, item in file.items()
                if isinstance(item, h5py.Dataset)
            }
            attributes = {
                name: tuple(map(str, value)) if isinstance(value, np.ndarray) and value.dtype.kind == "O" else value
                for name, value in file.attrs.items()
            }
    except OSError as error:
        raise CatalogueFileError(path, f"cannot be read as HDF5 ({' '.join(str(error).split())})") from error
    return arrays, attributes


def foreign_arrays(content: bytes, most_bytes: int) -> tuple[dict[str, Any], dict[str, str], dict[str, str]]:
    """Arrays and texts of somebody else's HDF5 file; nothing outside the file is followed.

    Parameters
    ----------
    content : bytes
        The whole file.
    most_bytes : int
        Most bytes that its arrays may take together; counted before any is read.

    Returns
    -------
    arrays : dict of str to ndarray, str or list of str
        Members of groups under dotted names; attributes of the file that are numbers, too. MATLAB's texts and cells
        of texts are texts.
    units : dict of str to str
        Of the arrays that have an attribute ``unit`` or ``units``.
    attributes : dict of str to str
        Of the file, as far as they are texts.

    Raises
    ------
    OSError, RuntimeError, ValueError
        It is damaged; or declares more than allowed, or samples it does not hold.
    """
    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}
    with _LOCK, h5py.File.in_memory(content) as file:
        arrays.update({name: value for name, value in file.attrs.items() if np.asarray(value).dtype.kind in "iuf"})
        texts = {name: _text(value) for name, value in file.attrs.items() if isinstance(value, str | bytes)}
        found = list(_members(file, "", 0))
        if sum(item.nbytes for _, item in found) > most_bytes:
            raise ValueError(f"its arrays take more than {most_bytes / 1e6:g} MB, the most that is read")
        for name, item in found:
            value = _foreign_value(file, item)
            if value is None:
                continue
            arrays[name] = value
            for attribute in ("unit", "units"):
                text = item.attrs.get(attribute)
                if text is not None:
                    units[name] = _text(text)
    return arrays, units, texts


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)


def _members(group: h5py.Group, prefix: str, depth: int) -> Iterable[tuple[str, h5py.Dataset]]:
    for name in group:
        # MATLAB keeps what cells refer to in #refs#; links out of the file are not followed.
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Dataset):
            yield f"{prefix}{name}", item
        elif isinstance(item, h5py.Group) and depth < 4:
            yield from _members(item, f"{prefix}{name}.", depth + 1)


def _foreign_value(file: h5py.File, item: h5py.Dataset) -> Any:
    """Numbers, texts, or None for what is neither."""
    if item.external or item.is_virtual:
        raise ValueError(f"{item.name} lies in another file")
    if item.size is None:
        return None
    if h5py.check_string_dtype(item.dtype):
        texts = [str(each) for each in np.asarray(item.asstr("utf-8", "replace")[()]).reshape(-1)]
        return texts[0] if len(texts) == 1 else texts
    if h5py.check_ref_dtype(item.dtype):
        cells = [file[reference] for reference in np.asarray(item[()]).reshape(-1) if reference]
        if all(isinstance(cell, h5py.Dataset) and cell.dtype == np.uint16 and cell.size < 4096 for cell in cells):
            return [_characters(cell) for cell in cells]
        return None
    if item.dtype.kind not in "iufc" or not item.size:
        return None
    if item.attrs.get("MATLAB_class") == b"char":
        return _characters(item) if item.size < 4096 else None
    if item.chunks is not None:
        wanted = int(np.prod([-(-size // chunk) for size, chunk in zip(item.shape, item.chunks, strict=True)]))
        if item.id.get_num_chunks() < wanted:
            raise ValueError(f"{item.name} declares {item.size} numbers, but not all of them are in the file")
    elif item.id.get_storage_size() < item.nbytes:
        raise ValueError(f"{item.name} declares {item.size} numbers, but they are not in the file")
    return item[()]


def _characters(item: h5py.Dataset) -> str:
    return "".join(map(chr, np.asarray(item[()]).reshape(-1).tolist()))
