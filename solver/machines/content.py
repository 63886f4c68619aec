"""What a machine file holds, before anything that is left out has been filled in and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, SerializerFunctionWrapHandler, StrictBool, model_serializer

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import Name, QuantityField, Title, no_default
from jointplay.solver.machines.joints import Defaults, Joint, SlidingJoint, TurningJoint
from jointplay.solver.machines.modes import FrameMode
from jointplay.solver.machines.parts import Drive, Initial, Link, Load, Mount, Part, PositionDrive, Sensor, Support
from jointplay.solver.machines.response import FrequencyResponse

_LATER = ("modes", "decoupled", "response")


class MachineContent(Part):
    """The members of a machine; what they have to do with each other is for :mod:`jointplay.solver.machines.rules`."""

    name: Title
    gravity: Annotated[float, QuantityField(units.ACCELERATION)] = 9.81
    frame: Name = Field(default="", json_schema_extra=no_default)
    links: Mapping[Name, Link]
    defaults: Defaults = Defaults()
    joints: Mapping[Name, Joint] = Field(default_factory=dict)
    drive: Drive | None = None
    initial: Initial = Initial()
    supports: tuple[Support, ...] = ()
    loads: tuple[Load, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    modes: tuple[FrameMode, ...] = ()
    decoupled: StrictBool = False
    response: FrequencyResponse | None = None

    @model_serializer(mode="wrap")
    def _leave_out_what_is_not_said(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Files could not say it once; machines that say nothing of it keep the content key they had then.
        return {key: value for key, value in write(self).items() if key not in _LATER or value}

    @property
    def turning_joints(self) -> tuple[str, ...]:
        """Names of the turning joints, in the order of the file."""
        return tuple(name for name, joint in self.joints.items() if isinstance(joint, TurningJoint))

    @property
    def sliding_joints(self) -> tuple[str, ...]:
        """Names of the sliding joints, in the order of the file."""
        return tuple(name for name, joint in self.joints.items() if isinstance(joint, SlidingJoint))

    @property
    def wearing_joints(self) -> tuple[str, ...]:
        """Joints that can have clearance, in the order of the file: turning ones, and guides with a length."""
        found = self.joints.items()
        return tuple(name for name, joint in found if isinstance(joint, TurningJoint) or joint.length is not None)

    @property
    def driven_joint(self) -> str:
        """Name of the joint that the drive acts on; empty without one."""
        return "" if self.drive is None or isinstance(self.drive, PositionDrive) else self.drive.joint

    @property
    def driven_link(self) -> str:
        """Name of the link whose position in space the drive prescribes; empty without one."""
        return self.drive.link if isinstance(self.drive, PositionDrive) else ""

    @property
    def has_response(self) -> bool:
        """Whether sensors are known to answer to forces on the frame otherwise than a rigid body on its supports.

        By a frequency response, or by modes: of a frame that is free to move, or all of it is prescribed.
        """
        bends = bool(self.modes) and self.driven_link != self.frame
        return bool(self.sensors) and (self.response is not None or bends)

    @property
    def clearances(self) -> dict[str, float]:
        """Half the play (m) of the joints to which the file gives one: the fault where no other is asked for."""
        found = {name: joint.clearance for name, joint in self.joints.items()}
        return {name: clearance for name, clearance in found.items() if clearance is not None}

    @property
    def frame_points(self) -> Iterator[tuple[str, tuple[float, float]]]:
        """Points of the frame that carry something: what that is, by its path, and where it was drawn."""
        frame = self.frame
        for name, joint in self.joints.items():
            if frame in joint.links:
                yield f"joints.{name}", joint.at
        for i, support in enumerate(self.supports):
            if support.link == frame:
                yield f"supports.{i}", support.at
            elif support.to_link == frame:
                yield f"supports.{i}", support.at if isinstance(support, Mount) else support.anchor
        for i, load in enumerate(self.loads):
            if load.link == frame:
                yield f"loads.{i}", load.at
        if self.driven_link == frame:
            yield "drive", self.links[frame].cg
        for i, sensor in enumerate(self.sensors):
            yield f"sensors.{i}", sensor.at
