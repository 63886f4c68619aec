"""From a case to numbers: lane parameters, start, transient, step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.answers import check_band, spacing_of
from jointplay.solver.cases.case import Settings
from jointplay.solver.cases.causes import (
    check_pins,
    check_record,
    check_sample_rate,
    contact_causes,
    drive_cause,
    refuse_too_many_steps,
    stiff_part,
    support_causes,
)
from jointplay.solver.cases.positions import change_point_remarks, check_travel, mobility_of, rubbing_rate
from jointplay.solver.cases.rates import contact_rates, pace_of, without_dry_friction
from jointplay.solver.cases.start import find_repeat, start_pose, start_velocity
from jointplay.solver.cases.steps import (
    BETWEEN_IMPACTS,
    LEAST_RESPONSE,
    STEP_RULES,
    USUAL_FILM,
    Accuracy,
    largest_step,
    response,
    smooth_eigenvalues,
    suspension_modes,
    suspension_of,
    transient_time,
)
from jointplay.solver.equations.anchors import fastest_anchor, row_times
from jointplay.solver.equations.drive import drive_rates
from jointplay.solver.equations.model import MODELS_KEPT, Model, build_model
from jointplay.solver.equations.numbers import contact_path
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, has_known_effort, keep_by_machine
from jointplay.solver.machines.parts import RotationDrive, TravelDrive
from jointplay.solver.machines.remarks import film_remarks, restitution_remarks

#: More samples than any case has.
NEVER = 2**62
#: Mobility of a contact, 1/kg, that is rounding: a block in two guides, of which one is tight, say.
_RIGID = 1e-9


@dataclass(frozen=True, eq=False)
class Prepared:
    """A case with its lane parameters, start and step.

    Attributes
    ----------
    index : int
        Place in the table of cases.
    vector : list of float
        Lane parameters in kernel order.
    z, v : (n,) arrays
        Start.
    memory : (m,) array
        What contacts remember at the start, see :mod:`jointplay.solver.equations.contact`.
    begin : float
        Time of the start, s.
    sample_rate : float
        Of the results, Hz.
    speed : float
        What revolutions are counted by, rad/s; 0 where nothing repeats.
    transient : float
        s.
    remark : str
        What a reader of the results should know: where the transient rule does not hold, say.
    duration : float
        s.
    sprung : bool
        Whether supports hold the frame in all its motions, each a damped swing.
    response : float
        How far the frame moves against what it would at a fast drive, see
        :func:`jointplay.solver.cases.steps.response`.
    pace : float
        Time in which the machine moves by its own size, see :func:`jointplay.solver.cases.rates.pace_of`.
    accuracy : str
        How finely it is resolved.
    longest_step : float
        What the rules of :mod:`jointplay.solver.cases.steps` allow at that accuracy, s.
    smooth_step : float
        Longest step that resolves suspension and drive, contacts apart, s.
    suspension : tuple of complex
        Modes of the whole machine, rigid as drawn, on its supports, 1/s.
    spent : float
        Processor time that went into its start, s.
    before : float
        Time that it ran before `begin` to reach its limit cycle, s.
    unsteady : str or None
        Of a machine with a known effort: why it is in no limit cycle, empty where it is; None where that is not known.
    look : int
        Recorded samples after which it is first looked whether the motion repeats.
    ends : callable or None
        Of a machine that finds its own speed: from recorded coordinates (r, n) to the ends of its revolutions, in
        samples, and the drive's angle at the last of them, rad. None where revolutions are known by their time.
    implicit : str or None
        ``None`` where error-controlled steps are explicit; else why they are not, empty where that was asked for.
    oiled : bool
        Whether any open joint has a film of oil; one with the viscosity 0 has none.
    """

    index: int
    vector: list[float]
    z: FloatArray
    v: FloatArray
    memory: FloatArray
    begin: float
    sample_rate: float
    speed: float
    transient: float
    remark: str
    duration: float
    sprung: bool
    response: float
    pace: float
    accuracy: Accuracy
    longest_step: float
    smooth_step: float
    suspension: tuple[complex, ...]
    spent: float = 0.0
    before: float = 0.0
    unsteady: str | None = None
    look: int = NEVER
    ends: Callable[[FloatArray], tuple[FloatArray, float]] | None = None
    implicit: str | None = None
    oiled: bool = False


@keep_by_machine(MODELS_KEPT)
def model_of(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Model:
    """The model of a machine with clearance in `joints`, the numbers `varying` as lane parameters; kept."""
    return build_model(machine, joints, varying)


@keep_by_machine(MODELS_KEPT)
def standing_model(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Model:
    """The model with its drive and its anchors standing, same coordinates."""
    drive = machine.drive
    if isinstance(drive, RotationDrive):
        drive = drive.model_copy(update={"speed": 0.0, "ripple": ()})
    elif isinstance(drive, TravelDrive):
        drive = drive.model_copy(update={"speed": 0.0, "harmonics": ()})
    kept = tuple(path for path in varying if not path.startswith("drive.") and ".motion." not in path)
    supports = tuple(each.model_copy(update={"motion": ()}) for each in machine.supports)
    return build_model(machine.model_copy(update={"drive": drive, "supports": supports}), joints, kept)


@dataclass(frozen=True, eq=False)
class _Smooth:
    """Motions between impacts: eigenvalues of all, 1/s, and the modes of the suspension under the rigid machine."""

    eigenvalues: FloatArray
    suspension: tuple[complex, ...]


def modes_of_suspension(machine: Machine) -> tuple[complex, ...]:
    """Modes of a machine on its supports, without clearances and its drive standing, 1/s: one of each pair."""
    return _smooth(machine, ()).suspension


@keep_by_machine(1024)
def _smooth(machine: Machine, values: tuple[tuple[str, float], ...]) -> _Smooth:
    """Of the machine without clearances, its drive standing, with the given numbers by path."""
    model = standing_model(without_dry_friction(machine), (), tuple(path for path, _ in values))
    p = model.vector(dict(values))
    suspension = suspension_modes(suspension_of(model, p))
    if find_repeat(model, p):
        # At a change point while nothing is worn (a healthy case was refused before): rigid on its supports, it moves.
        return _Smooth(np.array(suspension), tuple(suspension))
    return _Smooth(smooth_eigenvalues(model, p), tuple(suspension))


def prepare(
    machine: Machine, model: Model, index: int, values: dict[str, float], varying: tuple[str, ...], settings: Settings
) -> Prepared:
    """Work out everything a run needs.

    Parameters
    ----------
    machine : Machine
    model : Model
    index : int
        Place in the table of cases.
    values : dict of str to float
        Parameters by full path.
    varying : tuple of str
        Those that are neither contact numbers nor the drive speed.
    settings : Settings

    Raises
    ------
    MachineError
        A parameter that the machine does not have; one that asks for steps without number, a pin out of all proportion.
    AssemblyError
        No start pose, contradicting velocities, or positions of the drive at which the machine does not close.
    SettingsError
        A run of absurd length, samples too far apart.
    """
    complete = {path: values.get(path, model.nominal[path]) for path in model.parameters}
    unknown = set(values) - set(complete)
    if unknown:
        raise MachineError(machine.name, min(unknown), values[min(unknown)], "this machine has no such number")
    vector = model.vector(complete)
    joints = model.clearance_joints
    check_pins(machine, joints, complete)
    mobility = mobility_of(machine, joints, complete)
    others, smooth_ones = _kinds(machine, joints, model.parameters, varying)
    z, v = _start(machine, joints, varying, tuple((path, complete[path]) for path in others))
    motions = _smooth(machine, tuple((path, complete[path]) for path in smooth_ones))
    speed, fastest = drive_rates(machine, complete)
    transient, *remarks = transient_time(motions.suspension, speed)
    if machine.response is not None:
        check_band(machine, settings.sample_rate, speed)
        if not speed and not settings.transient and not has_known_effort(machine):
            raise SettingsError(f"transient: {machine.name}: what never repeats is answered to from its beginning on")
        transient = transient if speed else max(transient, 1 / spacing_of(machine.response))
    free = len(model.frame_coordinates)
    sprung = len(motions.suspension) == free > 0 and not any(remarks)
    remarks += restitution_remarks(machine, joints, complete) + film_remarks(machine, joints)
    closed = ", ".join(joint for joint in machine.clearances if joint not in joints)
    remarks += [f"without the clearance that the file gives {closed}"] if closed else []
    tight = ", ".join(joint for joint, each in mobility.items() if each < _RIGID)
    remarks += [f"clearance of {tight} is without effect: other joints leave it no play"] if tight else []
    duration = settings.duration
    if duration is None:
        duration = transient + settings.revolutions * (2 * math.pi / abs(speed) if speed else 1.0)
    travel = check_travel(machine, joints, complete, duration)
    remarks += dict.fromkeys(change_point_remarks(machine, joints, complete) + travel)
    rule = STEP_RULES[settings.accuracy]
    rubbing = rubbing_rate(machine, joints, varying, complete, mobility) if settings.fixed_step else 0.0
    contacts = contact_rates(machine, mobility, complete, fastest)
    implicit = "" if settings.method == "rosenbrock" else None
    if settings.integrator == "adaptive" and settings.method is None:
        part = stiff_part(machine, contacts, mobility, motions.eigenvalues, complete, settings.sample_rate)
        implicit = None if part is None else f"implicit steps (rosenbrock), because of {part}"
    if implicit is not None:
        remarks[0] = transient_time(motions.suspension, speed, 0.5 * settings.sample_rate)[1]
    remarks += [implicit or ""]
    rows = 0 if settings.integrator in ("adaptive", "rosenbrock") else sum(0 < t < duration for t in row_times(machine))
    if rows:
        remarks += [f"{settings.integrator} ends no step at rows of tables, {rows} in this run: adaptive does"]
    if model.lubricated and not settings.fixed_step:
        contacts = contact_rates(machine, mobility, complete, fastest, USUAL_FILM)
    # Implicit steps are as long as what is slow lets them be.
    resolved, eigenvalues = (contacts, motions.eigenvalues) if implicit is None else ({}, np.zeros(0))
    shaken, shaking = fastest_anchor(machine, speed)
    moved = max(abs(fastest), shaken)
    longest = settings.step or largest_step(rule, resolved.values(), eigenvalues, moved, rubbing)
    smooth = largest_step(BETWEEN_IMPACTS, (), eigenvalues, moved)
    check_record(settings.sample_rate, duration, model.size if settings.links else 3)
    check_sample_rate(settings.sample_rate, duration, speed)
    causes = chain(
        contact_causes(machine, rule, contacts, mobility, complete),
        support_causes(machine, rule, motions.eigenvalues, complete),
        [drive_cause(rule, fastest), drive_cause(rule, shaken, shaking)],
    )  # fmt: skip
    refuse_too_many_steps(machine.name, duration, min(longest, 1 / settings.sample_rate), causes)
    remark = "; ".join(filter(None, remarks))
    memory = np.zeros(model.memory.shape[0])
    small, pace = response(motions.suspension, speed), pace_of(machine, complete)
    slow = abs(speed) < LEAST_RESPONSE * np.abs(motions.eigenvalues).max(initial=0.0)
    # Of a machine with a known effort the speed is not known yet, which says nothing of how slow it is.
    if implicit is not None and slow and not has_known_effort(machine):
        small = LEAST_RESPONSE  # dampers hold the frame, too
    return Prepared(
        index, vector, z, v, memory, 0.0, settings.sample_rate, speed, transient, remark, duration, sprung, small, pace,
        settings.accuracy, longest, smooth, motions.suspension, implicit=implicit,
        oiled=any(each.film > 0.0 for each in contacts.values()),
    )  # fmt: skip


def find_stiff_part(machine: Machine, fault: Fault, sample_rate: float) -> str:
    """What makes the steps of a fault implicit, empty where they are not; parameters as of a case and its settings."""
    joints = fault.joints
    values = model_of(machine, joints, ()).nominal | {contact_path(name, "clearance"): c for name, c in fault.items()}
    mobility = mobility_of(machine, joints, {})
    contacts = contact_rates(machine, mobility, values, drive_rates(machine, values)[1])
    part = stiff_part(machine, contacts, mobility, _smooth(machine, ()).eigenvalues, values, sample_rate)
    return "" if part is None else str(part)


@keep_by_machine(1024)
def _start(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], values: tuple[tuple[str, float], ...]
) -> tuple[FloatArray, FloatArray]:
    """Coordinates and velocities of the start: pins are concentric in it, so that no contact number matters."""
    model = model_of(machine, joints, varying)
    standing = model if machine.initial.pose == "drawn" else standing_model(machine, joints, varying)
    at_rest = {path: value for path, value in values if path != "drive.speed"}
    z = start_pose(standing, standing.vector(at_rest))
    v = start_velocity(model, model.vector(dict(values)), z)
    z.flags.writeable = v.flags.writeable = False  # many cases share them
    return z, v


@keep_by_machine(MODELS_KEPT)
def _kinds(
    machine: Machine, joints: tuple[str, ...], paths: tuple[str, ...], varying: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Which of the paths are of no contact, and which varying ones have to do with the motions between impacts."""
    others = tuple(path for path in paths if not _is_contact(path, joints))
    return others, tuple(path for path in varying if _is_smooth(machine, path, joints))


def _is_contact(path: str, joints: tuple[str, ...]) -> bool:
    """Whether a number is one of a contact between pin and socket."""
    return any(path.startswith(f"joints.{joint}.") for joint in joints)


def _is_smooth(machine: Machine, path: str, joints: tuple[str, ...]) -> bool:
    """Whether a number has to do with the motions between impacts, not with a contact, rubbing or the drive."""
    rubbing = (f"joints.{name}.{number}" for name in machine.sliding_joints for number in ("friction", "presliding"))
    if path.startswith(tuple(rubbing)) or path.endswith(".journal_friction"):
        return False
    return not path.startswith("drive.") and ".motion." not in path and not _is_contact(path, joints)
