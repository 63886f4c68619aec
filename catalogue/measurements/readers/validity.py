"""What is checked of every file, whoever read it: readers are known to take damaged files in silence."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.raw import Limits, RawRecording

#: Nothing that is measured is larger, in whatever unit; squares of it are still numbers.
LARGEST = 1e30
#: Characters that no file means: they cannot be stored, or not be sent.
NO_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff]")


def checked(raw: RawRecording, limits: Limits) -> RawRecording:
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
    bad = np.argwhere(~np.isfinite(raw.values))
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
