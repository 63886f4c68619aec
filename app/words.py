"""A diagnosis in words, numbers and moments a person reads, the same on the terminal, on the page and in a report.

In requests, moments are RFC 3339 with a time zone, and nothing that merely resembles it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, AwareDatetime, BeforeValidator

from jointplay.app.rows import between, joint_rows, length, percent, plays

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Answer, Cause, JointState

CLEARLY = 0.8
"""Probability from which on a joint is said to be beyond its limit, or within."""


def recorded(result: Answer, name: str) -> str:
    """Return what an answer is to: a recording of a name, or how many recordings or pieces of that one."""
    count = len(result.recordings)
    if all(share.measurement.startswith(f"{name}, ") for share in result.recordings):
        return f"{name}, {count} pieces" if count else name
    return f"{count} recordings"


def sentence(result: Answer) -> str:
    """Return the verdict in one sentence.

    Parameters
    ----------
    result : Answer
    """
    verdict = result.verdict
    if verdict == "in_order":
        none = "No worn joint" if sound(result) >= result.coverage else "Probably no worn joint"
        return f"{none}: the recording fits a machine in order, probability {probability(result)}{_untold(result)}."
    if verdict == "changed":
        return f"Changed, but not by play{_first_cause(result)}."
    if verdict == "unknown" or not (named := named_joints(result)):
        return _no_verdict(result)
    several = len(named) > 1
    said = "; ".join(
        f"{play.say('90 %: ')}, probability {percent(state.p_worn)}"
        for play, state in zip(plays(named), named.values(), strict=True)
    )
    joints = enumerate_words(list(named))
    subject = f"joints {joints} are" if several else f"joint {joints} is"
    perhaps = "" if is_sure(result) else "probably "
    return f"{capital(perhaps + subject)} worn: radial clearance {said}."


def short(result: Answer) -> str:
    """Return the verdict in a word or two, for a title."""
    verdict = result.verdict
    if verdict == "in_order":
        return "in order"
    if verdict == "changed":
        causes = result.causes
        return f"changed: {causes[0].name}" if causes else "changed"
    if verdict == "unknown" or not (named := named_joints(result)):
        return "no verdict"
    return f"{'+'.join(named)} {'worn' if is_sure(result) else 'probably worn'}"


def probability(result: Answer) -> str:
    """Return how probable that is what the verdict says, of the least probable joint where it names several."""
    verdict = result.verdict
    if verdict == "in_order":
        return percent(sound(result))
    if verdict == "changed" and result.causes:
        return percent(result.causes[0].probability)
    if not (named := named_joints(result)):
        return "–"
    return percent(min(state.p_worn for state in named.values()))


def named_joints(result: Answer) -> dict[str, JointState]:
    """Return the joints that a verdict of wear names, with what is known of them; none for other verdicts.

    These are the joints that are worn for sure; where there are none, those of the most probable hypothesis of wear,
    with the clearance that they have then.
    """
    if result.verdict != "worn":
        return {}
    worn = {name: state for name, state in result.joints.items() if state.condition == "worn"}
    guessed = next((entry.joints for entry in result.hypotheses if entry.joints), {})
    return worn or {
        name: result.joints[name].model_copy(update={"bound": "none", **dict(found)}) for name, found in guessed.items()
    }


def is_sure(result: Answer) -> bool:
    """Return whether the joints that are named are worn for sure."""
    return any(state.condition == "worn" for state in result.joints.values())


def _untold(result: Answer) -> str:
    """How the sentence of a machine in order goes on: joints of which nothing can be told."""
    names = [name for name, state in result.joints.items() if state.condition == "open"]
    if not names:
        return ""
    return f"; joint{'s' if len(names) > 1 else ''} {enumerate_words(names)} cannot be told"


def _first_cause(result: Answer) -> str:
    """How the sentence of a change goes on."""
    causes = result.causes
    if not causes:
        return "; none of the known causes explains it"
    return f": {cause(causes[0])}, {probability(result)}"


def _no_verdict(result: Answer) -> str:
    """Why there is no verdict."""
    if flaws := sensor_sentences(result):
        return f"No verdict: {flaws[0]}"
    closest = f"; the closest is {result.hypotheses[0].label}" if result.hypotheses else ""
    p_value = result.goodness_of_fit.p_value
    return f"No verdict: the recording fits none of the hypotheses of this catalogue, p = {p_value:.2g}{closest}."


def joints_sentence(result: Answer) -> str:
    """Return what is said of every joint, in one line; empty where nothing is said of single joints."""
    rows = sorted(joint_rows(result), key=lambda row: row.name)
    parts = [f"{row.name}: worn, {row.play.say()}." for row in rows if row.condition == "worn"]
    states = result.joints
    in_order = [row.name for row in rows if row.condition == "in_order"]
    shown_from = {name: found for name in in_order if (found := states[name].detectable_from_um) is not None}
    unseen = [name for name in in_order if name not in shown_from]
    if shown_from:
        largest = length(max(shown_from.values()))
        parts.append(f"{', '.join(shown_from)}: in order; wear from {largest} on would have shown.")
    if unseen:
        parts.append(f"{', '.join(unseen)}: in order.")
    for row in rows:
        if row.condition == "open":
            low, high = states[row.name].interval_um
            parts.append(f"{row.name}: cannot be told ({between(low, high)}).")
    return " ".join(parts)


def limit_sentence(result: Answer) -> str:
    """Return which joints are or may be beyond their limit, and which worn ones are not; only for the verdict worn."""
    parts: list[str] = []
    if result.verdict != "worn":
        return ""
    for name, state in result.joints.items():
        limit, beyond = length(state.limit_um), state.p_over_limit
        if beyond >= CLEARLY:
            parts.append(f"{name} is beyond its limit of {limit}, probability {percent(beyond)}.")
        elif 1.0 - beyond < CLEARLY:
            parts.append(f"{name} may be beyond its limit of {limit}, probability {percent(beyond)}.")
        elif state.condition == "worn":
            parts.append(f"{name} is within its limit of {limit}, probability {percent(1.0 - beyond)}.")
    return " ".join(parts)


def cause(entry: Cause) -> str:
    """Return a cause other than play with its size: "mount 1 at 0.4 times its stiffness", "load, 150 N"."""
    name, unit, size = entry.name, entry.unit, f"{entry.size:.3g}".replace("-", "−")
    what = unit.removeprefix("x ")
    if what == unit:
        return f"{name}, {size} {unit}"
    name = name.removeprefix(f"{what} of ")
    return f"{name} at {size} times {'their' if name.startswith('all ') else 'its'} {what}"


def causes_sentence(result: Answer) -> str:
    """Return what else than play it may be, besides what the verdict's sentence says; empty where there is nothing."""
    changed = result.verdict == "changed"
    listed = [f"{cause(each)}, {percent(each.probability)}" for each in result.causes[1 if changed else 0 :]]
    if not listed:
        return ""
    return f"{'It may also be' if changed else 'Other than play, there may be a change'}: {'; or '.join(listed)}."


