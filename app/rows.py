"""Rows of the tables that say what a diagnosis found, with the digits that mean something, and its evidence by channel.

The same on the terminal, on the page and in a report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from jointplay.catalogue.diagnosing.answer import Answer, BandEvidence, JointClearance, JointState, RecordingShare

CONDITIONS = {"worn": "worn", "in_order": "in order", "open": "cannot be told"}


@dataclass(frozen=True)
class Play:
    """A radial clearance.

    Parameters
    ----------
    value, interval : str
        No interval where the clearance is a bound.
    joint : str
        Whose it is; empty where that is plain.
    """

    value: str
    interval: str
    joint: str = ""

    def say(self, interval: str = "") -> str:
        """Return all of it, with what the interval is called."""
        value = f"{self.joint} {self.value}" if self.joint else self.value
        return f"{value} ({interval}{self.interval})" if self.interval else value


@dataclass(frozen=True)
class JointRow:
    """What is said of one joint, for a table.

    Parameters
    ----------
    name : str
    condition, said : str
        worn, in_order or open; and in words.
    probability : float
        To be worn.
    percent : str
        The same in words.
    play : Play
    limit, beyond : str
        From which clearance on it is worn out, and how probably it is.
    shows : str
        From which clearance on its wear would have shown; empty where it is not known to.
    """

    name: str
    condition: str
    said: str
    probability: float
    percent: str
    play: Play
    limit: str
    beyond: str
    shows: str


@dataclass(frozen=True)
class HypothesisRow:
    """One hypothesis, for a table.

    Parameters
    ----------
    label : str
    candidate : bool
        Whether it is in the set of candidates.
    plays : tuple of Play
        Of its worn joints.
    probability : float
    percent : str
        The same in words.
    distance : str
    """

    label: str
    candidate: bool
    plays: tuple[Play, ...]
    probability: float
    percent: str
    distance: str

    @property
    def clearance(self) -> str:
        """Clearances of all its joints; empty without one."""
        return "; ".join(play.say() for play in self.plays)


class SuggestionRow(NamedTuple):
    """What to measure besides, the hypotheses that it tells apart, and the share of mistakes now and then."""

    add: str
    hypotheses: str
    now: str
    then: str


def suggestion_rows(result: Answer) -> list[SuggestionRow]:
    """Return what could be done, the best first."""
    return [
        SuggestionRow(
            f"{each.kind} {each.what}", " / ".join(each.hypotheses), percent(each.error_now), percent(each.error)
        )
        for each in result.suggestions
    ]


@dataclass(frozen=True)
class RecordingRow:
    """What one of several recordings has contributed, for a table.

    Parameters
    ----------
    name, speed : str
    alone : str
        What it says alone, and how surely.
    counts : str
        What it counts; empty where it was left out.
    others : str
        What all others say.
    said : str
        How it goes with them.
    contradicts : bool
        Whether it does not, or was left out.
    """

    name: str
    speed: str
    alone: str
    counts: str
    others: str
    said: str
    contradicts: bool


def recording_rows(result: Answer) -> list[RecordingRow]:
    """Return what each of several recordings has contributed; none of one."""
    return [
        RecordingRow(
            share.measurement,
            f"{share.drive_speed_rpm:.6g} rpm",
            f"{share.alone}, {percent(share.p_alone)}",
            f"{share.weight:.2f}" if share.weight else "",
            f"{share.without}, {percent(share.p_without)}" if share.without else "–",
            _with_the_others(share),
            share.contradicts or bool(share.left_out),
        )
        for share in result.recordings
    ]


def _with_the_others(share: RecordingShare) -> str:
    """How a recording goes with the others."""
    if share.left_out:
        return f"left out: {share.left_out}"
    if share.contradicts:
        return "contradicts"
    return f"agrees if a load held {' and '.join(share.held_shut)} shut" if share.held_shut else "agrees"


def hypothesis_rows(result: Answer, most: int | None = None) -> list[HypothesisRow]:
    """Return the first hypotheses, or all, the most probable first."""
    return [
        HypothesisRow(
            entry.label,
            entry.label in result.candidate_set,
            plays(entry.joints),
            entry.probability,
            percent(entry.probability),
            f"{entry.distance_db:.1f} dB",
        )
        for entry in result.hypotheses[:most]
    ]


def plays(joints: Mapping[str, JointClearance | JointState]) -> tuple[Play, ...]:
    """Return the clearances of joints; of a single one without its name."""
    return tuple(play_of(found, name if len(joints) > 1 else "") for name, found in joints.items())


def joint_rows(result: Answer) -> list[JointRow]:
    """Return what is said of every joint, the most probably worn first; nothing for the verdict unknown."""
    joints = {} if result.verdict == "unknown" else result.joints
    return [
        JointRow(
            name,
            state.condition,
            CONDITIONS[state.condition],
            state.p_worn,
            percent(state.p_worn),
            play_of(state),
            length(state.limit_um),
            percent(state.p_over_limit),
            "" if state.detectable_from_um is None else length(state.detectable_from_um),
        )
        for name, state in sorted(joints.items(), key=lambda item: -item[1].p_worn)
    ]


def joint_colours(result: Answer) -> Mapping[str, float]:
    """Return how probable the wear of joints is, for drawings; none where the verdict is not on joints."""
    return result.joint_probabilities if has_decided(result) else {}


def play_of(found: JointClearance | JointState, joint: str = "") -> Play:
    """Return a clearance in words."""
    low, high = found.interval_um
    bound = found.bound if isinstance(found, JointState) else "none"
    if bound != "none":
        return Play(f"at least {length(low)}" if bound == "at_least" else f"at most {length(high)}", "", joint)
    scale, unit = _unit(low, high)
    return Play(f"{scaled(found.clearance_um, scale)} {unit}", f"{scaled(low, scale)} to {scaled(high, scale)}", joint)


def between(low: float, high: float) -> str:
    """Return an interval of clearances with its unit."""
    scale, unit = _unit(low, high)
    return f"{scaled(low, scale)} to {scaled(high, scale)} {unit}"


def show_unit(unit: str) -> str:
    """Return a unit as it is printed: "m/s²", "µm"."""
    return unit.replace("s2", "s²").replace("um", "µm").replace("urad", "µrad")


def length(value: float) -> str:
    """Return a clearance [µm] with its unit, mm from 1 mm on."""
    scale, unit = _unit(value, value)
    return f"{scaled(value, scale)} {unit}"


def _unit(smallest: float, largest: float) -> tuple[float, str]:
    # One unit for a line: what is of both sizes is read in the smaller one, "0.9 to 1860 µm".
    return (1e-3, "mm") if largest >= 999.5 and smallest >= 99.5 else (1.0, "µm")


def scaled(value: float, scale: float) -> str:
    """Return a clearance [µm] times a scale, with the digits that mean something."""
    return micrometres(value) if scale == 1.0 else f"{scale * value:.3g}"


def micrometres(value: float) -> str:
    """Return a clearance with the digits that mean something."""
    return f"{value:.1f}" if value < 10 else f"{value:.0f}"


def order(value: float) -> str:
    """Return an order of the drive with the digits that mean something."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def percent(probability: float) -> str:
    """Return a probability in per cent; what is not certain never reads as certain."""
    if probability >= 0.995:
        return "> 99 %"
    if probability < 0.005:
        return "< 1 %"
    return f"{100 * probability:.0f} %"


