"""What is asked of a simulation, a case and its settings, and how it may end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, get_args

from jointplay.solver.cases.steps import STEP_RULES, Accuracy
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import HEALTHY, Fault

Method = Literal["adaptive", "rosenbrock", "gill", "gill-variable", "full"]
METHODS: tuple[Method, ...] = get_args(Method)


class Status(StrEnum):
    """How a case ended; a numerical failure is data, not an exception."""

    OK = "ok"
    DIVERGED = "diverged"
    STEP_TOO_SMALL = "step_too_small"
    CANNOT_ASSEMBLE = "cannot_assemble"
    JAMMED = "jammed"


@dataclass(frozen=True)
class Case:
    """One run: a fault state, and numbers of the machine file that differ from the file.

    Attributes
    ----------
    fault : Fault
        All clearances there are, whatever the machine's file gives to joints.
    parameters : mapping of str to float
        By path in the machine file (``links.bed.mass``, ``supports.0.stiffness.1``, ``joints.A.contact.friction``,
        ``drive.speed``), or for every clearance joint at once: ``contact.stiffness``, ``contact.damping``,
        ``contact.restitution``, ``contact.hysteresis``, ``contact.friction``, ``contact.viscous``,
        ``contact.friction_velocity``, ``contact.presliding``, ``pin_radius``. SI units.
    """

    fault: Fault = HEALTHY
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """How to run.

    Attributes
    ----------
    duration : float or None
        Simulated time, s; by default the transient and `revolutions` after it. A machine whose drive is a torque or a
        force runs up before, to its limit cycle, unless a duration is given: that counts from the drawn pose.
    sample_rate : float
        Hz of the results.
    accuracy : str
        ``draft``, ``standard`` or ``reference``: how finely contacts, suspension and drive are resolved.
    method : str or None
        ``adaptive`` (error-controlled, contacts located), ``rosenbrock`` (the same, implicit) or ``gill``
        (Runge-Kutta-Gill, fixed steps); by default ``gill`` where a step is given, else ``adaptive``, or ``rosenbrock``
        for the cases that are far too stiff for it, whose messages say why. For teaching and cross-checks
        ``gill-variable`` (Gill's steps, halved by their error) and ``full`` (fixed steps of the paper's whole system of
        equations).
    rtol : float or None
        Scaled error of a step of ``adaptive``, ``rosenbrock`` and ``gill-variable``, in place of what `accuracy` gives.
    step : float or None
        Longest step of ``gill`` and ``full``, s, in place of what `accuracy` gives.
    revolutions : float
        Revolutions of the drive after the transient where no duration is given; seconds where nothing turns.
    links : bool
        Also give the motion of every link and every reaction.
    motion : bool
        Give displacement, velocity and instantaneous acceleration; without them (and without `links`) a run is
        cheaper, and only the band-limited acceleration is there, to make spectra of.
    transient : bool
        Give the samples before the end of the start-up transient too.
    settled : bool
        Start worn machines with the frame moving as the healthy machine's does after its transient, where there is
        such a steady state and no `duration` is given (:mod:`jointplay.solver.simulation.simulate`): the transient is
        shorter. Where the drive is a torque or a force, driver and frame start as they move in the limit cycle without
        wear (:mod:`jointplay.solver.simulation.turning_starts`), and a case that reaches none has next to no record.
    repeating : bool
        End a run of ``adaptive`` without `motion` as soon as its revolutions, or pairs of them, are seen to repeat
        (:mod:`jointplay.solver.simulation.repeating`): a period then stands for `revolutions`.
    whole : bool
        Model everything that the machine file has, also what its frame cannot feel
        (:mod:`jointplay.solver.cases.reach`); `links` implies it.
    decoupled : bool
        Run the machine on a frame at rest, then move that (:mod:`jointplay.solver.cases.decoupling`).
    most_trials : int or None
        Trial steps under error control after which a case counts as stalled, in place of what its driver allows.
    """

    duration: float | None = None
    sample_rate: float = 20_000.0
    accuracy: Accuracy = "standard"
    method: Method | None = None
    rtol: float | None = None
    step: float | None = None
    revolutions: float = 10.0
    links: bool = False
    motion: bool = True
    transient: bool = True
    settled: bool = False
    repeating: bool = False
    whole: bool = False
    decoupled: bool = False
    most_trials: int | None = None

    def __post_init__(self) -> None:
        for name in ("duration", "sample_rate", "rtol", "step", "revolutions", "most_trials"):
            value = getattr(self, name)
            if value is not None and not (0 < value < math.inf):
                raise SettingsError(f"{name}: {value}: must be a finite number greater than 0")
        if self.accuracy not in STEP_RULES:
            raise SettingsError(f"accuracy: {self.accuracy}: must be one of {', '.join(STEP_RULES)}")
        if self.method not in (None, *METHODS):
            raise SettingsError(f"method: {self.method}: must be one of {', '.join(METHODS)}")
        if self.rtol is not None and not 1e-12 <= self.rtol <= 1e-2:
            raise SettingsError(f"rtol: {self.rtol:g}: must be between 1e-12 and 1e-2")
        if self.rtol is not None and self.fixed_step:
            rule = f"only adaptive, rosenbrock and gill-variable have a tolerance; {self.integrator} has a step"
            raise SettingsError(f"rtol: {self.rtol:g}: {rule}")
        if self.step is not None and not self.fixed_step:
            raise SettingsError(
                f"step: {self.step:g}: only gill and full have a fixed step; {self.integrator} has rtol"
            )
        if self.repeating and (self.motion or self.links or self.duration is not None or self.integrator != "adaptive"):
            raise SettingsError("repeating: needs method adaptive without motion, links and duration")
        if self.links and self.integrator == "full":
            raise SettingsError("links: method full gives the motion of the frame; take adaptive or gill")

    @property
    def integrator(self) -> Method:
        """The method in use."""
        return self.method or ("gill" if self.step is not None else "adaptive")

    @property
    def fixed_step(self) -> bool:
        """Whether the method in use has one."""
        return self.integrator in ("gill", "full")
