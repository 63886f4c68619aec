"""Protocols: of what kind the held-out recordings of an evaluation are, and under which conditions they are made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation.differences import DIFFERENCES
from jointplay.catalogue.evaluation.spoiling import SPOILINGS
from jointplay.catalogue.evaluation.truth import Truth, draw_contacts
from jointplay.catalogue.plans.driving import at_speed, nominal_drive_speed
from jointplay.catalogue.plans.entry import Hypothesis, seed_from
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import Machine

ProtocolKind = Literal["listed", "healthy", "singles", "pairs", "triples", "sets"]

LEAST_REVOLUTIONS = 5.0
"""Length of a recording in drive revolutions, at least."""

LARGEST_SET = 3
"""Worn joints of the kind `sets`, at most."""


@dataclass(frozen=True)
class EvaluationProtocol:
    """Conditions of held-out recordings.

    Parameters
    ----------
    name : str
    kind : {"listed", "healthy", "singles", "pairs", "triples", "sets"}
        What the machines are: every hypothesis of the catalogue in turn; in order; in order and single worn joints in
        turn; two or three worn joints, or any sets of one to three, whether the catalogue holds such hypotheses or not.
        Every joint that is not worn has the play of a fit. Sets come in an order of the seed, and need not all come.
    differences : tuple of str
        In what the machines differ from the model, names in
        :data:`jointplay.catalogue.evaluation.differences.DIFFERENCES`.
    spoiling : str
        What spoils the recordings, a name in :data:`jointplay.catalogue.evaluation.spoiling.SPOILINGS`; empty for
        nothing.
    foreign : bool
        True where no hypothesis is the truth, and "unknown" the right answer.
    unlisted : bool
        Hypotheses of the machines are taken out of the catalogue.
    sensor_noise : float
        White noise of each sensor up to half the sample rate, rms, m/s2.
    frame_noise : tuple of float
        White noise of the frame's x, y (m/s2) and theta (rad/s2), rms: vibration from elsewhere.
    clearance : tuple of float
        Radial clearances of worn joints, log-uniform, m.
    beyond : tuple of float or None
        In place of these: as multiples of the largest clearance that the catalogue tells.
    fits : tuple of float
        Radial clearances of the joints that are not worn, log-uniform, m.
    speed : float
        Largest deviation of the drive speed from nominal, relative, uniform.
    friction : tuple of float
        Contact friction, uniform.
    scatter : float
        Standard deviation of the logarithms of contact stiffness and damping.
    revolutions : float
        Length of a recording, in turns of its drive; never less than five.
    sample_rate : float
        Hz.
    """

    name: str
    kind: ProtocolKind = "listed"
    differences: tuple[str, ...] = ()
    spoiling: str = ""
    foreign: bool = False
    unlisted: bool = False
    sensor_noise: float = 0.0
    frame_noise: tuple[float, float, float] = (0.1, 0.1, 0.5)
    clearance: tuple[float, float] = (50e-6, 1e-3)
    beyond: tuple[float, float] | None = None
    fits: tuple[float, float] = (3e-6, 15e-6)
    speed: float = 0.03
    friction: tuple[float, float] = (0.01, 0.15)
    scatter: float = 0.4
    revolutions: float = 40.0
    sample_rate: float = 10_000.0

    @property
    def least_revolutions(self) -> float:
        """Length of a recording that can be diagnosed, in turns of its drive."""
        return max(self.revolutions, 1.01 * LEAST_REVOLUTIONS)

    def of(self, catalogue: Catalogue) -> EvaluationProtocol:
        """Return the protocol with clearances in place of multiples of the largest that a catalogue tells."""
        if self.beyond is None:
            return self
        low, high = (factor * catalogue.plan.clearance.high for factor in self.beyond)
        return replace(self, clearance=(low, high), beyond=None)

    def hypotheses(self, catalogue: Catalogue, seed: int = 1) -> tuple[Hypothesis, ...]:
        """Return the hypotheses that recordings are made of, in turn.

        Parameters
        ----------
        catalogue : Catalogue
        seed : int
            Of the order of sets.

        Raises
        ------
        DiagnosisError
            The machine has too few joints that can wear.
        """
        joints = sorted(catalogue.machine.wearing_joints)
        if self.kind == "listed":
            return catalogue.entries.hypotheses
        if self.kind == "healthy":
            return (Hypothesis.of(()),)
        if self.kind == "singles":
            return (Hypothesis.of(()), *(Hypothesis.of([joint]) for joint in joints))
        if self.kind == "sets":
            sizes = range(1, min(LARGEST_SET, len(joints)) + 1)
            found = [Hypothesis.of(worn) for size in sizes for worn in combinations(joints, size)]
            np.random.default_rng(seed_from("sets", seed)).shuffle(found)
            return tuple(found)
        count = 2 if self.kind == "pairs" else 3
        if len(joints) < count:
            raise DiagnosisError(f"protocol {self.name}: {len(joints)} joints that can wear: must be at least {count}")
        return tuple(Hypothesis.of(worn) for worn in combinations(joints, count))


_HARD = EvaluationProtocol("hard")
_MODEL_ERRORS = {
    "a": ("law",),
    "b": ("resonance",),
    "b2": ("mode",),
    "c": ("frame",),
    "d": ("gain",),
    "e": ("load",),
    "all": ("law", "resonance", "frame", "gain", "load"),
}
_OTHER_CAUSES = (
    *("half-mount", "loose-mount", "soft-mounts", "frame-mass", "unbalance", "bent-rail", "load", "ripple"),
    *("frame", "mode"),
)
_DISTURBED = ("shocks", "neighbour", "gear-mesh", "bursts", "clipping")
_SENSOR_FLAWS = ("swapped", "inverted", "dead")
_DROP_OUTS = {"short": 15.0, "long": 50.0}
"""Revolutions of recordings that lack 25 ms and half a second: 3 and 10 s at 300 rpm."""

PROTOCOLS: Mapping[str, EvaluationProtocol] = {
    protocol.name: protocol
    for protocol in (
        EvaluationProtocol("matched", sensor_noise=0.02, frame_noise=(0.0, 0.0, 0.0)),
        EvaluationProtocol("noisy", sensor_noise=0.1, frame_noise=(0.0, 0.0, 0.0)),
        _HARD,
        replace(_HARD, name="healthy", kind="healthy"),
        replace(_HARD, name="pairs", kind="pairs"),
        replace(_HARD, name="triples", kind="triples"),
        replace(_HARD, name="small", kind="sets", clearance=(30e-6, 500e-6)),
        replace(_HARD, name="beyond-range", kind="singles", beyond=(1.05, 1.5)),
        replace(_HARD, name="cyclic-load", kind="singles", differences=("cyclic-load", "motor-ripple")),
        *(replace(_HARD, name=f"disturbed-{name}", kind="singles", spoiling=name) for name in _DISTURBED),
        *(replace(_HARD, name=f"sensor-flaw-{name}", kind="singles", spoiling=name) for name in _SENSOR_FLAWS),
        *(
            replace(_HARD, name=f"drop-out-{name}", kind="singles", spoiling=f"{name}-gap", revolutions=revolutions)
            for name, revolutions in _DROP_OUTS.items()
        ),
        *(
            replace(_HARD, name=f"model-error-{name}", kind="singles", differences=differences)
            for name, differences in _MODEL_ERRORS.items()
        ),
        *(
            replace(_HARD, name=f"other-cause-{name}", kind="singles", differences=(name,), foreign=True)
            for name in _OTHER_CAUSES
        ),
        replace(_HARD, name="other-cause-unlisted-pair", kind="pairs", foreign=True, unlisted=True),
    )
}
"""Protocols by name; all but the first two add vibration from elsewhere to the frame."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    group: tuple(name for name in PROTOCOLS if name.startswith(f"{group.removesuffix('s')}-"))
    for group in ("model-error", "other-cause", "disturbed", "sensor-flaws", "drop-outs")
}
"""Names that stand for several protocols."""


