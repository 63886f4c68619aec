"""What a reader gives of a file; how it passes from the capped process; and what is checked of it, whoever read it.

Readers are known to take damaged files in silence.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.moments import RawMoment
from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True)
class Limits:
    """How much of somebody else's file is read.

    Parameters
    ----------
    file_bytes : int
        Largest file as it comes.
    decoded_bytes : int
        Largest after decompression.
    columns : int
        Most columns.
    min_samples : int
        Fewest samples of a recording.
    reader_memory : int
        Bytes that the process of a foreign reader may take beyond what it has before it sees the file.
    reader_seconds : float
        Its time of a processor for one file; by the clock it may take ten times as long, as beside other work it does.
    """

    file_bytes: int = 200_000_000
    decoded_bytes: int = 400_000_000
    columns: int = 256
    min_samples: int = 256
    reader_memory: int = 1_000_000_000
    reader_seconds: float = 20.0

    @property
    def reader_clock_seconds(self) -> float:
        """Time by the clock after which a reader is ended even if it computes nothing."""
        return 10.0 * self.reader_seconds


@dataclass(frozen=True)
class RawColumn:
    """A column of a file.

    Parameters
    ----------
    label : str
        As the file has it.
    name : str
        Without its unit.
    unit : str or None
        As the file has it.
    position : str
        Where it stands, for messages: "column 2".
    is_text : bool
        It holds no numbers, and is left out.
    """

    label: str
    name: str
    unit: str | None
    position: str
    is_text: bool = False


@dataclass(frozen=True)
class SpectrumForm:
    """What the numbers of a spectrum are; None is what the file does not say.

    Parameters
    ----------
    scaling : {"psd", "power", "amplitude"} or None
        Power spectral density; squares; linear amplitudes.
    detector : {"rms", "peak", "peak-to-peak"} or None
        Of amplitudes and powers; a density is of rms.
    decibel : bool
        Levels in dB.
    reference : float or None
        Of levels [unit of the column].
    line_widths : float or None
        Equivalent noise bandwidth of the window, lines: 1.5 for Hann.
    """

    scaling: Literal["psd", "power", "amplitude"] | None = None
    detector: Literal["rms", "peak", "peak-to-peak"] | None = None
    decibel: bool = False
    reference: float | None = None
    line_widths: float | None = None


@dataclass(frozen=True, eq=False)
class RawRecording:
    """A recording as a file holds it: units as written, nothing judged yet.

    Parameters
    ----------
    source : str
        What messages call the file.
    columns : tuple of RawColumn, (c,)
        A time column may be among them.
    values : (n, c) array
        Finite, but for cells that are absent.
    sample_rate : float or None
        Where the file states it [Hz].
    facts : tuple of str
        What was understood so far, one line each.
    lines : range or (n,) array, optional
        Lines of the file that the samples came from.
    warnings : tuple of str
        What a diagnosis should mention, one line each.
    declared : int or None
        Samples a channel that the file says it has.
    relative : bool
        Values are fractions of a full scale that the file does not say.
    ceiling : float or None
        Largest value the file's coding can hold (PCM); samples there are clipped.
    form : SpectrumForm or None
        What the numbers of a spectrum are; None for a recording over time.
    turns : (k,) array or None
        Ends of revolutions of the drive in samples, from a tacho's pulses.
    moment : RawMoment or None
        What the file says of when it was measured.
    measured_at : datetime or None
        When it was measured, in UTC; what a profile says, or what was understood of the file.
    absent : bool
        NaN stands for a cell in which the file has no number.
    """

    source: str
    columns: tuple[RawColumn, ...]
    values: FloatArray
    sample_rate: float | None = None
    facts: tuple[str, ...] = ()
    lines: range | FloatArray | None = None
    warnings: tuple[str, ...] = ()
    declared: int | None = None
    relative: bool = False
    ceiling: float | None = None
    form: SpectrumForm | None = None
    turns: FloatArray | None = None
    moment: RawMoment | None = None
    measured_at: datetime | None = None
    absent: bool = False

    def line_of(self, sample: int) -> int | None:
        """Line of the file a sample came from, where it has lines."""
        return None if self.lines is None else int(self.lines[sample])


#: From bytes (decompressed), the name for messages and the limits to a recording; raises MeasurementError.
Reader = Callable[[bytes, str, Limits], RawRecording]


def encode(raw: RawRecording) -> dict[str, Any]:
    """Answer that stands for a recording.

    Parameters
    ----------
    raw : RawRecording

    Returns
    -------
    dict
        Members of JSON, and the numbers (n, c) under ``values``.
    """
    values = raw.values
    if isinstance(raw.lines, np.ndarray):
        values = np.column_stack([values, raw.lines])
    return {
        "columns": [asdict(column) for column in raw.columns],
        "sample_rate": raw.sample_rate,
        "facts": list(raw.facts),
        "warnings": list(raw.warnings),
        "declared": raw.declared,
        "relative": raw.relative,
        "ceiling": raw.ceiling,
        "absent": raw.absent,
        "form": None if raw.form is None else asdict(raw.form),
        "moment": None if raw.moment is None else asdict(raw.moment),
        "lines": [raw.lines.start, raw.lines.stop] if isinstance(raw.lines, range) else None,
        "shape": list(values.shape),
        "values": np.ascontiguousarray(values, dtype="<f8"),
    }


def decode(head: dict[str, Any], body: bytes | memoryview, source: str) -> RawRecording:
    """Recording of an answer; the inverse of :func:`encode`.

    Parameters
    ----------
    head : dict
        Members of JSON.
    body : bytes or memoryview
        The numbers; lines that are not one after the other stand in a last column.
    source : str
        What messages call the file.

    Returns
    -------
    RawRecording
    """
    values = np.frombuffer(body, dtype="<f8").reshape(head["shape"])
    lines: range | FloatArray | None = None if head["lines"] is None else range(*head["lines"])
    if values.ndim == 2 and values.shape[1] == len(head["columns"]) + 1:
        values, lines = values[:, :-1], values[:, -1]
    return RawRecording(
        source=source,
        columns=tuple(RawColumn(**column) for column in head["columns"]),
        values=values.astype(np.float64),
        lines=lines,
        sample_rate=head["sample_rate"],
        facts=tuple(head["facts"]),
        warnings=tuple(head["warnings"]),
        declared=head["declared"],
        relative=head["relative"],
        ceiling=head["ceiling"],
        absent=head["absent"],
        form=None if head["form"] is None else SpectrumForm(**head["form"]),
        moment=None if head["moment"] is None else RawMoment(**head["moment"]),
    )


#: Nothing that is measured is larger, in whatever unit; squares of it are still numbers.
LARGEST = 1e30
#: Characters that no file means: they cannot be stored, or not be sent.
NO_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff]")


def check(raw: RawRecording, limits: Limits) -> RawRecording:
    """Refuse what is no recording; warn of samples at the end of what the file's coding can hold.

    Parameters
    ----------
    raw : RawRecording
    limits : Limits

    Raises
    ------
    MeasurementError
        Empty, not finite, shorter or longer than it declares, larger than is read, names that do not fit the columns
        or are no text.
    """
    if raw.values.ndim != 2 or not raw.values.size or not raw.columns:
        raise MeasurementError(raw.source, rule="is empty")
    samples, count = raw.values.shape
    if count != len(raw.columns):
        raise MeasurementError(raw.source, rule=f"{count} columns of numbers, but {len(raw.columns)} names")
    if count > limits.columns:
        raise MeasurementError(raw.source, rule=f"{count} columns; at most {limits.columns} are read")
    if raw.values.nbytes > max(limits.decoded_bytes * 8, 8):
        raise MeasurementError(
            raw.source, rule=f"holds more than {limits.decoded_bytes / 1e6:g} MB, the most that is read"
        )
    if raw.declared is not None and raw.declared != samples:
        rule = f"is truncated or damaged: it declares {raw.declared} samples, {samples} are there"
        raise MeasurementError(raw.source, rule=rule)
    bad = np.argwhere(np.isinf(raw.values) if raw.absent else ~np.isfinite(raw.values))
    if len(bad):
        row, column = (int(each) for each in bad[0])
        name, value = raw.columns[column].name, float(raw.values[row, column])
        raise MeasurementError(raw.source, raw.line_of(row), name, value, f"sample {row + 1} is not finite")
    huge = np.argwhere(np.abs(raw.values) > LARGEST)
    if len(huge):
        row, column = (int(each) for each in huge[0])
        name, value = raw.columns[column].name, float(raw.values[row, column])
        raise MeasurementError(raw.source, raw.line_of(row), name, value, f"sample {row + 1} is beyond all measure")
    for each in raw.columns:
        if NO_TEXT.search(f"{each.label}{each.name}{each.unit or ''}"):
            shown = each.name.encode("ascii", "backslashreplace").decode()
            rule = f"{each.position}: its name or unit holds a character that is no text"
            raise MeasurementError(raw.source, None, shown, rule=rule)
    names = [column.name for column in raw.columns]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise MeasurementError(raw.source, None, twice, rule="two channels have this name")
    return dataclasses.replace(raw, warnings=(*raw.warnings, *_at_the_ceiling(raw)))


def _at_the_ceiling(raw: RawRecording) -> list[str]:
    if raw.ceiling is None:
        return []
    found = []
    for column, signal in zip(raw.columns, raw.values.T, strict=True):
        # One sample may just touch the end; an overload stays there.
        at_end = (signal >= raw.ceiling) | (signal <= -raw.ceiling)
        count = int(np.count_nonzero(at_end[1:] & at_end[:-1]))
        if count:
            found.append(f"channel {column.name!r} is clipped: {int(at_end.sum())} samples at full scale")
    return found
