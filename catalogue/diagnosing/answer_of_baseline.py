"""What an answer says of recordings of the machine in order, and of what has changed since: shapes of its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class Frozen(BaseModel):
    """A part of an answer."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FittedNumber(Frozen):
    """What a baseline says of a number: factor on what it should be, and standard deviation of its logarithm."""

    factor: float
    scatter: float


class BaselineRecording(Frozen):
    """A recording of the machine in order: name, and checksum of its bytes."""

    measurement: str
    measurement_sha256: str


class BaselineShown(Frozen):
    """What recordings of the machine in order said of machine and sensors.

    Attributes
    ----------
    measurement, measurement_sha256 : str
        Name of that recording, and checksum of its bytes; of several, of the first.
    further : tuple of BaselineRecording
        The others.
    heard : bool
        Whether what is worn was told by how the recording differs from these, too.
    used : bool
        Whether a machine in order explains it; no number or gain of it is used otherwise.
    p_before, p_after : float
        Share of simulated machines in order that fit worse: with the numbers of the machine file, and as fitted.
    numbers, gains : mapping of str to FittedNumber
        By path as in a plan ("frame.mass"), and by sensor.
    """

    measurement: str
    measurement_sha256: str
    used: bool
    p_before: float
    p_after: float
    numbers: Mapping[str, FittedNumber]
    gains: Mapping[str, FittedNumber]
    further: tuple[BaselineRecording, ...] = ()
    heard: bool = False


class LevelSince(Frozen):
    """A level that is not as it was in recordings of the machine in order.

    Attributes
    ----------
    channel : str
        "x", "y", "theta" or a sensor.
    low_order, high_order : float
        Edges of its band, in orders of the drive.
    difference_db : float
        How much higher it is than it was, the speeds of both allowed for.
    usual_db : float
        Standard deviation of that where nothing has changed.
    """

    channel: str
    low_order: float
    high_order: float
    difference_db: float
    usual_db: Annotated[float, Field(gt=0.0)]


class PastShown(Frozen):
    """A recording beside the machine's own past.

    Attributes
    ----------
    p_value : float
        Share of pairs of recordings of a machine in order that differ by as much.
    changed : tuple of LevelSince
        Levels that differ by more than three of their standard deviations, the farthest first, five at most.
    """

    p_value: Annotated[float, Field(ge=0.0, le=1.0)]
    changed: tuple[LevelSince, ...]
