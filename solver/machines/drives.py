"""Drives as they stand in a machine file: a prescribed motion, or a known effort."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import Name, NumberOrTable, Quantity, Table
from jointplay.solver.machines.parts import Angle, Length, Part, Torque

Curve: TypeAlias = tuple[tuple[float, float], ...]


class Ripple(Part):
    """One term of a drive's angular ripple: ``amplitude`` [rad] at ``order`` times the speed, ``phase`` [rad]."""

    order: Annotated[float, Quantity(units.RATIO, above=0)]
    amplitude: Angle
    phase: Angle = 0.0


class Harmonic(Part):
    """One term of a sliding drive: ``amplitude`` [m] at ``frequency`` [Hz], ``phase`` [rad]."""

    frequency: Annotated[float, Quantity(units.FREQUENCY, above=0)]
    amplitude: Length
    phase: Angle = 0.0


class RotationDrive(Part):
    """Prescribed rotation of a turning joint: ``speed`` [rad/s] of links[0] relative to links[1], or a run-up table."""

    kind: Literal["rotation"] = "rotation"
    joint: Name
    speed: Annotated[
        float | Curve, NumberOrTable(Quantity(units.ANGULAR_SPEED), Table((units.TIME, units.ANGULAR_SPEED)))
    ]
    ripple: tuple[Ripple, ...] = ()


class TranslationDrive(Part):
    """Prescribed sliding of a sliding joint: ``speed`` [m/s] of links[0] along ``direction``, and harmonics."""

    kind: Literal["translation"] = "translation"
    joint: Name
    speed: Annotated[float | Curve, NumberOrTable(Quantity(units.SPEED), Table((units.TIME, units.SPEED)))] = 0.0
    harmonics: tuple[Harmonic, ...] = ()


class TorqueDrive(Part):
    """Known torque [N m] on links[0] of a turning joint: constant, or a curve over its speed [rad/s]."""

    kind: Literal["torque"] = "torque"
    joint: Name
    torque: Torque | None = None
    curve: Annotated[Curve, Table((units.ANGULAR_SPEED, units.TORQUE))] | None = None


class ForceDrive(Part):
    """Known force [N] on links[0] along a sliding joint: constant, or a curve over its speed [m/s]."""

    kind: Literal["force"] = "force"
    joint: Name
    force: Annotated[float, Quantity(units.FORCE)] | None = None
    curve: Annotated[Curve, Table((units.SPEED, units.FORCE))] | None = None


Drive: TypeAlias = Annotated[RotationDrive | TranslationDrive | TorqueDrive | ForceDrive, Field(discriminator="kind")]
