"""The answer of a diagnosis: shapes of its JSON, the same for the program and the API."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from jointplay.catalogue.diagnosing.answer_of_baseline import BaselineShown, Frozen, PastShown
from jointplay.catalogue.matching.modes import Effort, Mode, ModeAsked
from jointplay.catalogue.signals.recipe_steps import RecipeStep

Verdict = Literal["worn", "in_order", "changed", "unknown"]
Bound = Literal["none", "at_least", "at_most"]
Condition = Literal["worn", "in_order", "open"]


class JointClearance(Frozen):
    """Radial clearance of one joint: median and central 90 % interval, micrometres."""

    clearance_um: float
    interval_um: tuple[float, float]


class JointState(Frozen):
    """What a recording says of one joint, whatever the others are like.

    Attributes
    ----------
    condition : {"worn", "in_order", "open"}
        The only one of worn and in order that is left at the coverage asked for; open where both are, or neither is.
    p_worn : float
        Probability of play beyond that of a fit.
    p_over_limit : float
        Probability of a clearance above `limit_um`.
    limit_um : float
        From which on the joint is worn out: of the machine that was asked about, or as the machine file says.
    clearance_um, interval_um : float
        Median and central 90 % interval of its clearance, micrometres, of fit or wear.
    bound : {"none", "at_least", "at_most"}
        Whether the clearance reaches the largest or the smallest the catalogue holds: then it is a bound.
    detectable_from_um : float or None
        Smallest clearance that such a recording would have shown with 95 % probability, the other joints as they are;
        None where no clearance of the catalogue would.
    """

    condition: Condition
    p_worn: Annotated[float, Field(ge=0.0, le=1.0)]
    p_over_limit: Annotated[float, Field(ge=0.0, le=1.0)]
    limit_um: float
    clearance_um: float
    interval_um: tuple[float, float]
    bound: Bound
    detectable_from_um: float | None


class Cause(Frozen):
    """Something other than play that would make such a recording.

    Attributes
    ----------
    name : str
        "mount 1", "unbalance", "load", "ripple of the drive, order 6" ...
    size : float
    unit : str
        What the size is in: "x stiffness", "kg m", "N" ...
    probability : float
        Among the causes that were tried, play alone among them.
    since : bool
        Whether it has come since the recordings of the baseline, as these say; what the machine's file does not know
        may have been there always.
    """

    name: str
    size: float
    unit: str
    probability: Annotated[float, Field(ge=0.0, le=1.0)]
    since: bool = False


class SensorFlaw(Frozen):
    """What is wrong with sensors.

    Attributes
    ----------
    sensors : tuple of str
    kind : {"swapped", "inverted", "dead", "gain", "contradicts"}
    said : str
        In a sentence.
    """

    sensors: tuple[str, ...]
    kind: Literal["swapped", "inverted", "dead", "gain", "contradicts"]
    said: str


class RankedHypothesis(Frozen):
    """One explanation.

    Attributes
    ----------
    label : str
        Its name in the catalogue: "F", "A+C", "healthy".
    joints : mapping of str to JointClearance
        Worn joints; empty for a healthy machine.
    probability : float
        Among the hypotheses of the catalogue.
    distance_db : float
        Root mean square difference between measured and predicted levels.
    """

    label: str
    joints: Mapping[str, JointClearance]
    probability: Annotated[float, Field(ge=0.0, le=1.0)]
    distance_db: Annotated[float, Field(ge=0.0)]


class GoodnessOfFit(Frozen):
    """Whether a likely hypothesis explains the recording: share of its own simulated recordings that fit it worse.

    Of the candidate set's hypothesis that fits best, which need not be the most probable one.
    """

    p_value: Annotated[float, Field(gt=0.0, le=1.0)]


class BandEvidence(Frozen):
    """One compared level.

    Attributes
    ----------
    order, low_hz, high_hz : float
        Middle of the band in orders of the drive; its edges.
    channel : str
        "x", "y", "theta" of the frame, or a sensor.
    measured_db, predicted_db, spread_db : float
        Level re 1 (m/s2)^2 or 1 (rad/s2)^2: measured, expected under the best hypothesis, and its standard deviation.
    z : float
        (measured - predicted) / spread.
    rival_db : float or None
        Level expected under the rival; None without one.
    favours_best : float or None
        Log-likelihood ratio of the best hypothesis to the rival in this band alone, as if it depended on no other.
    """

    order: float
    low_hz: float
    high_hz: float
    channel: str
    measured_db: float
    predicted_db: float
    spread_db: float
    z: float
    rival_db: float | None = None
    favours_best: float | None = None


class Evidence(Frozen):
    """Measured against predicted levels under the best hypothesis: single orders, and bands above them.

    Attributes
    ----------
    orders, bands : tuple of BandEvidence
    rival : str or None
        Label of the next hypothesis with other worn joints, which the bands decide against.
    """

    orders: tuple[BandEvidence, ...]
    bands: tuple[BandEvidence, ...]
    rival: str | None = None


class ModeUsed(Frozen):
    """How far the model of the machine was believed.

    Attributes
    ----------
    asked : {"auto", "trusted", "robust"}
    used : {"trusted", "robust"}
        As simulated, or with everything that may differ in the real machine.
    trusted_p_value : float or None
        Goodness of fit of the trusted model, which decides where the choice is free; None where it was not asked.
    """

    asked: ModeAsked
    used: Mode
    trusted_p_value: float | None


class PriorUsed(Frozen):
    """What was held likely before the recording.

    Attributes
    ----------
    worn : float
        Probability that any joint is worn, joints alike.
    another : float
        How much likelier one worn joint more is, whichever they are.
    joints : mapping of str to float
        What a worn joint multiplies the weight of a hypothesis by; 1 for those that are not named.
    numbers : tuple of float
        Probabilities of one, two ... worn joints where any is, joints alike, as far as the catalogue holds them.
    """

    worn: float
    another: float
    joints: Mapping[str, float]
    numbers: tuple[float, ...]


class EffortSpent(Frozen):
    """What was simulated for this answer, or for its machine when an earlier one was asked for.

    Attributes
    ----------
    simulations, generations : int
        Cases of the machine as found, or as its baseline tells it, and in how many rounds.
    note : str
        Why there were none or no more, and what they changed; empty for other efforts than thorough.
    """

    simulations: int
    generations: int
    note: str


class Suggestion(Frozen):
    """One thing that could be done to tell the first hypotheses apart, and what it would bring.

    Attributes
    ----------
    kind : {"sensor", "direction", "speed", "load"}
        A sensor of the machine file, or one at another point; another direction where there is a sensor; a recording
        at another drive speed besides this one; one under another constant load of the process, beside what the machine
        file has.
    what : str
        In words: "s2-y", "y at (0.2, -0.1) m", "96 rpm", "-300 N".
    hypotheses : tuple of str
        Labels that are told apart.
    separation_now, separation : float
        Distance of the hypotheses in standard deviations, as it is and as it would be; of three, what gives the same
        error.
    error_now, error : float
        Probability that the first of these hypotheses is not the true one, if one of them is, and what is to be
        expected of it then.
    information_bits : float
        What it is expected to say of which of them is true.
    """

    kind: Literal["sensor", "direction", "speed", "load"]
    what: str
    hypotheses: tuple[str, ...]
    separation_now: float
    separation: float
    error_now: float
    error: float
    information_bits: float = 0.0


class RecordingShare(Frozen):
    """What one of several recordings has contributed to a common answer.

    Attributes
    ----------
    measurement, sha256 : str
        Name of the recording, and checksum of its bytes.
    drive_speed_rpm : float
    alone : str
        Most probable hypothesis by this recording alone.
    p_alone : float
        Its probability then.
    verdict : Verdict
        By this recording alone.
    weight : float
        What it counts for which joints are worn: 1 alone, less beside others as far as they have the same wrong; 0
        where it was left out.
    without, p_without : str, float
        Most probable hypothesis by all others that count, and its probability; empty and 0 where there are none.
    one_machine : float
        How many times likelier this recording is as one of the machine of the others, in the same state, than as one of
        any other; below 1 it contradicts them.
    contradicts : bool
        Whether it says clearly otherwise than the others.
    left_out : str
        Why it does not count; empty where it does.
    held_shut : tuple of str
        Joints of the common answer that it looks to have in order: it agrees if a load held them shut that day, and not
        if it was made before they wore, or after they were repaired.
    """

    measurement: str
    sha256: str
    drive_speed_rpm: float
    alone: str
    p_alone: float
    verdict: Verdict
    weight: float
    without: str
    p_without: float
    one_machine: float
    contradicts: bool
    left_out: str = ""
    held_shut: tuple[str, ...] = ()


class MatcherIdentity(Frozen):
    """Which method matched, and the SHA-256 of the network whose opinion counted, where there is one."""

    name: str
    version: str
    network: str | None = None


class Provenance(Frozen):
    """Everything that determined the answer.

    Attributes
    ----------
    measurement, measurement_sha256 : str
        Name of the recording, and checksum of its bytes.
    catalogue_sha256, machine_sha256 : str
        Checksums of the catalogue's content and of the machine.
    solver_version, catalogue_solver_version : str
        Of this program, and of the one the catalogue was built with.
    matcher : MatcherIdentity
    recipe : tuple of RecipeStep
        What was done to the recording, in order.
    """

    measurement: str
    measurement_sha256: str
    catalogue_sha256: str
    machine_sha256: str
    solver_version: str
    catalogue_solver_version: str
    matcher: MatcherIdentity
    recipe: tuple[RecipeStep, ...]


class Answer(Frozen):
    """What a recording says of a machine."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    id: str
    """Follows from recording, catalogue, settings and versions: the same question has the same id."""
    machine: str
    catalogue: str
    """Name of its folder."""
    drive_speed_rpm: float
    """Estimated, or as given."""
    effort: Effort
    """How much was computed."""
    effort_spent: EffortSpent
    """What was simulated for this answer alone."""
    mode: ModeUsed
    """How far the model of the machine was believed."""
    prior: PriorUsed
    """What was held likely before the measurement."""
    verdict: Verdict
    """`worn`: some joint is; `in_order`: none is; `changed`: the machine is not as its file says, and not surely by
    play; `unknown`: nothing explains the measurement, or nothing surely enough."""
    joints: Mapping[str, JointState]
    """Every joint of the catalogue by itself."""
    hypotheses: tuple[RankedHypothesis, ...]
    """The most probable first; no joints: no wear."""
    causes: tuple[Cause, ...]
    """Other than play, the most probable first; empty: none is needed or known."""
    sensors: tuple[SensorFlaw, ...]
    """What is wrong with which sensors."""
    joint_probabilities: Mapping[str, float]
    """Of each joint, to be among the worn ones."""
    candidate_set: tuple[str, ...]
    """Labels of the fewest hypotheses that hold the truth at `coverage`, if it is in the catalogue."""
    coverage: float
    """As asked."""
    widened: bool
    """No hypothesis was in that set, and it was widened: what it holds is approximate."""
    goodness_of_fit: GoodnessOfFit
    evidence: Evidence
    baseline: BaselineShown | None
    """What a recording of the machine in order said; null without one."""
    past: PastShown | None = None
    """How the recording differs from that one as such; null without one, or where it is by other sensors."""
    suggestions: tuple[Suggestion, ...]
    """What would tell the first hypotheses apart, the best first."""
    recordings: tuple[RecordingShare, ...] = ()
    """Of a common answer to several recordings, what each has contributed; empty for one. Then `provenance`, `evidence`
    and `drive_speed_rpm` are of the first that counts."""
    warnings: tuple[str, ...]
    provenance: Provenance


class Diagnosis(Answer):
    """Answer to one recording; its JSON is the program's."""

    hash: str
    """SHA-256 of the canonical JSON of everything else."""

    def to_json(self, indent: int | None = 2) -> str:
        """Return the JSON text."""
        return self.model_dump_json(indent=indent)

    def __str__(self) -> str:
        """Return verdict, worn joints and causes in one line."""
        parts = []
        for name, state in self.joints.items():
            if state.condition == "worn":
                low, high = state.interval_um
                parts.append(f"{name} {state.clearance_um:.3g} um ({low:.3g} to {high:.3g})")
        parts += [f"{cause.name} {cause.size:.3g} {cause.unit}" for cause in self.causes]
        told = f": {', '.join(parts)}" if parts else ""
        return f"{self.machine} {self.verdict.replace('_', ' ')}{told}; p = {self.goodness_of_fit.p_value:.2g}"

    def __repr__(self) -> str:
        return f"<Diagnosis {self}>"