def sensor_sentences(result: Answer) -> list[str]:
    """Return what is wrong with sensors, each in a sentence."""
    return [f"{each.said.rstrip('.')}." for each in result.sensors]


def remarks(result: Answer) -> list[str]:
    """Return what is said right below the verdict, and not in it: limits of joints, other causes, sensors."""
    flaws = sensor_sentences(result)
    if result.verdict == "unknown":
        flaws = flaws[1:]
    return [said for said in (limit_sentence(result), causes_sentence(result), _reserve(result), *flaws) if said]


def _reserve(result: Answer) -> str:
    """How far a change lets joints be judged that are not in order."""
    doubted = [name for name, state in result.joints.items() if state.condition != "in_order"]
    if result.verdict != "changed" or not doubted:
        return ""
    joints = f"joint{'s' if len(doubted) > 1 else ''} {enumerate_words(doubted)}"
    return (
        f"Whether there is wear in {joints} as well is told with reserve: measure again when the change is put right."
    )


def sound(result: Answer) -> float:
    """Return the probability that no joint is worn."""
    return float(sum(entry.probability for entry in result.hypotheses if not entry.joints))


def set_sentence(result: Answer) -> str:
    """Return what the set of candidates says."""
    if result.verdict == "unknown":
        return "The probabilities compare these hypotheses with each other; none of them explains the recording."
    if result.verdict == "changed":
        return "The probabilities compare these hypotheses with each other; what has changed is none of them."
    coverage = percent(result.coverage)
    candidates = list(result.candidate_set)
    if not candidates:
        return f"No candidates: no hypothesis is in the set that holds the true cause in {coverage} of cases."
    if result.widened:
        return f"Candidates, from a set widened because the one for {coverage} was empty: {', '.join(candidates)}."
    return f"Candidates, which hold the true cause in {coverage} of cases: {', '.join(candidates)}."


def fit_sentence(result: Answer) -> str:
    """Return how well the best fitting of the candidates does."""
    p_value = result.goodness_of_fit.p_value
    return f"goodness of fit: p = {p_value:.2g}"


def mode_sentence(result: Answer) -> str:
    """Return how far the model of the machine was believed, and why."""
    mode = result.mode
    if mode.used == "trusted":
        return "The machine is taken to be as simulated (trusted)."
    reason = ""
    if mode.asked == "auto" and mode.trusted_p_value is not None:
        reason = f": as simulated it does not explain the recording, p = {mode.trusted_p_value:.2g}"
    return f"The machine is taken to differ from its model (robust){reason}."


def prior_sentence(result: Answer) -> str:
    """Return what was held likely before the recording."""
    prior = result.prior
    own = "".join(f"; {joint} {weight:g} times as likely" for joint, weight in prior.joints.items())
    shares = [f"{worn} with {100.0 * share:.0f} %" for worn, share in enumerate(prior.numbers, 1)]
    any_worn = f"wear with {100.0 * prior.worn:.0f} %"
    return f"Before the recording: {any_worn}, and then of joints at once {enumerate_words(shares)}{own}."


def enumerate_words(words: Sequence[str]) -> str:
    """Return words joined by commas and an "and"."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def capital(text: str) -> str:
    """Return a text with its first letter as a capital."""
    return text[:1].upper() + text[1:]


PATTERN = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d)")


def parse_moment(given: object) -> object:
    """Return what was given if it has the form; numbers of seconds and bare dates are refused."""
    if not isinstance(given, str) or not PATTERN.fullmatch(given):
        raise ValueError('must be a moment with a time zone, such as "2026-03-01T06:00:00Z"')
    return given


def in_utc(moment: datetime) -> datetime:
    """Return a moment in UTC; the first and last hours of the calendar have none."""
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise ValueError("is outside of the calendar") from None


def spell_moment(moment: datetime) -> str:
    """Return a moment of UTC, such as those that are stored, as a person reads it."""
    return f"{moment:%Y-%m-%d %H:%M}"


Moment = Annotated[AwareDatetime, BeforeValidator(parse_moment), AfterValidator(in_utc)]
