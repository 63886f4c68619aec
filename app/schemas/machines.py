"""Bodies about machine files: their versions, and what is made of one that is checked."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import Field

from jointplay.app.schemas.resources import FieldError, Page, Shape


class MachineItem(Shape):
    """A machine."""

    name: str
    content_key: str = Field(description="SHA-256 of the machine's content; also its ETag.")
    links: int
    turning_joints: list[str]
    sliding_joints: list[str]
    shipped: bool = Field(description="Whether it ships with the program; others were put there.")
    sensors: list[str]


class PinOrbit(Shape):
    """Where the pin of a worn joint is in its socket over one revolution."""

    joint: str
    clearance_um: float = Field(description="Radial.")
    at: list[tuple[float, float]] = Field(
        description="x, y of the pin's middle from the socket's, in parts of the clearance: at 1 it touches. Evenly"
        " over the revolution of the drive, the drawn position first."
    )


class Motion(Shape):
    """How the drawing of a machine moves in one period of its drive."""

    view_box: str = Field(description="Of the drawing, so that nothing leaves it.")
    transforms: dict[str, list[str]] = Field(
        description="By the class of an element of the drawing: its `transform` at each position, evenly over a period,"
        " the drawn one first. What is not there stands still."
    )
    pins: list[PinOrbit] = Field(description="Of the joints with clearance that were asked for; simulated.")


class MachinePage(Page):
    """A page of machines."""

    items: list[MachineItem]


class MachineVersionItem(Shape):
    """What was put under the name of a machine once."""

    number: int = Field(description="From 1 on, the newest last.")
    content_key: str
    saved_at: datetime | None = Field(description="Null for what ships with the program.")


class MachineVersionPage(Page):
    """A page of versions of a machine."""

    items: list[MachineVersionItem]


class MachineCheck(Shape):
    """What a machine file is, right or wrong."""

    refusal: FieldError | None = Field(description="Why it would be refused; null for one that is right.")
    account: dict[str, Any] | None = Field(
        description="What `jointplay check --json` prints: joints, degrees of freedom, what the model holds and leaves"
        " out, suspension modes, notes on what is implausible. Null for a file that would be refused."
    )
