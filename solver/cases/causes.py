"""What makes a scene stiff: the number of the machine file that asks for the shortest steps, and its refusal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.positions import grips_of
from jointplay.solver.cases.rates import ContactRates, extent_of
from jointplay.solver.cases.steps import BETWEEN_IMPACTS, FILM, StepRule, largest_step
from jointplay.solver.equations.drive import prescribes_motion
from jointplay.solver.equations.model import MODELS_KEPT
from jointplay.solver.equations.numbers import contact_path
from jointplay.solver.errors import AssemblyError, MachineError, SettingsError
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.machines.parts import Support
from jointplay.solver.machines.restitution import HYSTERESIS

#: Most memory for one kind of record (displacement, say) of one case.
MOST_BYTES = 2e9
#: Longest run, steps or samples of one case: refused beyond, so that a mistyped number does not run for days.
MOST_STEPS = 2_000_000_000
#: A part is to blame where so many steps of it do not make up so many seconds; else the run is too long.
_ORDINARY_RUN = 100.0
#: Explicit steps that are shorter than both, s and in parts of the time between samples, give way to implicit ones.
#: What rings at longer ones can be followed in a second or two, and explicit steps follow it better.
_SHORT, _SHORT_PART = 2.5e-7, 0.005
#: What explicit steps keep to under error control, where they are stable.
EXPLICIT = replace(BETWEEN_IMPACTS, decay=2.0)
#: A link lighter than its neighbour by this factor is to blame, not the contact between them.
_LIGHT = 1e-3
#: A pin larger than the machine by this factor is a mistyped one.
_LARGEST_PIN = 10.0


@dataclass(frozen=True)
class Cause:
    """A number of the machine, why it is fast, and the longest step that it leaves, s."""

    step: float
    path: str
    value: float | None
    why: str

    def __str__(self) -> str:
        """In one line, without advice."""
        value = "" if self.value is None else f" {self.value:g}:"
        return f"{self.path}:{value} {self.why.partition(';')[0]}"


def refuse_too_many_steps(source: str, duration: float, step: float, causes: Iterator[Cause]) -> None:
    """Refuse a run of absurd length, by the number that makes it one.

    Parameters
    ----------
    source : str
        What the machine is called.
    duration, step : float
        Of the run, and of its longest step, s.
    causes : iterator of Cause

    Raises
    ------
    MachineError
        Names link, joint, support or drive, its number, and what would help.
    SettingsError
        A run that is too long for an ordinary machine.
    """
    if duration <= MOST_STEPS * step:
        return
    cause = min(causes, key=lambda cause: cause.step, default=None)
    if cause is None or MOST_STEPS * step > _ORDINARY_RUN or cause.step > 2 * step:
        raise SettingsError(f"duration: {duration:g} s: needs more than {MOST_STEPS:.0e} steps of {step:.3g} s")
    rule = f"{cause.why}: {duration:g} s need more than {MOST_STEPS:.0e} steps of {step:.3g} s"
    raise MachineError(source, cause.path, cause.value, rule)


def stiff_part(
    machine: Machine, contacts: Mapping[str, ContactRates], mobility: Mapping[str, float], eigenvalues: FloatArray,
    values: Mapping[str, float], sample_rate: float,
) -> Cause | None:  # fmt: skip
    """What settles or swings so far above the band of the results that steps had better be implicit; mostly nothing.

    A guide that wedges is one: where a drive prescribes a motion, its friction beside worn joints grows without bound,
    and with it the rate at which it settles. Contacts that swing are none, because their impacts are to be followed.
    Nor are laws of a restitution, whose rates are those at the worst, which hardly a step meets. Films of oil are taken
    at their thinnest, to which pins come in every revolution.
    """
    for name, grip in (_grips(machine) if contacts else {}).items():
        path, guide = f"joints.{name}.friction", machine.joints[name]
        if not isinstance(guide, SlidingJoint):
            continue
        now = values.get(path, guide.friction)
        if guide.friction and grip * now >= guide.friction:
            wedge = grip * now / guide.friction
            return Cause(0.0, path, now, f"times its leverage on the normal force is {wedge:.3g}: the guide wedges")
    lasting = {
        joint: replace(found, decay=0.0 if machine.joints[joint].contact.law in HYSTERESIS else found.decay)
        for joint, found in contacts.items()
    }
    if largest_step(EXPLICIT, lasting.values(), eigenvalues, 0.0) >= min(_SHORT, _SHORT_PART / sample_rate):
        return None
    causes = chain(
        contact_causes(machine, EXPLICIT, lasting, mobility, values),
        support_causes(machine, EXPLICIT, eigenvalues, values),
    )
    return min(causes, key=lambda cause: cause.step)


@keep_by_machine(MODELS_KEPT)
def _grips(machine: Machine) -> Mapping[str, float]:
    """Friction times leverage of guides that a drive can push without bound; of the ideal machine, if there is one."""
    rubbing = any(isinstance(joint, SlidingJoint) and joint.friction for joint in machine.joints.values())
    if not (rubbing and prescribes_motion(machine)):
        return {}
    try:
        return {name: grip for name, (grip, _) in grips_of(machine).items()}
    except (MachineError, AssemblyError):
        return {}


def contact_causes(
    machine: Machine, rule: StepRule, rates: Mapping[str, ContactRates], mobility: Mapping[str, float],
    values: Mapping[str, float],
) -> Iterator[Cause]:  # fmt: skip
    """What contacts ask for; parameters as :func:`jointplay.solver.cases.rates.contact_rates`."""
    for joint, found in rates.items():
        if not mobility[joint]:
            continue
        masses = {f"links.{link}.mass": _mass(machine, link, values) for link in machine.joints[joint].links}
        light = min(masses, key=lambda path: masses[path])
        on = f"an effective mass of {1 / mobility[joint]:.3g} kg"
        damping = next(name for name in ("damping", "hysteresis", "restitution") if _of(machine, joint, name))
        for name, rate, step, what in (
            ("stiffness", found.frequency, rule.contact, f"swings at {found.frequency / (2 * math.pi):.3g} Hz on {on}"),
            (damping, found.decay, rule.decay, f"damps {on} at {found.decay:.3g} 1/s"),
            ("viscosity", found.film, FILM, f"holds {on} at {found.film:.3g} 1/s"),
        ):
            path = contact_path(joint, name)
            if rate and masses[light] < _LIGHT * max(masses.values()):
                yield Cause(step / rate, light, masses[light], f"joint {joint} {what}; take a heavier link")
            elif rate:
                yield Cause(step / rate, path, values.get(path), f"{what}; take less, or a heavier link")


def _of(machine: Machine, joint: str, name: str) -> bool:
    found = machine.joints[joint]
    return name == "restitution" or found.contact.has(name)


def support_causes(
    machine: Machine, rule: StepRule, eigenvalues: FloatArray, values: Mapping[str, float]
) -> Iterator[Cause]:
    """What supports and viscous joints ask for: the one that is fastest on its link, with the fastest eigenvalue."""
    fastest = max(eigenvalues, key=abs, default=0.0)
    rates: list[tuple[float, str, float]] = []
    for i, support in enumerate(machine.supports):
        ends = [link for link in (support.link, support.to_link) if link is not None]
        mass = min(_mass(machine, link, values) for link in ends)
        for name in ("stiffness", "damping"):
            for path, value in _numbers(support, name, f"supports.{i}.{name}"):
                now = values.get(path, value)
                rates.append((math.sqrt(now / mass) if name == "stiffness" else now / mass, path, now))
    for i, mode in enumerate(machine.modes):
        path = f"modes.{i}.frequency"
        now = values.get(path, mode.frequency)
        rates.append((2 * math.pi * now, path, now))
    for joint, found in machine.joints.items():
        inertia = min(_inertia(machine, link, values) for link in found.links)
        mass = min(_mass(machine, link, values) for link in found.links)
        path = f"joints.{joint}.viscous"
        now = values.get(path, found.viscous)
        rates.append((now / (inertia if isinstance(found, TurningJoint) else mass), path, now))
    if not abs(fastest) or not rates:
        return
    _, path, value = max(rates)
    swing = f"swings at {abs(fastest) / (2 * math.pi):.3g} Hz"
    what = swing if abs(fastest.imag) > abs(fastest.real) else f"decays at {abs(fastest):.3g} 1/s"
    why = f"a motion that it holds {what}; take a smaller one, or lock the motion that nothing should see"
    yield Cause(rule.smooth / abs(fastest), path, value, why)


def _numbers(support: Support, name: str, path: str) -> Iterator[tuple[str, float]]:
    value = getattr(support, name, None)
    if isinstance(value, tuple):
        yield from ((f"{path}.{k}", part) for k, part in enumerate(value))
    elif value is not None:
        yield path, value


def _mass(machine: Machine, link: str, values: Mapping[str, float]) -> float:
    return values.get(f"links.{link}.mass", machine.links[link].mass or math.inf)


def _inertia(machine: Machine, link: str, values: Mapping[str, float]) -> float:
    return values.get(f"links.{link}.inertia", machine.links[link].inertia or math.inf)


def drive_cause(rule: StepRule, fastest: float, path: str = "drive.speed") -> Cause:
    """What the drive, or ground that moves, asks for at its fastest, rad/s."""
    step = 2 * math.pi / abs(fastest) / rule.per_revolution if fastest else math.inf
    return Cause(step, path, fastest, f"takes {rule.per_revolution:g} steps a revolution; take a slower one")


def check_pins(machine: Machine, joints: tuple[str, ...], values: Mapping[str, float]) -> None:
    """Refuse pins of worn joints that are far larger than the machine: their friction turns links that are not there.

    Raises
    ------
    MachineError
        Names the pin.
    """
    most = _LARGEST_PIN * extent_of(machine)
    for joint in joints:
        path = contact_path(joint, "pin_radius")
        if values.get(path, 0.0) > most:
            rule = f"is more than {_LARGEST_PIN:g} times the machine's extent of {most / _LARGEST_PIN:.3g} m"
            raise MachineError(machine.name, path, values[path], rule)


def check_record(sample_rate: float, duration: float, recorded: int = 3) -> None:
    """Refuse a run whose record, of so many coordinates, does not fit the memory.

    Raises
    ------
    SettingsError
        Names the duration.
    """
    if duration * sample_rate * recorded * 8 > MOST_BYTES:
        too_much = f"{duration * sample_rate:.3g} samples need more than {MOST_BYTES / 1e9:g} GB of records"
        raise SettingsError(f"duration: {duration:g} s: {too_much}; take a lower sample rate")


def check_sample_rate(sample_rate: float, duration: float, speed: float) -> None:
    """Refuse samples that are farther apart than the run is long and than the drive takes for a revolution.

    The filter reaches some 15 samples beyond the end, so that such a run would be mostly what nobody asked for.

    Raises
    ------
    SettingsError
        Names the least rate.
    """
    least = min(1 / duration, abs(speed) / (2 * math.pi) or 1.0)
    if sample_rate < least:
        rule = f"less than one sample in the run of {duration:.3g} s and in a revolution; take at least {least:.3g} Hz"
        raise SettingsError(f"sample rate: {sample_rate:g} Hz: {rule}")