def protocols_of(names: Sequence[str | EvaluationProtocol]) -> tuple[EvaluationProtocol, ...]:
    """Return protocols by name, groups written out, each once.

    Raises
    ------
    DiagnosisError
        A name that is not known, or a difference or spoiling that is not.
    """
    found: dict[str, EvaluationProtocol] = {}
    for name in names:
        if isinstance(name, EvaluationProtocol):
            unknown = set(name.differences) - set(DIFFERENCES)
            if unknown:
                known = ", ".join(DIFFERENCES)
                raise DiagnosisError(f"protocol {name.name}: difference {min(unknown)}: must be one of {known}")
            if name.spoiling and name.spoiling not in SPOILINGS:
                known = ", ".join(SPOILINGS)
                raise DiagnosisError(f"protocol {name.name}: spoiling {name.spoiling}: must be one of {known}")
            found[name.name] = name
            continue
        if name not in PROTOCOLS and name not in GROUPS:
            raise DiagnosisError(f"protocol: {name}: must be one of {', '.join([*PROTOCOLS, *GROUPS])}")
        for each in GROUPS.get(name, (name,)):
            found[each] = PROTOCOLS[each]
    return tuple(found.values())


def with_noise(protocol: EvaluationProtocol, noise: float) -> EvaluationProtocol:
    """Return a protocol with so much noise, and named so.

    Parameters
    ----------
    protocol : EvaluationProtocol
    noise : float
        Rms, m/s2: of the frame's x and y where the protocol has vibration from elsewhere, with theta in proportion;
        else of each sensor.

    Raises
    ------
    DiagnosisError
        A number that is no noise.
    """
    if not 0.0 <= noise < math.inf:
        raise DiagnosisError(f"noise: {noise:g} m/s2: must be a finite number, at least 0")
    name = f"{protocol.name}, {noise:g} m/s2"
    if protocol.sensor_noise or not max(protocol.frame_noise[:2]):
        return replace(protocol, name=name, sensor_noise=noise)
    x, y, theta = protocol.frame_noise
    factor = noise / max(x, y)
    return replace(protocol, name=name, frame_noise=(factor * x, factor * y, factor * theta))


