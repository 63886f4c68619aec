"""What is known of a machine over its life: recordings with their answers, and inspections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from jointplay.catalogue.diagnosing.answer import Answer
from jointplay.catalogue.errors import DiagnosisError


@dataclass(frozen=True)
class Visit:
    """A recording, and what it was answered.

    Parameters
    ----------
    at : datetime
        When it was made, with a time zone.
    sha256 : str
        Of its bytes: the same recording counts once.
    answer : Answer
        To this recording alone.
    """

    at: datetime
    sha256: str
    answer: Answer


@dataclass(frozen=True)
class Inspection:
    """What somebody measured at joints.

    Parameters
    ----------
    at : datetime
        With a time zone.
    joints : mapping of str to float
        Radial clearance as found, m, >= 0.
    repaired : frozenset of str
        Joints that were as new afterwards, measured or not.
    key : str
        What it is called; the same one counts once.
    """

    at: datetime
    joints: Mapping[str, float] = field(default_factory=dict)
    repaired: frozenset[str] = frozenset()
    key: str = ""

    def __post_init__(self) -> None:
        for joint, clearance in self.joints.items():
            if not 0.0 <= clearance < math.inf:
                raise DiagnosisError(f"inspection: joints.{joint}: {clearance}: must be a clearance of 0 m or more")


Event = Visit | Inspection


def put_in_order(visits: Sequence[Visit], inspections: Sequence[Inspection]) -> list[Event]:
    """Return what happened in the order in which it did, each recording and each inspection once.

    Of several answers to one recording the last of the sequence counts, at the earliest of their times, and the order
    of the sequence does not matter otherwise: what comes late, or twice, leaves the same life. Of what is found at one
    moment, what was mended comes last.

    Raises
    ------
    DiagnosisError
        A time has no zone.
    """
    for at in [visit.at for visit in visits] + [found.at for found in inspections]:
        if at.tzinfo is None:
            raise DiagnosisError(f"at: {at.isoformat()}: must have a time zone")
    once: dict[str, Visit] = {}
    for visit in visits:
        earliest = min(visit.at, once.get(visit.sha256, visit).at, key=_utc)
        once[visit.sha256] = replace(visit, at=_utc(earliest))
    inspections = [replace(found, at=_utc(found.at)) for found in inspections]
    known = {
        (found.at, found.key, *sorted(found.joints.items()), *sorted(found.repaired)): found for found in inspections
    }
    # A recording of the moment of an inspection is of the machine as it was found.
    events: list[tuple[datetime, int, str, Event]] = [(visit.at, 0, visit.sha256, visit) for visit in once.values()]
    events += [(found.at, 2 if found.repaired else 1, repr(key), found) for key, found in known.items()]
    return [event for _, _, _, event in sorted(events, key=lambda item: item[:3])]


def _utc(at: datetime) -> datetime:
    """The same moment: times of one zone are compared by their clocks, which stand twice at some when summer ends."""
    return at.astimezone(UTC)
