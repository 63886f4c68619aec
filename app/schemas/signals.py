"""Shapes of a recording as it is looked at, at the HTTP interface."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from jointplay.app.schemas.resources import Shape
from jointplay.catalogue.signals.signal_question import LineKind, SignalAxis, SignalOf, SignalView, UnitShown
from jointplay.solver.spectra.spectrum import Scaling

Place = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1e9)]


class SignalQuery(BaseModel):
    """What is to be seen of a recording; an unknown parameter is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    view: Annotated[
        SignalView,
        Field(
            examples=["spectrum"],
            description="`waveform` over time; `spectrum`; `spectrogram`; `revolution`: mean and rms by the angle of"
            " the drive; `overall`: one figure a channel; `contact`: forces in the joints by that angle, simulated of"
            " the machine as the diagnosis matched it; `matched`: levels by order of machines of the catalogue, of the"
            " first and the second hypothesis and in order.",
        ),
    ] = "waveform"
    unit: Annotated[
        UnitShown,
        Field(
            examples=["mm/s"],
            description="mm/s and um are integrated, in the frequency domain, above `high_pass_hz` of the answer.",
        ),
    ] = "m/s2"
    of: Annotated[
        SignalOf,
        Field(examples=["frame"], description="Its channels, or x, y and theta of the frame, which need `diagnosis`."),
    ] = "sensors"
    axis: Annotated[
        SignalAxis,
        Field(examples=["order"], description="Of spectra. By order a spectrogram goes over revolutions."),
    ] = "hz"
    scaling: Annotated[Scaling, Field(examples=["rms"], description="Of the lines of a spectrum.")] = "rms"
    channel: Annotated[
        str,
        Field(max_length=200, examples=["x"], description="Only this one. A spectrogram has one: else the first."),
    ] = ""
    start: Annotated[
        Place | None, Field(alias="from", examples=[0.5], description="Where the part of the axis begins, in its unit.")
    ] = None
    end: Annotated[Place | None, Field(alias="to", examples=[20.0], description="Where it ends.")] = None
    diagnosis: Annotated[
        str | None,
        Field(
            max_length=80, description="Of this measurement: says machine, drive speed, which column is which sensor."
        ),
    ] = None
    speed: Annotated[
        str | None,
        Field(max_length=80, examples=["606.8 rpm"], description="Of the drive, in place of the diagnosis's."),
    ] = None
    points: Annotated[int, Field(ge=2, le=20_000, examples=[12], description="Places on the axis, at most.")] = 1200


Kind = Annotated[
    LineKind,
    Field(
        description="`low` and `high`: of the samples of each place, where there are more of them than points; `first`,"
        " `second` and `in_order`: of the machines that are laid over."
    ),
]


class SignalLine(Shape):
    """A line over the axis."""

    name: str = Field(description="Of the channel, or of the frame's motion.")
    kind: Kind
    unit: str
    values: list[float]


class SignalRow(Shape):
    """One value of a line, by itself."""

    at: float = Field(description="Place on the axis: s, Hz, orders, revolutions or the angle of the drive.")
    name: str = Field(description="Of the channel, or of the frame's motion.")
    kind: Kind
    unit: str
    value: float


class SignalMap(Shape):
    """A spectrogram."""

    rows: list[float] = Field(description="Middles of its rows: Hz or orders.")
    unit: str = Field(description="What the levels relate to.")
    levels_db: list[list[float]] = Field(description="By row, then by place; nothing lies 80 dB below the loudest.")


class SignalOverall(Shape):
    """How much a channel shakes in all."""

    name: str
    unit: str
    rms: float = Field(description="Of the whole recording, without its mean.")
    peak: float
    velocity_rms: float | None = Field(
        description="mm/s (theta: mrad/s), within `band_hz`; null where the sample rate has none of it."
    )


class SignalOut(Shape):
    """What is seen of a recording."""

    measurement: str
    view: SignalView
    unit: UnitShown
    of: SignalOf
    sample_rate_hz: float | None = Field(description="Null for a spectrum.")
    duration_s: float | None = Field(description="Null for a spectrum.")
    drive_speed_rpm: float | None
    high_pass_hz: float | None = Field(description="What is slower was left out in integrating; null where none was.")
    axis: str = Field(description="`time`, `frequency`, `order`, `revolution` or `angle`; empty without one.")
    axis_unit: str
    ends: tuple[float, float] = Field(description="Of the whole axis.")
    at: list[float] = Field(description="The places.")
    lines: list[SignalLine]
    map: SignalMap | None = Field(description="Of a spectrogram, else null.")
    overall: list[SignalOverall]
    band_hz: tuple[float, float] | None = Field(description="Of the overall velocity: 10 to 1000 Hz, or what there is.")
    resolution: float | None = Field(description="Distance of a spectrum's lines, before they are thinned out.")
    notes: list[str]
