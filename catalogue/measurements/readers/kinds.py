"""Kinds of files that are read, told by what they begin with, else by the ending of their name."""

from __future__ import annotations

import contextlib
import gzip
import io
import re
import zlib
from dataclasses import dataclass
from pathlib import PurePath

from jointplay.catalogue.errors import MeasurementError
from jointplay.solver.extensions import entry_points_of

_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class FileKind:
    """A kind of file, read in a process of its own.

    Parameters
    ----------
    name : str
        For messages: "WAV".
    endings : tuple of str
    module, function : str
        Of the reader.
    libraries : tuple of str
        Modules loaded before the process forks.
    example : bytes
        Read before it does, where more is loaded with the first file.
    """

    name: str
    endings: tuple[str, ...]
    module: str
    function: str
    libraries: tuple[str, ...] = ()
    example: bytes = b""


TEXT_ENDINGS = (".csv", ".tsv", ".txt")
#: Of tables of text, and of much else: such a file is what it begins like, and a table where it begins like nothing.
LOOSE_ENDINGS = (".lvm", ".asc", ".dat")
TEXT = FileKind(
    "text",
    (*TEXT_ENDINGS, *LOOSE_ENDINGS),
    "jointplay.catalogue.measurements.readers.csv",
    "read_csv",
    ("jointplay.catalogue.measurements.readers.csv",),
    b"t [s],x [m/s2]\n0,1\n1,2\n2,3\n",
)

FOREIGN = {
    kind.name: kind
    for kind in (
        FileKind("UFF", (".uff", ".unv", ".uf", ".58b"), "jointplay.catalogue.measurements.readers.uff", "read_uff"),
        FileKind("WAV", (".wav", ".wave"), "jointplay.catalogue.measurements.readers.wav", "read_wav", ("soundfile",)),
        FileKind(
            "MAT",
            (".mat",),
            "jointplay.catalogue.measurements.readers.arrays",
            "read_mat",
            ("scipy.io", "jointplay.catalogue.storage.hdf5"),
        ),
        FileKind("TDMS", (".tdms",), "jointplay.catalogue.measurements.readers.tdms", "read_tdms", ("nptdms",)),
        FileKind(
            "HDF5",
            (".h5", ".hdf5", ".hdf"),
            "jointplay.catalogue.measurements.readers.arrays",
            "read_hdf5",
            ("jointplay.catalogue.storage.hdf5",),
        ),
        FileKind("NPZ", (".npz",), "jointplay.catalogue.measurements.readers.arrays", "read_npz", ("numpy",)),
        FileKind(
            "XLSX",
            (".xlsx", ".xlsm"),
            "jointplay.catalogue.measurements.readers.tables",
            "read_xlsx",
            ("jointplay.catalogue.measurements.readers.csv", "python_calamine"),
        ),
        FileKind(
            "Parquet",
            (".parquet", ".pq"),
            "jointplay.catalogue.measurements.readers.tables",
            "read_parquet",
            ("jointplay.catalogue.measurements.readers.csv", "pyarrow.parquet"),
        ),
        FileKind(
            "Arrow",
            (".feather", ".arrow"),
            "jointplay.catalogue.measurements.readers.tables",
            "read_arrow",
            ("jointplay.catalogue.measurements.readers.csv", "pyarrow"),
        ),
        FileKind("JSON", (".json",), "jointplay.catalogue.measurements.readers.json_file", "read_json"),
    )
}


#: Kinds that other packages read, told by the ending of a name alone, which is the name of their entry point: none of
#: ours, but those that many programs give to files of their own.
_OWN_ENDINGS = {*TEXT_ENDINGS, *(ending for kind in FOREIGN.values() for ending in kind.endings)}
INSTALLED = {
    name.upper(): FileKind(name.upper(), (f".{name.lower()}",), point.module, point.attr)
    for name, point in entry_points_of("readers").items()
    if f".{name.lower()}" not in _OWN_ENDINGS and name.upper() not in FOREIGN
}
KINDS = {TEXT.name: TEXT, **FOREIGN, **INSTALLED}


