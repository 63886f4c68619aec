"""Links, supports, loads, drives, sensors and the start of the motion, as they stand in a machine file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    StrictBool,
    model_serializer,
    model_validator,
)

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import (
    Direction,
    Name,
    NumberOrTable,
    Point,
    QuantityField,
    RuleError,
    Table,
    VectorField,
    nearest,
)

Stiffness = Annotated[float, QuantityField(units.STIFFNESS, at_least=0)]
Damping = Annotated[float, QuantityField(units.DAMPING, at_least=0)]
Angle = Annotated[float, QuantityField(units.ANGLE)]
Length = Annotated[float, QuantityField(units.LENGTH)]
Velocity = Annotated[tuple[float, float], VectorField((QuantityField(units.SPEED),) * 2)]
AngularSpeed = Annotated[float, QuantityField(units.ANGULAR_SPEED)]
Force = Annotated[tuple[float, float], VectorField((QuantityField(units.FORCE),) * 2)]
Torque = Annotated[float, QuantityField(units.TORQUE)]
Motion: TypeAlias = Literal["x", "y", "theta"]
LoadTable: TypeAlias = tuple[tuple[float, float, float, float], ...]
ShiftTable: TypeAlias = tuple[tuple[float, float, float], ...]

_LOAD_COLUMNS = (units.FORCE, units.FORCE, units.TORQUE)


class Part(BaseModel):
    """Common ground: frozen, and unknown keys are refused with the nearest known one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key in data:
                if key not in cls.model_fields:
                    raise RuleError(f"unknown key{nearest(str(key), cls.model_fields)}", (key,), data[key])
        return data


class Link(Part):
    """A rigid link.

    ``mass`` [kg] and ``inertia`` [kg m2] about the centre of gravity; both may be left out only when ``fixed``.
    ``cg`` [m]: centre of gravity in the drawing. ``locked``: motions of this link that are blocked.
    """

    mass: Annotated[float, QuantityField(units.MASS, above=0)] | None = None
    inertia: Annotated[float, QuantityField(units.INERTIA, above=0)] | None = None
    cg: Point = (0.0, 0.0)
    fixed: StrictBool = False
    locked: tuple[Motion, ...] = ()


class InitialVelocity(Part):
    """Given velocity of a link's centre of gravity [m/s] and its rotation [rad/s]; what is not given is found."""

    velocity: Velocity | None = None
    omega: AngularSpeed | None = None


class Initial(Part):
    """How the motion starts: as drawn, or from the static equilibrium."""

    pose: Literal["drawn", "equilibrium"] = "drawn"
    velocities: Mapping[Name, InitialVelocity] = Field(default_factory=dict)


class AnchorMotion(Part):
    """How the end of a support on the ground moves, beside where it was drawn: a sine, or a table over time.

    ``displacement`` [m] times the sine of a ``frequency`` [Hz], or of so many times the drive angle as ``order`` says,
    plus ``phase`` [rad].
    """

    displacement: Annotated[tuple[float, float], VectorField((QuantityField(units.LENGTH),) * 2)] = (0.0, 0.0)
    frequency: Annotated[float, QuantityField(units.FREQUENCY, above=0)] | None = None
    order: Annotated[float, QuantityField(units.RATIO, above=0)] | None = None
    phase: Angle = 0.0
    over_time: Annotated[ShiftTable, Table((units.TIME, units.LENGTH, units.LENGTH))] | None = None


