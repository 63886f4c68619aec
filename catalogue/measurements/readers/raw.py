"""What a reader makes of a file: numbers as they stand there, and what the file says about them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

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
    """

    label: str
    name: str
    unit: str | None
    position: str


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
        Finite.
    sample_rate : float or None
        Where the file states it [Hz].
    facts : tuple of str
        What was understood so far, one line each.
    line_of : callable
        Line of the file a sample came from, or None.
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
    """

    source: str
    columns: tuple[RawColumn, ...]
    values: npt.NDArray[np.float64]
    sample_rate: float | None = None
    facts: tuple[str, ...] = ()
    line_of: Callable[[int], int | None] = field(default=lambda sample: None)
    warnings: tuple[str, ...] = ()
    declared: int | None = None
    relative: bool = False
    ceiling: float | None = None
    form: SpectrumForm | None = None
    turns: npt.NDArray[np.float64] | None = None


#: From bytes (decompressed), the name for messages and the limits to a recording; raises MeasurementError.
Reader = Callable[[bytes, str, Limits], RawRecording]
