"""A machine's state of wear: shapes of its JSON, the same for the program and the API."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated

from pydantic import Field

from jointplay.catalogue.diagnosing.answer_of_baseline import Frozen

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class CoursePoint(Frozen):
    """What was known of a joint when a recording was heard.

    Attributes
    ----------
    at : datetime
        When the recording was made.
    p_worn : float
        By this recording and all before.
    clearance_um, interval_um : float
        Median and central 90 % interval, micrometres, by this recording and all before.
    foretold_um : (float, float)
        Central 90 % interval by those before alone.
    """

    at: datetime
    p_worn: Share
    clearance_um: float
    interval_um: tuple[float, float]
    foretold_um: tuple[float, float]


class JointFollowed(Frozen):
    """A joint after the last recording or inspection.

    Attributes
    ----------
    p_worn, p_over_limit : float
        Probability of play beyond that of a fit, and beyond `limit_um`.
    clearance_um, interval_um : float
        Median and central 90 % interval, micrometres.
    um_per_year : float
        By how much the median grows in the year to come, if nobody mends it.
    limit_um : float
        From which on it is worn out.
    limit_at : (datetime or None, datetime or None, datetime or None)
        When it has reached that with probabilities of 0.05, 0.5 and 0.95, if not mended; None: not within a century.
    first_sure_at : datetime or None
        First recording by which wear was sure, since the joint was last repaired; None where it is likelier in order.
    moved_by : float
        By how much the last recording has changed `p_worn`.
    course : tuple of CoursePoint
        One for each recording.
    """

    p_worn: Share
    p_over_limit: Share
    clearance_um: float
    interval_um: tuple[float, float]
    um_per_year: float
    limit_um: float
    limit_at: tuple[datetime | None, datetime | None, datetime | None]
    first_sure_at: datetime | None
    moved_by: float
    course: tuple[CoursePoint, ...]


class CauseFollowed(Frozen):
    """A cause other than play, by the last recording.

    Attributes
    ----------
    unit : str
        Of its size.
    probability : float
        To be there.
    size : float
        By the recordings since it came, at the last one.
    per_year : float
        By how much the size moves; 0 where fewer than three recordings, or less than a week, say it.
    since : datetime or None
        First recording from which on it was likelier than not.
    since_baseline : bool
        Whether the last recording that names it tells that it was not there when the baseline was recorded.
    """

    unit: str
    probability: Share
    size: float
    per_year: float
    since: datetime | None
    since_baseline: bool


class Repair(Frozen):
    """A joint that was made as new.

    Attributes
    ----------
    at : datetime
        Of the inspection that says so, or of the recording that shows it first.
    joint : str
    probability : float
        1 where an inspection says so.
    """

    at: datetime
    joint: str
    probability: Share

    @property
    def is_told(self) -> bool:
        """Whether an inspection says so."""
        return self.probability == 1.0


class WearState(Frozen):
    """What all recordings and inspections of a machine say of it.

    Attributes
    ----------
    at : datetime
        Of the last of them.
    visits : int
        Recordings that count.
    joints : mapping of str to JointFollowed
    causes : mapping of str to CauseFollowed
        Other than play, by name.
    repairs : tuple of Repair
        In the order of time.
    """

    at: datetime
    visits: int
    joints: Mapping[str, JointFollowed]
    causes: Mapping[str, CauseFollowed]
    repairs: tuple[Repair, ...]
