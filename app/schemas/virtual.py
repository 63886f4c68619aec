"""Bodies that ask for recordings nobody measured: simulated ones, and those that ship with the program."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from jointplay.app.schemas.resources import Shape

BuiltIn = Literal["quick-return-01", "quick-return-03", "quick-return-05"]


class VirtualRequest(Shape):
    """A recording to simulate."""

    model_config = ConfigDict(
        json_schema_extra={"example": {"catalogue": "slider-crank", "clearances_um": {"B": 150.0}, "revolutions": 12}}
    )

    catalogue: Annotated[
        str, Field(min_length=1, max_length=128, description="Id or name of a catalogue, whose machine is simulated.")
    ]
    clearances_um: Annotated[
        dict[str, Annotated[float, Field(ge=0, le=10_000, strict=True, allow_inf_nan=False)]],
        Field(
            default={},
            max_length=64,
            description="Radial clearance of joints; 0 is none. One that is not named has the play of a new one.",
        ),
    ]
    drive_speed_rpm: Annotated[
        float | None,
        Field(default=None, gt=0, le=100_000, strict=True, allow_inf_nan=False, description="The machine's own."),
    ]
    sensor_noise_m_s2: Annotated[
        float,
        Field(default=0.01, ge=0, le=1000, strict=True, allow_inf_nan=False, description="White, rms, each sensor."),
    ]
    revolutions: Annotated[int, Field(default=20, ge=6, le=200, strict=True, description="Length of the recording.")]
    seed: Annotated[int, Field(default=1, ge=0, le=2**31, strict=True, description="Of the noise.")]


class BuiltInRequest(Shape):
    """A recording that ships with the program."""

    model_config = ConfigDict(json_schema_extra={"example": {"name": "quick-return-03"}})

    name: Annotated[BuiltIn, Field(description="All are of the machine quick-return.")]
