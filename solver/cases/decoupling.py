"""Whether the machine runs on a frame at rest, which then moves by what that does to it; and what this changes.

An estimate of it: where the frame's acceleration is A w by the wrench w, its motion a moves the links' mass dM with it,
which answers with dM a and so changes a by A dM a. The norm of A dM at an order of the drive, weighted with the mass
matrix, is the mass ratio times what the suspension amplifies. Amplitudes of orders change by up to
:data:`SENSITIVITY` times that, in parts of the strongest, ``docs/measured/solver.md``. That holds after the transient:
while a frame falls from its drawn pose onto its springs, however heavy it is, it takes the weight from its machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.preparation import standing_model
from jointplay.solver.cases.steps import suspension_modes, suspension_of
from jointplay.solver.equations.drive import drive_rates
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.spectra.harmonics import HARMONICS

#: Measured on the machines that ship, healthy and worn, their frames up to 10 000 times as heavy: 12 at most.
SENSITIVITY = 20.0
#: Changes by less than this part of the strongest order are none: orders 80 dB below it keep theirs to 0.1 dB.
NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class Decoupling:
    """What is left out of a machine whose frame does not act back.

    Attributes
    ----------
    ratio : float
        Largest inertia of the links in a motion of the frame, in parts of that of the whole machine, as drawn.
    amplified : float
        The same times what the suspension makes of it, at the order of the drive where that is most.
    """

    ratio: float
    amplified: float

    @property
    def change(self) -> float:
        """What amplitudes of the frame's orders change by at most, in parts of the strongest of the same motion."""
        return SENSITIVITY * self.amplified

    def say(self) -> str:
        """What a reader should know."""
        amplified = f", {self.amplified:.2g} where the suspension amplifies it" if self.amplified > self.ratio else ""
        differ = f"by {self.change:.2g} of the strongest at most" if self.change < 1 else "by as much as themselves"
        ratio = f"links are {self.ratio:.2g} of the machine's inertia{amplified}"
        return f"{ratio}: orders differ from the whole machine's {differ}"


@keep_by_machine(256)
def decoupling_of(machine: Machine, speed: float | None = None) -> Decoupling:
    """What decoupling its frame leaves out of a machine with the numbers of its file.

    Parameters
    ----------
    machine : Machine
    speed : float, optional
        Of its drive, rad/s, in place of the file's.

    Raises
    ------
    MachineError
        As :func:`jointplay.solver.equations.decoupled.hold_frame`; supports do not hold it in all its motions, so that
        it falls together with its machine, unless its frequency response says how it answers.
    """
    model = standing_model(machine.model_copy(update={"decoupled": True}), (), ())
    found = suspension_of(model, model.vector({}))
    if machine.response is None and np.linalg.matrix_rank(found.gradients[0]) < len(found.motions):
        rule = f"cannot be: {machine.frame} is not held by springs in all its motions"
        raise MachineError(machine.name, "decoupled", None, rule)
    frame = machine.links[machine.frame]
    alone = {"x": frame.mass or 0.0, "y": frame.mass or 0.0, "theta": frame.inertia or 0.0}
    weight = np.linalg.inv(np.linalg.cholesky(found.mass))
    links = weight @ (found.mass - np.diag([alone[motion] for motion in found.motions])) @ weight.T
    stiffness, damping = (-weight @ part @ weight.T for part in found.gradients)
    turning = abs(drive_rates(machine, {} if speed is None else {"drive.speed": speed})[0])
    # Without a speed of its own it may dwell where the suspension swings.
    found_at = turning * np.arange(1, HARMONICS + 1) if turning else np.abs(suspension_modes(found))
    s = (1j + 1e-9) * found_at[:, None, None]  # an order may be in a resonance without damping
    answers = np.linalg.solve(
        np.eye(len(links)) + damping / s + stiffness / s**2, np.broadcast_to(links, (len(s), *links.shape))
    )
    norms = np.linalg.norm(answers, 2, axis=(1, 2))
    ratio = float(np.linalg.norm(links, 2))
    return Decoupling(ratio, max(ratio, float(norms.max(initial=0.0))))


def can_be_decoupled(machine: Machine) -> bool:
    """Whether its frame moves as a rigid body on its supports, and nothing else holds it."""
    try:
        decoupling_of(machine)
    except MachineError:
        return False
    return True


def _is_negligible(machine: Machine, cases: Sequence[Case]) -> bool:
    """Whether decoupling the frame changes nothing that any accuracy would resolve."""
    if any(path.startswith(("links.", "supports.")) for case in cases for path in case.parameters):
        return False
    moved = sum(link.mass or 0.0 for name, link in machine.links.items() if name != machine.frame)
    if SENSITIVITY * moved > NEGLIGIBLE * (machine.links[machine.frame].mass or 0.0):
        return False  # most machines, without another model
    speeds = {case.parameters.get("drive.speed") for case in cases}
    return can_be_decoupled(machine) and all(decoupling_of(machine, speed).change < NEGLIGIBLE for speed in speeds)


def decouple(machine: Machine, settings: Settings, cases: Sequence[Case] | None = None) -> tuple[Machine, str]:
    """The machine as it is run, without what its frame does not feel, and a remark where its frame is decoupled.

    It is where the file or the settings say so, and where it makes no difference: there are cases and none of them
    changes a link or a support; nobody looks at the links, which feel the frame's own motion; and the run is not one of
    given length from the drawn pose, with a fall onto the springs in it that the machine would feel.

    Raises
    ------
    MachineError
        As :func:`decoupling_of`.
    SettingsError
        Both the whole machine and a decoupled frame, or one with a frequency response.
    """
    if machine.response is not None and settings.whole:
        raise SettingsError(f"whole: {machine.name}: a frame with a frequency response does not act back")
    if settings.whole and settings.decoupled:
        raise SettingsError("whole: a decoupled frame does not act back; take either")
    if settings.whole:
        return machine.model_copy(update={"decoupled": False}) if machine.decoupled else machine, ""
    at_rest = settings.duration is None or machine.initial.pose == "equilibrium"
    by_itself = cases is not None and at_rest and not settings.links and _is_negligible(machine, cases)
    if not (machine.decoupled or settings.decoupled or by_itself):
        return machine, ""
    speed = cases[0].parameters.get("drive.speed") if cases else None
    alone = machine if machine.decoupled else machine.model_copy(update={"decoupled": True})
    return alone, f"frame decoupled: {decoupling_of(alone, speed).say()}"
