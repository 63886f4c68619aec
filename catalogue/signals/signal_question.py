"""What can be asked of a recording that is looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from jointplay.solver.spectra.spectrum import Scaling

UnitShown = Literal["m/s2", "g", "mm/s", "um"]
SignalView = Literal["waveform", "spectrum", "spectrogram", "revolution", "overall", "contact", "matched"]
LineKind = Literal["value", "low", "high", "mean", "rms", "first", "second", "in_order"]
SignalAxis = Literal["hz", "order"]
SignalOf = Literal["sensors", "frame"]


@dataclass(frozen=True)
class SignalQuestion:
    """What is to be seen of a recording.

    Parameters
    ----------
    view : {"waveform", "spectrum", "spectrogram", "revolution", "overall", "contact", "matched"}
    unit : {"m/s2", "g", "mm/s", "um"}
    of : {"sensors", "frame"}
        Channels as they are, or the motions of the frame that they see.
    axis : {"hz", "order"}
        Of spectra; by order a spectrogram goes over revolutions, else over seconds.
    scaling : {"psd", "power", "rms", "peak"}
        Of spectra.
    channel : str
        The only one that is wanted; empty for all. A spectrogram is of one: the first where none is named.
    start, end : float, optional
        Part of the horizontal axis, in its unit; all of it where they are not given. A revolution is always whole.
    points : int
        Places on the axis, at most.
    speed : float, optional
        Of the drive [rad/s].
    """

    view: SignalView
    unit: UnitShown = "m/s2"
    of: SignalOf = "sensors"
    axis: SignalAxis = "hz"
    scaling: Scaling = "rms"
    channel: str = ""
    start: float | None = None
    end: float | None = None
    points: int = 1200
    speed: float | None = None