def draw_truth(machine: Machine, hypothesis: Hypothesis, protocol: EvaluationProtocol, seed: int, number: int) -> Truth:
    """Draw a machine of a hypothesis under the conditions of a protocol, without the protocol's differences.

    What is drawn follows from seed, hypothesis and number alone where protocols ask for the same ranges: so the
    recordings of two protocols differ only in what the protocols differ in.
    """
    draws = np.random.default_rng(seed_from("truth", seed, hypothesis.label, number))
    joints = tuple(sorted(machine.wearing_joints))
    ranges = {joint: protocol.clearance if joint in hypothesis.joints else protocol.fits for joint in joints}
    clearances = {
        joint: float(math.exp(draws.uniform(math.log(low), math.log(high)))) for joint, (low, high) in ranges.items()
    }
    speed = nominal_drive_speed(machine) * (1.0 + float(draws.uniform(-protocol.speed, protocol.speed)))
    friction = {f"joints.{joint}.contact.friction": float(draws.uniform(*protocol.friction)) for joint in joints}
    parameters = {**at_speed(machine, speed), **friction, **draw_contacts(machine, joints, protocol.scatter, draws)}
    return Truth(
        hypothesis=hypothesis,
        machine=machine,
        clearances=clearances,
        parameters=parameters,
        seconds=protocol.least_revolutions * 2.0 * math.pi / abs(speed),
        gains=(1.0,) * len(machine.sensors),
        seed=seed_from("noise", seed, hypothesis.label, number),
    )
