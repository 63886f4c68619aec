"""Which links a moving frame can feel; the machine, and cases of it, without the others.

A link that is fixed passes nothing on. Subchains that are connected to the rest only through fixed links and the ground
move as if the rest were not there, and the frame as if they were not: what is left of the equations is the same, digit
by digit. The subchain of the drive stays, because revolutions are counted by it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from jointplay.solver.cases.case import Case
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault, check_fault
from jointplay.solver.machines.machine import Machine, keep_by_machine


@dataclass(frozen=True)
class Reach:
    """A machine as its frame feels it.

    Attributes
    ----------
    whole, machine : Machine
        As the file has it, and without what does not reach the frame; the same object where everything does.
    links, joints : tuple of str
        What is left out.
    supports, loads : tuple of int
        Places of those that are left, in the order of `machine`.
    """

    whole: Machine
    machine: Machine
    links: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    supports: tuple[int, ...] = ()
    loads: tuple[int, ...] = ()

    def case(self, case: Case) -> Case:
        """The case with what is left of its fault and its numbers, by the paths of `machine`.

        Raises
        ------
        MachineError
            A joint or a number that the whole machine does not have either.
        """
        if not self.links:
            return case
        check_fault(case.fault, self.whole)
        numbers = {}
        for path, value in case.parameters.items():
            kind, _, rest = path.partition(".")
            name, _, number = rest.partition(".")
            kept: tuple[int, ...] | None = {"supports": self.supports, "loads": self.loads}.get(kind)
            if kept is not None and name.isdigit() and int(name) < len(getattr(self.whole, kind)):
                if int(name) in kept:
                    numbers[f"{kind}.{kept.index(int(name))}.{number}"] = value
                else:
                    self._check(path, value)
            elif name in {"links": self.links, "joints": self.joints}.get(kind, ()):
                self._check(path, value)
            else:
                numbers[path] = value
        worn = {joint: clearance for joint, clearance in case.fault.items() if joint not in self.joints}
        return replace(case, fault=Fault(worn), parameters=numbers)

    def _check(self, path: str, value: float) -> None:
        """Refuse a path at which the whole machine has no number."""
        found: object = self.whole.model_dump()
        for part in path.split("."):
            key: str | int = int(part) if part.isdigit() else part
            try:
                found = found[key]  # type: ignore[index]
            except (KeyError, IndexError, TypeError):
                raise MachineError(self.whole.name, path, value, "this machine has no such number") from None

    def remark(self, case: Case) -> str:
        """What a reader of the results of a case should know; mostly empty."""
        worn = [joint for joint in case.fault.joints if joint in self.joints]
        if not worn:
            return ""
        return f"clearance of {', '.join(worn)} is without effect: nothing of it reaches {self.whole.frame}"


@keep_by_machine(64)
def reach_of(machine: Machine, whole: bool = False) -> Reach:
    """What a machine's frame feels; everything where the `whole` machine is wanted.

    Also where the frame is fixed: then the links are what is looked at.
    """
    frame = machine.links[machine.frame]
    if whole or frame.fixed or len(frame.locked) == 3:
        return Reach(machine, machine)
    standing = {name for name, link in machine.links.items() if link.fixed}
    pairs = [joint.links for joint in machine.joints.values()]
    pairs += [(support.link, support.to_link) for support in machine.supports if support.to_link is not None]
    wanted = {machine.frame}
    if machine.driven_joint:
        wanted |= set(machine.joints[machine.driven_joint].links) - standing
    if machine.driven_link:
        wanted.add(machine.driven_link)
    ahead = list(wanted)
    while ahead:
        here = ahead.pop()
        for pair in pairs:
            if here in pair:
                new = set(pair) - standing - wanted
                wanted |= new
                ahead += new
    # A fixed link stays where something that stays is joined to it.
    kept = wanted | {link for pair in pairs if wanted & set(pair) for link in pair}
    if len(kept | standing) == len(machine.links):
        return Reach(machine, machine)
    joints = {name: joint for name, joint in machine.joints.items() if wanted & set(joint.links)}
    supports = [
        i for i, support in enumerate(machine.supports)
        if support.link in wanted or (support.to_link is not None and support.to_link in wanted)
    ]  # fmt: skip
    loads = [i for i, load in enumerate(machine.loads) if load.link in wanted]
    velocities = {name: given for name, given in machine.initial.velocities.items() if name in kept}
    left = {
        "links": {name: link for name, link in machine.links.items() if name in kept},
        "joints": joints,
        "supports": tuple(machine.supports[i] for i in supports),
        "loads": tuple(machine.loads[i] for i in loads),
        "initial": machine.initial.model_copy(update={"velocities": velocities}),
    }
    return Reach(
        machine, machine.model_copy(update=left), tuple(name for name in machine.links if name not in kept),
        tuple(name for name in machine.joints if name not in joints), tuple(supports), tuple(loads),
    )  # fmt: skip