NAMES = {"x": "x of the frame", "y": "y of the frame", "theta": "rotation of the frame"}
MOST_DECIDING = 8
UNITS = {"theta": "rad/s²"}


@dataclass(frozen=True)
class Comparison:
    """One channel.

    Parameters
    ----------
    channel : str
        x, y, theta, or the name of a sensor.
    bands : tuple of BandEvidence
        In rising order.
    """

    channel: str
    bands: tuple[BandEvidence, ...]

    @property
    def title(self) -> str:
        """What the channel is called."""
        return NAMES.get(self.channel, self.channel)

    @property
    def label(self) -> str:
        """What the levels are."""
        return f"dB re 1 {UNITS.get(self.channel, 'm/s²')}"


def comparisons(result: Answer) -> list[Comparison]:
    """Return the evidence of a diagnosis by channel, in the order of its appearance.

    Parameters
    ----------
    result : Answer
    """
    found: dict[str, list[BandEvidence]] = {}
    for band in (*result.evidence.orders, *result.evidence.bands):
        found.setdefault(band.channel, []).append(band)
    return [Comparison(channel, tuple(sorted(bands, key=lambda band: band.order))) for channel, bands in found.items()]


def has_decided(result: Answer) -> bool:
    """Return whether the verdict is on joints: without, none is coloured or barred, and no band decided for one."""
    return result.verdict in ("worn", "in_order")


def deciding(result: Answer, found: Sequence[Comparison]) -> list[tuple[Comparison, BandEvidence]]:
    """Return the bands that decided, the strongest first: the fewest that hold half of what speaks for the best.

    They carry the rings, wherever levels are drawn.

    Parameters
    ----------
    result : Answer
    found : sequence of Comparison
        All its channels.
    """
    if not has_decided(result):
        return []
    speaking = [
        (favour, comparison, band)
        for comparison in found
        for band in comparison.bands
        if (favour := band.favours_best or 0.0) > 0
    ]
    speaking.sort(key=lambda each: -each[0])
    half = 0.5 * sum(favour for favour, _, _ in speaking)
    chosen: list[tuple[Comparison, BandEvidence]] = []
    for favour, comparison, band in speaking[:MOST_DECIDING]:
        chosen.append((comparison, band))
        half -= favour
        if half <= 0:
            break
    return chosen
