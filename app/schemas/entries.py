"""Shapes of a catalogue's entries at the HTTP interface."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from jointplay.app.schemas.resources import Page, Shape
from jointplay.solver.spectra.spectrum import Quantity, Scaling

Micrometres = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class EntryFilter(BaseModel):
    """Which entries of a catalogue; a member that is not given does not choose, an unknown one is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    hypothesis: Annotated[
        str | None, Field(max_length=400, examples=["A"], description="Label of the hypothesis: `healthy`, `A+F`.")
    ] = None
    joint: Annotated[str | None, Field(max_length=200, examples=["A"], description="A joint that is worn.")] = None
    stratum: Annotated[
        Literal["trusted", "wide"] | None,
        Field(examples=["trusted"], description="How much of the machine was uncertain."),
    ] = None
    status: Annotated[
        str | None, Field(max_length=80, examples=["ok"], description="`ok`, or how the simulation failed.")
    ] = None
    law: Annotated[Literal["own", "linear", "hertz"] | None, Field(examples=["own"], description="Contact law.")] = None
    min_clearance_um: Annotated[
        Micrometres | None,
        Field(
            examples=[50],
            description="Least radial clearance: of `joint` where it is given, else the greatest of all joints.",
        ),
    ] = None
    max_clearance_um: Annotated[
        Micrometres | None, Field(examples=[400], description="Greatest radial clearance, of the same joint.")
    ] = None


class EntryQuery(EntryFilter):
    """Which entries, and which page of them."""

    cursor: Annotated[str | None, Field(max_length=200, description="`next_cursor` of the page before.")] = None
    limit: Annotated[int | None, Field(ge=1, le=500, examples=[20], description="Number of items in the page.")] = None


class EntryItem(Shape):
    """One simulated case, without its spectrum."""

    key: str = Field(description="SHA-256 of machine, fault, numbers, settings and solver version.")
    hypothesis: str
    worn: list[str] = Field(description="The worn joints; others with clearance have the play of their fits.")
    clearances_um: dict[str, float] = Field(description="Radial clearance of the joints that have one.")
    status: str = Field(description="`ok`, or how the simulation failed.")
    message: str
    stratum: str = Field(description="`trusted`, or `wide` where the machine's own data were uncertain, too.")
    law: str = Field(description="Contact law; `own` is that of the machine's file.")
    draw: int
    drive_speed_rpm: float


class EntryPage(Page):
    """A page of entries."""

    items: list[EntryItem]


class ComplexSeries(Shape):
    """Complex numbers, one a band."""

    re: list[float]
    im: list[float]


class EntrySpectrum(Shape):
    """Spectrum of the frame's acceleration at its centre of gravity, in bands of orders of the drive."""

    quantity: str
    point: str
    units: dict[str, str] = Field(description="Of `power` by motion; of `cross_power`, the products.")
    band_edges_orders: list[float] = Field(description="One more than there are bands; multiples of the drive speed.")
    power: dict[str, list[float]] = Field(description="Mean square in each band, by motion (x, y, theta).")
    cross_power: dict[str, ComplexSeries] = Field(description="Of two motions: `x y`, `x theta`, `y theta`.")
    spread_db: dict[str, list[float]] = Field(
        description="Standard deviation of the band level over the averaged windows, by motion."
    )


class LevelQuery(BaseModel):
    """As what the levels of an entry are wanted."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    quantity: Annotated[Quantity, Field(examples=["displacement"], description="Of the frame's motion.")] = (
        "acceleration"
    )
    scaling: Annotated[
        Scaling,
        Field(
            examples=["peak"],
            description="`power`: mean square in the band; `psd`: by its width in Hz; `rms` and `peak`: amplitude of a"
            " sine of this mean square.",
        ),
    ] = "power"


class EntryLevels(Shape):
    """Levels of the frame's motion at its centre of gravity, in bands of orders of the drive."""

    key: str
    quantity: Quantity
    scaling: Scaling
    point: str
    units: dict[str, str] = Field(description="By motion.")
    drive_speed_rpm: float
    band_edges_orders: list[float] = Field(description="One more than there are bands; multiples of the drive speed.")
    levels: dict[str, list[float]] | None = Field(
        description="By motion (x, y, theta), one a band; displacement and velocity as if all of a band's acceleration"
        " were at its middle. null where the simulation failed."
    )


class EntryDetail(EntryItem):
    """One simulated case with its spectrum."""

    parameters: dict[str, float] = Field(description="Numbers that differ from the machine's file, by path, SI.")
    segments: int = Field(description="Windows averaged.")
    period: int = Field(description="Revolutions after which the motion repeats; 0 where it was not seen to.")
    transient_s: float | None = Field(description="Start-up time left out.")
    guard_db: float | None = Field(description="Mean difference from the same case computed more finely.")
    spectrum: EntrySpectrum | None = Field(description="null where the simulation failed.")
