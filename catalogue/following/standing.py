"""What a machine asks of somebody: in order, to be watched, an alarm, or not known; with the reason in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Literal, get_args

from pydantic import Field

from jointplay.catalogue.diagnosing.answer import Verdict
from jointplay.catalogue.diagnosing.answer_of_baseline import Frozen
from jointplay.catalogue.following.state import CauseFollowed, JointFollowed, Share

StandingName = Literal["in_order", "unknown", "watch", "alarm"]
SEVERITY: tuple[StandingName, ...] = get_args(StandingName)
"""From what asks least of somebody to what asks most."""

LIKELY = 0.5
"""Probability from which on a joint is worn, or beyond its limit."""

NEAR = 0.1
"""Probability to be beyond its limit from which on a joint is near it."""

RECORDINGS, WEAR, VERDICT = "recordings", "wear", "verdict"
"""What a reason is about, besides joints and causes."""


class JointKnown(Frozen):
    """What is known of one joint.

    Attributes
    ----------
    p_worn, p_over_limit, clearance_um, interval_um, limit_um, limit_at
        As in :class:`~jointplay.catalogue.following.state.JointFollowed`.
    """

    p_worn: Share
    p_over_limit: Share
    clearance_um: float
    interval_um: tuple[float, float]
    limit_um: float
    limit_at: tuple[datetime | None, datetime | None, datetime | None]

    @classmethod
    def of(cls, joint: JointFollowed) -> JointKnown:
        """Return what a state of wear says of a joint."""
        return cls(**{name: getattr(joint, name) for name in cls.model_fields})

    def is_over(self, at: datetime) -> bool:
        """Return whether it is likelier beyond its limit than not at a moment."""
        return self.p_over_limit >= LIKELY or self.is_due(at, timedelta(0))

    def is_due(self, at: datetime, within: timedelta) -> bool:
        """Return whether it has likely reached its limit by a time after a moment."""
        likely = self.limit_at[1]
        return self.p_worn >= LIKELY and likely is not None and likely <= at + within

    def is_near(self, at: datetime, within: timedelta) -> bool:
        """Return whether it may be beyond its limit, or will be soon, but is not yet."""
        return not self.is_over(at) and (self.p_over_limit >= NEAR or self.is_due(at, within))


class Known(Frozen):
    """What a machine is judged by.

    Attributes
    ----------
    heard_at : datetime or None
        When its last recording was made; None without any.
    verdict, verdict_at, diagnosis : str, datetime, str, or None
        Of the last recording that was diagnosed, when that was made, and the id of the answer.
    joints : mapping of str to JointKnown
        By all recordings; empty where none was diagnosed.
    causes : mapping of str to CauseFollowed
        Other than play, that are likely there by all recordings.
    failure : str
        Why its wear could not be followed; empty where it could.
    repaired : bool
        Whether all joints that this recording found worn were repaired after it.
    """

    heard_at: datetime | None = None
    verdict: Verdict | None = None
    verdict_at: datetime | None = None
    diagnosis: str | None = None
    joints: Mapping[str, JointKnown] = {}
    causes: Mapping[str, CauseFollowed] = {}
    failure: str = ""
    repaired: bool = False

    @property
    def limit_at(self) -> tuple[datetime | None, datetime | None, datetime | None] | None:
        """When the first of its worn joints has reached its limit, with probabilities of 0.05, 0.5 and 0.95."""
        worn = [joint.limit_at for joint in self.joints.values() if joint.p_worn >= LIKELY and joint.limit_at[0]]
        never = datetime.max.replace(tzinfo=UTC)
        return min(worn, key=lambda dates: [date or never for date in (dates[1], dates[0])], default=None)


class Patience(Frozen):
    """How long a machine may be silent, and how long before a limit somebody wants to know.

    Attributes
    ----------
    silent_after, warn_within : timedelta
    """

    silent_after: timedelta
    warn_within: timedelta


class Reason(Frozen):
    """One thing that somebody should know of a machine.

    Attributes
    ----------
    about : str
        ``joint NAME``, ``cause NAME``, recordings, wear or verdict.
    state : str
        What it makes of the machine.
    text : str
    """

    about: str
    state: StandingName = Field(description="What it makes of the machine.")
    text: str


def judge(known: Known, at: datetime, patience: Patience) -> tuple[Reason, ...]:
    """Return what somebody should know of a machine at a moment, what asks most of them first; nothing: in order."""
    found = [_judge_joint(name, joint, at, patience.warn_within) for name, joint in known.joints.items()]
    found += [_judge_cause(name, cause) for name, cause in known.causes.items()]
    found += [_judge_silence(known, at, patience.silent_after), _judge_verdict(known), _judge_wear(known)]
    reasons = [reason for reason in found if reason is not None]
    return tuple(sorted(reasons, key=lambda reason: -SEVERITY.index(reason.state)))


def state_of(reasons: Sequence[Reason]) -> StandingName:
    """Return the state that reasons make."""
    return max((reason.state for reason in reasons), key=SEVERITY.index, default="in_order")


def is_worse(reasons: Sequence[Reason], before: Sequence[Reason]) -> bool:
    """Return whether something is there that was not, or asks more of somebody than it did."""
    known = {reason.about: SEVERITY.index(reason.state) for reason in before}
    return any(SEVERITY.index(reason.state) > known.get(reason.about, 0) for reason in reasons)


def find_due(known: Known, at: datetime, patience: Patience) -> tuple[str, ...]:
    """Return the joints whose limit is foretold for the time within which somebody wants to know of it."""
    return tuple(name for name, joint in known.joints.items() if joint.is_due(at, patience.warn_within))


def next_change(known: Known, at: datetime, patience: Patience) -> datetime | None:
    """Return the next moment at which time alone changes what :func:`judge` says; None where it never does."""
    moments = [] if known.heard_at is None else [known.heard_at + patience.silent_after]
    for joint in known.joints.values():
        likely = joint.limit_at[1]
        if joint.p_worn >= LIKELY and likely is not None:
            moments += [likely - patience.warn_within, likely]
    return min((moment for moment in moments if moment > at), default=None)


def _judge_joint(name: str, joint: JointKnown, at: datetime, within: timedelta) -> Reason | None:
    limit = f"its limit of {_length(joint.limit_um)}"
    about, likely = f"joint {name}", joint.limit_at[1]
    if joint.p_over_limit >= LIKELY:
        text = f"Joint {name} is beyond {limit}: {_length(joint.clearance_um)}, {_percent(joint.p_over_limit)} sure."
        return Reason(about=about, state="alarm", text=text)
    if likely is not None and joint.is_over(at):
        text = f"Joint {name} has likely reached {limit} by {likely:%Y-%m-%d}."
        return Reason(about=about, state="alarm", text=text)
    if likely is not None and joint.is_due(at, within):
        return Reason(about=about, state="watch", text=f"Joint {name} reaches {limit} about {likely:%Y-%m-%d}.")
    if joint.p_over_limit >= NEAR:
        return Reason(
            about=about,
            state="watch",
            text=f"Joint {name} may be beyond {limit}: {_length(joint.clearance_um)}, {_percent(joint.p_over_limit)}.",
        )
    if joint.p_worn >= LIKELY:
        return Reason(
            about=about, state="watch", text=f"Joint {name} is worn: {_length(joint.clearance_um)}, below {limit}."
        )
    return None


def _judge_cause(name: str, cause: CauseFollowed) -> Reason | None:
    if cause.probability < LIKELY or not cause.since_baseline:  # what was there always is how the machine is
        return None
    moves = f" ({cause.per_year:+.2g} a year)" if cause.per_year else ""
    said = f"{name}, {cause.size:.3g} {cause.unit}{moves}, {_percent(cause.probability)}"
    return Reason(about=f"cause {name}", state="watch", text=f"Since its baseline, besides play: {said}.")


def _judge_silence(known: Known, at: datetime, after: timedelta) -> Reason | None:
    if known.heard_at is None or at < known.heard_at + after:
        return None
    text = f"No recording since {known.heard_at:%Y-%m-%d}, for more than {after.days} days."
    return Reason(about=RECORDINGS, state="unknown", text=text)


def _judge_verdict(known: Known) -> Reason | None:
    if known.verdict == "changed":
        return Reason(
            about=VERDICT, state="watch", text="By its last recording it has changed, and not surely by play."
        )
    if known.repaired:
        return None
    if known.verdict == "worn" and not any(joint.p_worn >= LIKELY for joint in known.joints.values()):
        together = "" if known.failure else "; all recordings together do not say so yet"
        text = f"Its last recording says that a joint is worn{together}."
        return Reason(about=VERDICT, state="watch", text=text)
    if known.verdict == "unknown":
        return Reason(about=VERDICT, state="unknown", text="Its last recording has no verdict.")
    return None


def _judge_wear(known: Known) -> Reason | None:
    if known.failure:
        return Reason(about=WEAR, state="unknown", text=f"Its wear could not be followed: {known.failure}")
    if known.verdict is None:
        heard = "None of its recordings was diagnosed yet." if known.heard_at else "There is no recording of it yet."
        return Reason(about=WEAR, state="unknown", text=heard)
    return None


def _length(micrometres: float) -> str:
    return f"{micrometres:.3g} µm" if micrometres < 999.5 else f"{1e-3 * micrometres:.3g} mm"


def _percent(probability: float) -> str:
    return "> 99 %" if probability >= 0.995 else f"{100 * probability:.0f} %"
