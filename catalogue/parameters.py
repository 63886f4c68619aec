"""Numbers of a machine by path: what stands in the file, and what a draw puts in its place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from catalogue.draws import Distribution
from catalogue.errors import PlanError
from solver.cases.parameters import SHORTHANDS
from solver.machines.drives import RotationDrive
from solver.machines.fields import nearest
from solver.machines.machine import Machine

__all__ = ["MachineNumbers", "nominal_drive_speed"]

SHARED = SHORTHANDS
"""Short paths that stand for the same number of every turning joint."""

DRIVE_SPEED = "drive.speed"


def nominal_drive_speed(machine: Machine) -> float:
    """Drive speed of the machine file [rad/s].

    Raises
    ------
    PlanError
        The drive does not turn, or not at one speed, so spectra cannot be compared by order.
    """
    drive = machine.drive
    speed = drive.speed if isinstance(drive, RotationDrive) else None
    if isinstance(speed, float) and speed != 0.0:
        return speed
    shown = "none" if drive is None else f"kind {drive.kind}"
    rule = "a catalogue needs a drive of kind rotation with one speed that is not 0"
    raise PlanError(machine.name, "drive", shown, rule)


class MachineNumbers:
    """Every number of a machine by its dotted path (``supports.0.stiffness.1``).

    Parameters
    ----------
    machine : Machine
        The machine.
    """

    def __init__(self, machine: Machine) -> None:
        self._name = machine.name
        self._turning = machine.turning_joints
        self.by_path: dict[str, float] = dict(_numbers(machine.model_dump(), ""))

    def targets(self, path: str) -> tuple[str, ...]:
        """Paths in the machine file that `path` of a plan stands for: itself, or this number of all turning joints.

        A joint whose contact law has no such number is left out.

        Raises
        ------
        PlanError
            The machine has no such number.
        """
        shared = [f"joints.{joint}.{path}" for joint in self._turning] if path in SHARED else []
        if any(target in self.by_path for target in shared):
            return tuple(target for target in shared if target in self.by_path)
        if path not in self.by_path:
            rule = f"is not a number of machine {self._name}{nearest(path, [*SHARED, *self.by_path])}"
            raise PlanError("plan", f"uncertain.{path}", None, rule)
        return (path,)

    def drawn(
        self, uncertain: Mapping[str, Distribution], quantiles: Mapping[str, float], speed: float
    ) -> dict[str, float]:
        """What one draw changes in the machine.

        Parameters
        ----------
        uncertain : mapping of str to Distribution
            What is drawn, by path.
        quantiles : mapping of str to float
            The drawn number or factor of each.
        speed : float
            Factor on the drive speed, besides the drawn one.

        Returns
        -------
        dict of str to float
            Numbers by path, SI. A factor on a short path becomes one number for all joints if they have the same in the
            file, else one for each.

        Raises
        ------
        PlanError
            A path that is no number of the machine.
        """
        parameters: dict[str, float] = {}
        for path, value in quantiles.items():
            targets = self.targets(path)
            if not uncertain[path].is_factor:
                parameters[path] = value
            elif len({self.by_path[target] for target in targets}) == 1:
                parameters[path] = self.by_path[targets[0]] * value
            else:
                parameters.update({target: self.by_path[target] * value for target in targets})
        if speed != 1.0:
            parameters[DRIVE_SPEED] = parameters.get(DRIVE_SPEED, self.by_path[DRIVE_SPEED]) * speed
        return parameters


def _numbers(value: object, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, float(value)
        return
    items: Iterable[tuple[object, object]] = ()
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, (list, tuple)):
        items = enumerate(value)
    for name, item in items:
        yield from _numbers(item, f"{path}.{name}" if path else str(name))
