"""Protocols: of what kind the held-out recordings of an evaluation are, and under which conditions they are made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

from catalogue.errors import DiagnosisError
from catalogue.evaluation.differences import DIFFERENCES
from catalogue.plans.entry import Hypothesis
from catalogue.storage.store import Catalogue

__all__ = ["GROUPS", "PROTOCOLS", "Kind", "Protocol", "protocols_of", "with_noise"]

Kind = Literal["listed", "healthy", "singles", "pairs", "triples"]


@dataclass(frozen=True)
class Protocol:
    """Conditions of held-out recordings.

    Parameters
    ----------
    name : str
    kind : {"listed", "healthy", "singles", "pairs", "triples"}
        What the machines are: every hypothesis of the catalogue in turn; in order; in order and single worn joints in
        turn; two or three worn joints, whether the catalogue holds such hypotheses or not. Every joint that is not worn
        has the play of a fit.
    differences : tuple of str
        In what the machines differ from the model, names in :data:`catalogue.evaluation.differences.DIFFERENCES`.
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
    fits : tuple of float
        Radial clearances of the joints that are not worn, log-uniform, m.
    speed : float
        Largest deviation of the drive speed from nominal, relative, uniform.
    friction : tuple of float
        Contact friction, uniform.
    scatter : float
        Standard deviation of the logarithms of contact stiffness and damping.
    seconds : float
        Length of a recording, s; never less than five revolutions.
    sample_rate : float
        Hz.
    """

    name: str
    kind: Kind = "listed"
    differences: tuple[str, ...] = ()
    foreign: bool = False
    unlisted: bool = False
    sensor_noise: float = 0.0
    frame_noise: tuple[float, float, float] = (0.1, 0.1, 0.5)
    clearance: tuple[float, float] = (50e-6, 1e-3)
    fits: tuple[float, float] = (3e-6, 15e-6)
    speed: float = 0.03
    friction: tuple[float, float] = (0.01, 0.15)
    scatter: float = 0.4
    seconds: float = 2.5
    sample_rate: float = 10_000.0

    def hypotheses(self, catalogue: Catalogue) -> tuple[Hypothesis, ...]:
        """Return the hypotheses that recordings are made of, in turn.

        Raises
        ------
        DiagnosisError
            The machine has too few turning joints.
        """
        joints = sorted(catalogue.machine.turning_joints)
        if self.kind == "listed":
            return catalogue.entries.hypotheses
        if self.kind == "healthy":
            return (Hypothesis.of(()),)
        if self.kind == "singles":
            return (Hypothesis.of(()), *(Hypothesis.of([joint]) for joint in joints))
        count = 2 if self.kind == "pairs" else 3
        if len(joints) < count:
            raise DiagnosisError(f"protocol {self.name}: {len(joints)} turning joints: must be at least {count}")
        return tuple(Hypothesis.of(worn) for worn in combinations(joints, count))


_HARD = Protocol("hard")
_MODEL_ERRORS = {
    "a": ("law",),
    "b": ("resonance",),
    "b2": ("mode",),
    "c": ("frame",),
    "d": ("gain",),
    "e": ("load",),
    "all": ("law", "resonance", "frame", "gain", "load"),
}
_OTHER_CAUSES = ("half-mount", "unbalance", "bent-rail", "load", "frame", "mode")

PROTOCOLS: Mapping[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol("matched", sensor_noise=0.02, frame_noise=(0.0, 0.0, 0.0)),
        Protocol("noisy", sensor_noise=0.1, frame_noise=(0.0, 0.0, 0.0)),
        _HARD,
        replace(_HARD, name="healthy", kind="healthy"),
        replace(_HARD, name="pairs", kind="pairs"),
        replace(_HARD, name="triples", kind="triples"),
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
    group: tuple(name for name in PROTOCOLS if name.startswith(f"{group}-")) for group in ("model-error", "other-cause")
}
"""Names that stand for several protocols."""


def protocols_of(names: Sequence[str | Protocol]) -> tuple[Protocol, ...]:
    """Return protocols by name, groups written out, each once.

    Raises
    ------
    DiagnosisError
        A name that is not known, or a difference that is not.
    """
    found: dict[str, Protocol] = {}
    for name in names:
        if isinstance(name, Protocol):
            unknown = set(name.differences) - set(DIFFERENCES)
            if unknown:
                known = ", ".join(DIFFERENCES)
                raise DiagnosisError(f"protocol {name.name}: difference {min(unknown)}: must be one of {known}")
            found[name.name] = name
            continue
        if name not in PROTOCOLS and name not in GROUPS:
            raise DiagnosisError(f"protocol: {name}: must be one of {', '.join([*PROTOCOLS, *GROUPS])}")
        for each in GROUPS.get(name, (name,)):
            found[each] = PROTOCOLS[each]
    return tuple(found.values())


def with_noise(protocol: Protocol, noise: float) -> Protocol:
    """Return a protocol with so much noise, and named so.

    Parameters
    ----------
    protocol : Protocol
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
