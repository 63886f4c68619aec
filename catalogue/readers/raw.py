"""What a reader makes of a file: numbers as they stand there, and what the file says about them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt


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
    """

    file_bytes: int = 200_000_000
    decoded_bytes: int = 400_000_000
    columns: int = 256
    min_samples: int = 256


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
    """

    label: str
    name: str
    unit: str | None
    position: str


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
        Finite.
    sample_rate : float or None
        Where the file states it [Hz].
    facts : tuple of str
        What was understood so far, one line each.
    line_of : callable
        Line of the file a sample came from, or None.
    """

    source: str
    columns: tuple[RawColumn, ...]
    values: npt.NDArray[np.float64]
    sample_rate: float | None = None
    facts: tuple[str, ...] = ()
    line_of: Callable[[int], int | None] = field(default=lambda sample: None)


#: From bytes (decompressed), the name for messages and the limits to a recording; raises MeasurementError.
Reader = Callable[[bytes, str, Limits], RawRecording]