#: How a measurement data file (ASAM MDF) begins, whole or not, and how its name ends.
MDF, MDF_ENDINGS = (b"MDF     ", b"UnFinMF "), (".mf4", ".mdf", ".mf3")
NO_MDF = "is an MDF file, which is not read: export it as CSV, TDMS or MAT by the program that recorded it"


def ending_for(data: bytes) -> str:
    """Ending of a name for content that has none, as that of a pipe."""
    packed = data.startswith(b"\x1f\x8b")
    if packed:
        with contextlib.suppress(OSError, EOFError, zlib.error):
            data = gzip.GzipFile(fileobj=io.BytesIO(data)).read(1024)
    told = "JSON" if data.lstrip()[:1] == b"{" else _by_content(data)
    return (TEXT_ENDINGS[0] if told is None else FOREIGN[told].endings[0]) + (".gz" if packed else "")


def ending_of(name: str) -> str:
    """Ending of a file name in small letters; ``.gz`` at its end does not count."""
    path = PurePath(name)
    ending = path.suffix.lower()
    return PurePath(path.stem).suffix.lower() if ending == ".gz" else ending


def known_ending(name: str) -> str:
    """Ending of a file name that a reader has.

    Raises
    ------
    MeasurementError
        When none has it.
    """
    ending = ending_of(name)
    endings = sorted({each for kind in KINDS.values() for each in kind.endings})
    if ending in MDF_ENDINGS:
        raise MeasurementError(name, rule=NO_MDF)
    if ending not in endings:
        rule = f"kind of file {ending or 'without suffix'!s} is not read; known: {', '.join(endings)}"
        raise MeasurementError(name, rule=rule)
    return ending


def kind_of(data: bytes, name: str) -> FileKind:
    """Kind of a file from the beginning of its content, or from its name where that says nothing.

    Raises
    ------
    MeasurementError
        Neither says it, or they contradict each other.
    """
    if data.startswith(MDF):
        raise MeasurementError(name, rule=NO_MDF)
    told = _by_content(data)
    ending = ending_of(name) if told is not None else known_ending(name)
    installed = next((kind for kind in INSTALLED.values() if ending in kind.endings), None)
    if installed is not None:
        return installed
    if ending in LOOSE_ENDINGS:
        return TEXT if told is None else FOREIGN[told]
    if ending in TEXT_ENDINGS:
        if told is None or told == "UFF":  # a table may begin with -1
            return TEXT
        raise MeasurementError(name, rule=f"ends in {ending}, but is a {told} file: name it so")
    named = next((kind for kind in KINDS.values() if ending in kind.endings), None)
    if told is None:
        assert named is not None
        if named.name in ("JSON", "MAT"):  # JSON and MAT version 4 begin in no way of their own
            return named
        raise MeasurementError(name, rule=f"is not a {named.name} file: it does not begin like one")
    if named is None or named.name == told or (named.name == "MAT" and told == "HDF5"):
        return named or FOREIGN[told]
    raise MeasurementError(name, rule=f"ends in {ending}, but is a {told} file: name it so")


def _by_content(data: bytes) -> str | None:
    if data.startswith(b"RIFF") and data[8:12] == b"WAVE":
        return "WAV"
    if data.startswith((b"MATLAB 5.0", b"MATLAB 7.3")):
        return "MAT"
    if data.startswith(b"TDSm"):
        return "TDMS"
    if data.startswith(_HDF5) or data[512:520] == _HDF5:
        return "HDF5"
    if data.startswith(b"PK\x03\x04"):
        return "XLSX" if data[30:].startswith((b"[Content_Types].xml", b"_rels/", b"docProps/", b"xl/")) else "NPZ"
    if data.startswith(b"PAR1"):
        return "Parquet"
    if data.startswith(b"ARROW1"):
        return "Arrow"
    return "UFF" if re.match(rb"\s*-1[ \t]*\r?\n\s*\d", data[:400]) else None
