"""A fault state: which joints have clearance, and how much."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import ClearanceField, RuleError, nearest
from jointplay.solver.machines.machine import Machine


class Fault(Mapping[str, float]):
    """Clearance (m) of each worn joint; joints not named are ideal. Immutable, ordered by name.

    Parameters
    ----------
    clearances : mapping of str to float
        Half the play of each joint, m: that of a pin's diameter, or between the walls of a guide; a joint with
        clearance 0 is ideal and left out.

    Raises
    ------
    MachineError
        A negative or non-finite clearance.
    """

    __slots__ = ("_clearances",)

    def __init__(self, clearances: Mapping[str, float] | None = None) -> None:
        kept: dict[str, float] = {}
        for joint, value in sorted((clearances or {}).items()):
            if not 0.0 <= value < float("inf"):
                raise MachineError("fault", joint, value, "a radial clearance is a finite number of metres, 0 or more")
            if value:
                kept[joint] = float(value)
        self._clearances = kept

    def __getitem__(self, joint: str) -> float:
        return self._clearances[joint]

    def __iter__(self) -> Iterator[str]:
        return iter(self._clearances)

    def __len__(self) -> int:
        return len(self._clearances)

    def __hash__(self) -> int:
        return hash(tuple(self._clearances.items()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fault) and self._clearances == other._clearances

    def __repr__(self) -> str:
        return f"Fault({self._clearances!r})"

    @property
    def joints(self) -> tuple[str, ...]:
        """Worn joints, sorted by name."""
        return tuple(self._clearances)

    @property
    def label(self) -> str:
        """``A=0.2mm,F=0.05mm``, as :func:`parse_fault` reads it; ``healthy`` for none."""
        return ",".join(f"{joint}={value * 1e3:.9g}mm" for joint, value in self._clearances.items()) or "healthy"


HEALTHY = Fault()

_CLEARANCE = ClearanceField(at_least=0)


def check_fault(fault: Fault, machine: Machine) -> None:
    """Refuse a fault that names what cannot wear.

    Raises
    ------
    MachineError
        A joint that the machine does not have, or a sliding joint without a length.
    """
    for joint, clearance in fault.items():
        if joint in machine.wearing_joints:
            continue
        if joint in machine.joints:
            rule = f"is missing: clearance of sliding joint {joint} tilts its block by its length"
            raise MachineError(machine.name, f"joints.{joint}.length", None, rule)
        rule = f"no such joint{nearest(joint, machine.wearing_joints)}"
        raise MachineError(machine.name, f"fault.{joint}", f"{clearance * 1e3:g} mm", rule)


def parse_fault(text: str | None, machine: Machine) -> Fault:
    """Read ``A=0.2mm,F=50um``.

    Parameters
    ----------
    text : str or None
        Joints and radial clearances, in place of all that the machine's file gives; empty or ``healthy`` for none at
        all, ``None`` for what the file gives. A bare number is metres.
    machine : Machine

    Raises
    ------
    MachineError
        What is wrong with it, in one line.
    """
    if text is None:
        return Fault(machine.clearances)
    clearances: dict[str, float] = {}
    stripped = text.strip()
    for part in stripped.split(",") if stripped not in ("", "healthy") else ():
        joint, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not joint or not value:
            raise MachineError(machine.name, "fault", part.strip() or text, "write JOINT=CLEARANCE, as in A=0.2mm")
        if joint in clearances:
            raise MachineError(machine.name, f"fault.{joint}", value, "this joint is named twice")
        try:
            clearances[joint] = _CLEARANCE.validate(value)
        except RuleError as error:
            raise MachineError(machine.name, f"fault.{joint}", value, error.message()) from error
    fault = Fault(clearances)
    for joint in clearances:
        check_fault(Fault({joint: clearances[joint] or 1.0}), machine)
    return fault
