"""A diagnosis in words, numbers and moments a person reads, the same on the terminal, on the page and in a report.

In requests, moments are RFC 3339 with a time zone, and nothing that merely resembles it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, AwareDatetime, BeforeValidator

from jointplay.app.rows import between, has_decided, length, percent, plays
from jointplay.catalogue.matching.modes import UNKNOWN_BELOW

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Answer, Cause, JointState

CLEARLY = 0.8
"""Probability from which on a joint is said to be beyond its limit, or within."""

SEEN = 0.95
"""Probability that wear from `detectable_from_um` on would have shown."""


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
        return f"Changed, {_by_what(result)}."
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


def _by_what(result: Answer) -> str:
    """How the sentence of a change goes on."""
    if result.causes:
        return f"but not by play: {cause(result.causes[0])}, {probability(result)}"
    perhaps = f"perhaps by play, {percent(1.0 - sound(result))}" if may_be_worn(result) else "but not by play"
    return f"{perhaps}; none of the known causes explains it"


def may_be_worn(result: Answer) -> bool:
    """Return whether wear that is not sure enough for a verdict may be what has changed."""
    return result.verdict == "changed" and not result.causes and sound(result) < 0.5


def is_explained(result: Answer) -> bool:
    """Return whether some hypothesis explains the recording."""
    return result.goodness_of_fit.p_value >= UNKNOWN_BELOW and bool(result.candidate_set)


def _no_verdict(result: Answer) -> str:
    """Why there is no verdict."""
    if flaws := sensor_sentences(result):
        return f"No verdict: {flaws[0]}"
    if is_explained(result):
        worn = percent(1.0 - sound(result))
        return (
            f"No verdict: the machine is not as its file says, and neither wear ({worn}) nor none is sure enough then."
        )
    p_value = result.goodness_of_fit.p_value
    return f"No verdict: the recording fits none of the hypotheses of this catalogue, p = {p_value:.2g}."


def seen_sentence(result: Answer) -> str:
    """Return above which clearances there is no wear, and of which joints nothing can be said.

    The same on every verdict: what such a recording would have shown with a probability of `SEEN`, joint by joint.
    """
    if result.verdict == "unknown":
        return "Nothing is said of any joint: wear of any size may be behind such a recording."
    named = named_joints(result)
    sound = {name: state.detectable_from_um for name, state in result.joints.items() if state.condition == "in_order"}
    shown = {name: found for name, found in sound.items() if found is not None}
    hidden = [name for name in sound if name not in shown]
    parts = [f"No wear above: {_lengths(shown)} ({percent(SEEN)})."] if shown else []
    if hidden:
        parts.append(f"Wear of {enumerate_words(hidden)} would not have shown, however large the catalogue has it.")
    parts += [
        f"{name}: cannot be told ({between(*state.interval_um)})."
        for name, state in result.joints.items()
        if state.condition == "open" and name not in named
    ]
    return " ".join(parts)


def _lengths(found: Mapping[str, float]) -> str:
    """Clearances [µm] of joints, with one unit where it is the same: "O 35, A 30, C 160 µm"."""
    said = [f"{name} {length(value)}" for name, value in found.items()]
    return ", ".join([*(each.removesuffix(" µm") for each in said[:-1]), said[-1]])


def next_step(result: Answer) -> str:
    """Return what to do next, in one line."""
    if apart := [share.measurement for share in result.recordings if share.contradicts]:
        step = f"diagnose {enumerate_words(apart)} apart from the others: the machine was not the same in all"
    elif result.verdict in ("unknown", "changed"):
        step = _after_no_wear(result)
    elif result.verdict == "worn":
        step = _after_wear(result)
    else:
        doubted = [name for name, state in result.joints.items() if state.condition == "open"]
        step = "measure again at the usual interval"
        if doubted or sound(result) < result.coverage:
            step = _apart(result) or f"measure again, longer or with more sensors{_to_tell(doubted)}"
    return f"Next: {step}."


def _after_no_wear(result: Answer) -> str:
    """What to do where nothing explains a recording, or something else than play: what may be wrong with it, first."""
    if result.sensors:
        names = dict.fromkeys(name for flaw in result.sensors for name in flaw.sensors)
        return f"check {enumerate_words(list(names))} (cable, direction, scale), and measure again"
    if doubts := [line for line in result.warnings if line.startswith("drive speed ")]:
        return f"check the drive speed, and that this is the machine of the catalogue: {doubts[-1]}"
    if result.verdict == "changed" and result.causes:
        return f"look at this: {result.causes[0].name}; put it right, or the machine's file, and measure again"
    compare = "" if result.baseline else "; compare with a recording of the machine in order as a baseline"
    if result.verdict == "changed":
        return f"look for what has changed: mounts, foundation, masses, load, drive{compare}"
    return f"check that catalogue, machine, sensors (places, directions, units) and speed belong together{compare}"


def _after_wear(result: Answer) -> str:
    """What to do where joints are worn."""
    named = named_joints(result)
    joints = f"joint{'s' if len(named) > 1 else ''} {enumerate_words(list(named))}"
    if not is_sure(result):
        return _apart(result) or f"measure again, longer or with more sensors, or look at {joints} at the next stop"
    if all(1.0 - state.p_over_limit >= CLEARLY for state in named.values()):
        return f"measure again soon, to see how fast {joints} wear{'' if len(named) > 1 else 's'}"
    return f"lock the drive out and measure the play of {joints} across the pin"


#: How each kind of suggestion is taken up.
SUGGESTED = {"sensor": "with sensor", "direction": "in direction", "speed": "at", "load": "under a process load of"}


def _apart(result: Answer) -> str:
    """What would tell the first hypotheses apart best; empty where nothing is suggested."""
    if not result.suggestions:
        return ""
    best = result.suggestions[0]
    return f"measure {SUGGESTED[best.kind]} {best.what} as well, to tell {' and '.join(best.hypotheses)} apart"


def _to_tell(joints: Sequence[str]) -> str:
    return f", to tell joint{'s' if len(joints) > 1 else ''} {enumerate_words(joints)}" if joints else ""


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
    """Return what is said right below the verdict, and not in it, each in a line.

    Limits of joints, other causes, sensors; above which clearance there is no wear; last of all, what to do next.
    """
    flaws = sensor_sentences(result)
    if result.verdict == "unknown":
        flaws = flaws[1:]
    told = (limit_sentence(result), causes_sentence(result), _since(result), _reserve(result), *flaws)
    told += (seen_sentence(result), next_step(result))
    return [said for said in told if said]


def _since(result: Answer) -> str:
    """How the machine is not as it was, where that is the verdict."""
    past = result.past
    if past is None or result.verdict != "changed" or not past.changed:
        return ""
    first = past.changed[0]
    low, high = round(first.low_order + 0.5), round(first.high_order - 0.5)
    band = f"order {low}" if low >= high else f"the band of orders {low} to {high}"
    size = f"{first.difference_db:+.1f} dB".replace("-", "−")
    return (
        f"Beside the baseline, {band} in {first.channel} is off by {size} (usually {first.usual_db:.2g} dB),"
        f" p = {past.p_value:.2g}."
    )


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
        why = "none of them is sure enough" if is_explained(result) else "none of them explains the recording"
        return f"The probabilities compare these hypotheses with each other; {why}."
    if result.verdict == "changed":
        return "The probabilities compare these hypotheses with each other; what has changed is none of them."
    coverage = percent(result.coverage)
    candidates = list(result.candidate_set)
    if not candidates:
        return f"No candidates: no hypothesis is in the set that holds the true cause in {coverage} of cases."
    if result.widened:
        return f"Candidates, from a set widened because the one for {coverage} was empty: {', '.join(candidates)}."
    return f"Candidates, which hold the true cause in {coverage} of cases: {', '.join(candidates)}."


def colour_sentence(result: Answer) -> str:
    """Return what the colours of joints mean in the drawing of an answer."""
    if has_decided(result):
        return "The deeper the colour of a joint, the more probable its wear."
    return "No joint is coloured: this is no verdict on joints."


def rings_sentence(result: Answer) -> str:
    """Return what rings in charts of levels mean; empty where nothing was decided."""
    first, second = result.hypotheses[:1], result.evidence.rival
    if not first or second is None or not has_decided(result):
        return ""
    return f"Rings: bands that decided for {first[0].label} and against {second}."


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


def placed(moment: datetime) -> datetime:
    """Return a moment at which something can have been measured."""
    from jointplay.catalogue.measurements.moments import place_moment

    return place_moment(moment, None)


Moment = Annotated[AwareDatetime, BeforeValidator(parse_moment), AfterValidator(in_utc)]
MeasuredAt = Annotated[Moment, AfterValidator(placed)]

SOURCES = {"sender": "as its sender says", "file": "as the file says", "received": "when it was received"}
"""Who says when a measurement was made."""