class Anchored(Part):
    """What ends on the ground, unless on another link; its ``motion`` there is the sum of its parts."""

    motion: tuple[AnchorMotion, ...] = ()

    @model_serializer(mode="wrap")
    def _leave_out_what_is_not_said(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Files could not say it once; machines that say nothing of it keep the content key they had then.
        return {key: value for key, value in write(self).items() if key != "motion" or value}


class LineSupport(Anchored):
    """What acts along the line from ``at`` on ``link`` to ``anchor`` on the ground, or on ``to_link``."""

    kind: str
    link: Name
    at: Point
    anchor: Point

    @property
    def drawn_length(self) -> float:
        """From ``at`` to ``anchor``, m."""
        return math.dist(self.at, self.anchor)

    @model_validator(mode="after")
    def _check_direction(self) -> Self:
        if self.drawn_length == 0:
            raise RuleError("must not be the point at; a mount needs no anchor", ("anchor",), list(self.anchor))
        return self


class Spring(LineSupport):
    """A spring along a line.

    Its free length [m] is given, or follows from ``static_deflection`` [m] (free length minus drawn length), or is the
    drawn length.
    """

    kind: Literal["spring"] = "spring"
    stiffness: Stiffness
    free_length: Annotated[float, QuantityField(units.LENGTH, at_least=0)] | None = None
    static_deflection: Length | None = None
    to_link: Name | None = None

    @model_validator(mode="after")
    def _check_free_length(self) -> Self:
        at, deflection = ("static_deflection",), self.static_deflection
        if deflection is not None and self.free_length is not None:
            raise RuleError("give only one of free_length, static_deflection", at, deflection)
        if deflection is not None and self.drawn_length + deflection < 0:
            raise RuleError("would make the free length negative", at, deflection)
        return self


class Damper(LineSupport):
    """A damper along a line."""

    kind: Literal["damper"] = "damper"
    damping: Damping
    to_link: Name | None = None


class Mount(Anchored):
    """Spring and damper in fixed x and y directions at one point, unstressed as drawn."""

    kind: Literal["mount"] = "mount"
    link: Name
    at: Point
    stiffness: Annotated[tuple[float, float], VectorField((QuantityField(units.STIFFNESS, at_least=0),) * 2)]
    damping: Annotated[tuple[float, float], VectorField((QuantityField(units.DAMPING, at_least=0),) * 2)] = (0.0, 0.0)
    to_link: Name | None = None


class Load(Part):
    """Force and torque on a link at a point that moves with it: constant, over time, or over the drive angle.

    With an ``order`` force and torque are amplitudes: of the sine of so many times the drive angle, plus ``phase``.
    """

    link: Name
    at: Point
    force: Force = (0.0, 0.0)
    torque: Torque = 0.0
    order: Annotated[int, Field(ge=1, le=1000, strict=True)] | None = None
    phase: Angle = 0.0
    over_time: Annotated[LoadTable, Table((units.TIME, *_LOAD_COLUMNS))] | None = None
    over_angle: Annotated[LoadTable, Table((units.ANGLE, *_LOAD_COLUMNS), period=2 * math.pi)] | None = None


class Sensor(Part):
    """An accelerometer on the frame, at a point, along a direction (unit length) that turns with the frame."""

    name: Name
    at: Point
    direction: Direction


Support: TypeAlias = Annotated[Spring | Damper | Mount, Field(discriminator="kind")]


Curve: TypeAlias = tuple[tuple[float, float], ...]


class Ripple(Part):
    """One term of a drive's angular ripple: ``amplitude`` [rad] at ``order`` times the speed, ``phase`` [rad]."""

    order: Annotated[float, QuantityField(units.RATIO, above=0)]
    amplitude: Angle
    phase: Angle = 0.0


class Harmonic(Part):
    """One term of a sliding drive: ``amplitude`` [m] at ``frequency`` [Hz], ``phase`` [rad]."""

    frequency: Annotated[float, QuantityField(units.FREQUENCY, above=0)]
    amplitude: Length
    phase: Angle = 0.0


class RotationDrive(Part):
    """Prescribed rotation of a turning joint: ``speed`` [rad/s] of links[0] relative to links[1], or a run-up table."""

    kind: Literal["rotation"] = "rotation"
    joint: Name
    speed: Annotated[
        float | Curve, NumberOrTable(QuantityField(units.ANGULAR_SPEED), Table((units.TIME, units.ANGULAR_SPEED)))
    ]
    ripple: tuple[Ripple, ...] = ()


class TranslationDrive(Part):
    """Prescribed sliding of a sliding joint: ``speed`` [m/s] of links[0] along ``direction``, and harmonics."""

    kind: Literal["translation"] = "translation"
    joint: Name
    speed: Annotated[float | Curve, NumberOrTable(QuantityField(units.SPEED), Table((units.TIME, units.SPEED)))] = 0.0
    harmonics: tuple[Harmonic, ...] = ()


class PositionDrive(Part):
    """Prescribed motion of a link's centre of gravity along a ``direction`` fixed in space: ``speed`` and harmonics."""

    kind: Literal["position"] = "position"
    link: Name
    direction: Direction
    speed: Annotated[float | Curve, NumberOrTable(QuantityField(units.SPEED), Table((units.TIME, units.SPEED)))] = 0.0
    harmonics: tuple[Harmonic, ...] = ()


Factor = Annotated[float, QuantityField(units.RATIO, above=0)]


class TorqueDrive(Part):
    """Known torque [N m] on links[0] of a turning joint: constant, or a curve over its speed [rad/s].

    ``effort_factor`` is on the torque, ``speed_factor`` on the speeds of the curve.
    """

    kind: Literal["torque"] = "torque"
    joint: Name
    torque: Torque | None = None
    curve: Annotated[Curve, Table((units.ANGULAR_SPEED, units.TORQUE))] | None = None
    effort_factor: Factor = 1.0
    speed_factor: Factor = 1.0


class ForceDrive(Part):
    """Known force [N] on links[0] along a sliding joint: constant, or a curve over its speed [m/s].

    Factors as of :class:`TorqueDrive`.
    """

    kind: Literal["force"] = "force"
    joint: Name
    force: Annotated[float, QuantityField(units.FORCE)] | None = None
    curve: Annotated[Curve, Table((units.SPEED, units.FORCE))] | None = None
    effort_factor: Factor = 1.0
    speed_factor: Factor = 1.0


#: Drives that prescribe a travel, of a slide or of a link; and all those that prescribe a motion.
TravelDrive: TypeAlias = TranslationDrive | PositionDrive
MotionDrive: TypeAlias = RotationDrive | TravelDrive
Drive: TypeAlias = Annotated[MotionDrive | TorqueDrive | ForceDrive, Field(discriminator="kind")]
