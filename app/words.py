"""A diagnosis in words and numbers a person reads, the same on the terminal, on the page and in a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

CONDITIONS = {"worn": "worn", "in_order": "in order", "open": "cannot be told"}
CLEARLY = 0.8
"""Probability from which on a joint is said to be beyond its limit, or within."""


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
    value, interval : str
        Radial clearance; no interval where the clearance is a bound.
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
    value: str
    interval: str
    limit: str
    beyond: str
    shows: str

    @property
    def clearance(self) -> str:
        """The clearance with its interval."""
        return f"{self.value} ({self.interval})" if self.interval else self.value


def sentence(result: Mapping[str, Any]) -> str:
    """Return the verdict in one sentence.

    Parameters
    ----------
    result : Mapping
        The members of a diagnosis.
    """
    verdict = result["verdict"]
    if verdict == "in_order":
        none = "No worn joint" if sound(result) >= result["coverage"] else "Probably no worn joint"
        return f"{none}: the recording fits a machine in order, probability {probability(result)}{_untold(result)}."
    if verdict == "changed":
        return f"Changed, but not by play{_first_cause(result)}."
    if verdict == "unknown" or not (named := named_joints(result)):
        return _no_verdict(result)
    several = len(named) > 1
    sizes = [clearance(entry, joint if several else "", "90 %: ") for joint, entry in named.items()]
    sure = [f", probability {percent(entry['p_worn'])}" for entry in named.values() if "p_worn" in entry]
    # Where nothing was said of single joints the probability is that of all of them together.
    sure = sure or [""] * (len(sizes) - 1) + [f", probability {probability(result)}"]
    said = "; ".join(size + each for size, each in zip(sizes, sure, strict=True))
    joints = enumerate_words(list(named))
    subject = f"joints {joints} are" if several else f"joint {joints} is"
    perhaps = "" if is_sure(result) else "probably "
    return f"{capital(perhaps + subject)} worn: radial clearance {said}."


def short(result: Mapping[str, Any]) -> str:
    """Return the verdict in a word or two, for a title."""
    verdict = result["verdict"]
    if verdict == "in_order":
        return "in order"
    if verdict == "changed":
        causes = result["causes"]
        return f"changed: {causes[0]['name']}" if causes else "changed"
    if verdict == "unknown" or not (named := named_joints(result)):
        return "no verdict"
    return f"{'+'.join(named)} {'worn' if is_sure(result) else 'probably worn'}"


def probability(result: Mapping[str, Any]) -> str:
    """Return how probable that is what the verdict says, of the least probable joint where it names several."""
    verdict = result["verdict"]
    if verdict == "in_order":
        return percent(sound(result))
    if verdict == "changed" and result["causes"]:
        return percent(result["causes"][0]["probability"])
    if not (named := named_joints(result)):
        return "–"
    return percent(min(entry.get("p_worn", _first_worn(result)["probability"]) for entry in named.values()))


def named_joints(result: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the joints that a verdict of wear names, with what is known of their clearance; none for other verdicts.

    These are the joints that are worn for sure; where there are none, those of the most probable hypothesis of wear,
    with the clearance that they have then.
    """
    if result["verdict"] != "worn":
        return {}
    joints: Mapping[str, Mapping[str, Any]] = result["joints"]
    worn = {name: state for name, state in joints.items() if state["condition"] == "worn"}
    guessed = _first_worn(result)["joints"].items()
    return worn or {name: {**joints.get(name, {}), "bound": "none", **entry} for name, entry in guessed}


def is_sure(result: Mapping[str, Any]) -> bool:
    """Return whether the joints that are named are worn for sure, or nothing was said of single joints."""
    states = result["joints"].values()
    return not states or any(state["condition"] == "worn" for state in states)


def _first_worn(result: Mapping[str, Any]) -> Mapping[str, Any]:
    """The most probable hypothesis of wear; one without joints where there is none."""
    nothing: Mapping[str, Any] = {"joints": {}, "probability": 0.0}
    return next((entry for entry in result["hypotheses"] if entry["joints"]), nothing)


def _untold(result: Mapping[str, Any]) -> str:
    """How the sentence of a machine in order goes on: joints of which nothing can be told."""
    names = [name for name, state in result["joints"].items() if state["condition"] == "open"]
    if not names:
        return ""
    return f"; joint{'s' if len(names) > 1 else ''} {enumerate_words(names)} cannot be told"


def _first_cause(result: Mapping[str, Any]) -> str:
    """How the sentence of a change goes on."""
    causes = result["causes"]
    if not causes:
        return "; none of the known causes explains it"
    return f": {cause(causes[0])}, {probability(result)}"


def _no_verdict(result: Mapping[str, Any]) -> str:
    """Why there is no verdict."""
    if flaws := sensor_sentences(result):
        return f"No verdict: {flaws[0]}"
    ranking: Sequence[Mapping[str, Any]] = result["hypotheses"]
    closest = f"; the closest is {label(ranking[0])}" if ranking else ""
    p_value = result["goodness_of_fit"]["p_value"]
    return f"No verdict: the recording fits none of the hypotheses of this catalogue, p = {p_value:.2g}{closest}."


def joint_rows(result: Mapping[str, Any]) -> list[JointRow]:
    """Return what is said of every joint, the most probably worn first; nothing for the verdict unknown."""
    joints: Mapping[str, Mapping[str, Any]] = {} if result["verdict"] == "unknown" else result["joints"]
    return [
        JointRow(
            name,
            state["condition"],
            CONDITIONS[state["condition"]],
            state["p_worn"],
            percent(state["p_worn"]),
            *clearance_parts(state),
            length(state["limit_um"]),
            percent(state["p_over_limit"]),
            "" if state["detectable_from_um"] is None else length(state["detectable_from_um"]),
        )
        for name, state in sorted(joints.items(), key=lambda item: -item[1]["p_worn"])
    ]


def joints_sentence(result: Mapping[str, Any]) -> str:
    """Return what is said of every joint, in one line; empty where nothing is said of single joints."""
    rows = sorted(joint_rows(result), key=lambda row: row.name)
    parts = [f"{row.name}: worn, {row.clearance}." for row in rows if row.condition == "worn"]
    states = result["joints"]
    in_order = [row.name for row in rows if row.condition == "in_order"]
    seen = [name for name in in_order if states[name]["detectable_from_um"] is not None]
    unseen = [name for name in in_order if name not in seen]
    if seen:
        largest = length(max(states[name]["detectable_from_um"] for name in seen))
        parts.append(f"{', '.join(seen)}: in order; wear from {largest} on would have shown.")
    if unseen:
        parts.append(f"{', '.join(unseen)}: in order.")
    for row in rows:
        if row.condition == "open":
            low, high = states[row.name]["interval_um"]
            parts.append(f"{row.name}: cannot be told ({between(low, high)}).")
    return " ".join(parts)


def limit_sentence(result: Mapping[str, Any]) -> str:
    """Return which joints are or may be beyond their limit, and which worn ones are not; only for the verdict worn."""
    parts: list[str] = []
    if result["verdict"] != "worn":
        return ""
    for name, state in result["joints"].items():
        limit, beyond = length(state["limit_um"]), state["p_over_limit"]
        if beyond >= CLEARLY:
            parts.append(f"{name} is beyond its limit of {limit}, probability {percent(beyond)}.")
        elif 1.0 - beyond < CLEARLY:
            parts.append(f"{name} may be beyond its limit of {limit}, probability {percent(beyond)}.")
        elif state["condition"] == "worn":
            parts.append(f"{name} is within its limit of {limit}, probability {percent(1.0 - beyond)}.")
    return " ".join(parts)


def cause(entry: Mapping[str, Any]) -> str:
    """Return a cause other than play with its size: "mount 1 at 0.4 times its stiffness", "load, 150 N"."""
    name, unit, size = str(entry["name"]), str(entry["unit"]), f"{entry['size']:.3g}".replace("-", "−")
    what = unit.removeprefix("x ")
    if what == unit:
        return f"{name}, {size} {unit}"
    name = name.removeprefix(f"{what} of ")
    return f"{name} at {size} times {'their' if name.startswith('all ') else 'its'} {what}"


def causes_sentence(result: Mapping[str, Any]) -> str:
    """Return what else than play it may be, besides what the verdict's sentence says; empty where there is nothing."""
    changed = result["verdict"] == "changed"
    listed = [f"{cause(each)}, {percent(each['probability'])}" for each in result["causes"][1 if changed else 0 :]]
    if not listed:
        return ""
    return f"{'It may also be' if changed else 'Other than play, there may be a change'}: {'; or '.join(listed)}."


def sensor_sentences(result: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with sensors, each in a sentence."""
    return [f"{str(each['said']).rstrip('.')}." for each in result["sensors"]]


def remarks(result: Mapping[str, Any]) -> list[str]:
    """Return what is said right below the verdict, and not in it: limits of joints, other causes, sensors."""
    flaws = sensor_sentences(result)
    if result["verdict"] == "unknown":
        flaws = flaws[1:]
    return [said for said in (limit_sentence(result), causes_sentence(result), _reserve(result), *flaws) if said]


def _reserve(result: Mapping[str, Any]) -> str:
    """How far a change lets joints be judged that are not in order."""
    doubted = [name for name, state in result["joints"].items() if state["condition"] != "in_order"]
    if result["verdict"] != "changed" or not doubted:
        return ""
    joints = f"joint{'s' if len(doubted) > 1 else ''} {enumerate_words(doubted)}"
    return (
        f"Whether there is wear in {joints} as well is told with reserve: measure again when the change is put right."
    )


def sound(result: Mapping[str, Any]) -> float:
    """Return the probability that no joint is worn."""
    return float(sum(entry["probability"] for entry in result["hypotheses"] if not entry["joints"]))


def label(entry: Mapping[str, Any]) -> str:
    """Return the short name of a hypothesis: its joints."""
    return str(entry["label"])


def clearance(entry: Mapping[str, Any], joint: str = "", interval: str = "") -> str:
    """Return a clearance with its interval, and what the interval is called."""
    prefix = f"{joint} " if joint else ""
    value, bounds = clearance_parts(entry)
    return f"{prefix}{value} ({interval}{bounds})" if bounds else f"{prefix}{value}"


def clearance_parts(entry: Mapping[str, Any]) -> tuple[str, str]:
    """Return a clearance and its interval; of one that is a bound, the bound and nothing."""
    low, high = entry["interval_um"]
    bound = entry.get("bound", "none")
    if bound != "none":
        return (f"at least {length(low)}" if bound == "at_least" else f"at most {length(high)}"), ""
    scale, unit = _unit(high)
    return f"{scaled(entry['clearance_um'], scale)} {unit}", f"{scaled(low, scale)} to {scaled(high, scale)}"


def between(low: float, high: float) -> str:
    """Return an interval of clearances with its unit."""
    scale, unit = _unit(high)
    return f"{scaled(low, scale)} to {scaled(high, scale)} {unit}"


def length(value: float) -> str:
    """Return a clearance [µm] with its unit, mm from 1 mm on."""
    scale, unit = _unit(value)
    return f"{scaled(value, scale)} {unit}"


def _unit(largest: float) -> tuple[float, str]:
    return (1e-3, "mm") if largest >= 999.5 else (1.0, "µm")


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


def set_sentence(result: Mapping[str, Any]) -> str:
    """Return what the set of candidates says."""
    if result["verdict"] == "unknown":
        return "The probabilities compare these hypotheses with each other; none of them explains the recording."
    if result["verdict"] == "changed":
        return "The probabilities compare these hypotheses with each other; what has changed is none of them."
    coverage = percent(result["coverage"])
    candidates = list(result["candidate_set"])
    if not candidates:
        return f"No candidates: no hypothesis is in the set that holds the true cause in {coverage} of cases."
    if result.get("widened"):
        return f"Candidates, from a set widened because the one for {coverage} was empty: {', '.join(candidates)}."
    return f"Candidates, which hold the true cause in {coverage} of cases: {', '.join(candidates)}."


def fit_sentence(result: Mapping[str, Any]) -> str:
    """Return how well the best hypothesis fits."""
    p_value = result["goodness_of_fit"]["p_value"]
    return f"goodness of fit: p = {p_value:.2g}"


def mode_sentence(result: Mapping[str, Any]) -> str:
    """Return how far the model of the machine was believed, and why."""
    mode = result["mode"]
    if mode["used"] == "trusted":
        return "The machine is taken to be as simulated (trusted)."
    reason = ""
    if mode["asked"] == "auto":
        reason = f": as simulated it does not explain the recording, p = {mode['trusted_p_value']:.2g}"
    return f"The machine is taken to differ from its model (robust){reason}."


def prior_sentence(result: Mapping[str, Any]) -> str:
    """Return what was held likely before the recording."""
    prior = result["prior"]
    own = "".join(f"; {joint} {weight:g} times as likely" for joint, weight in prior["joints"].items())
    shares = [f"{worn} with {100.0 * share:.0f} %" for worn, share in enumerate(prior["numbers"], 1)]
    any_worn = f"wear with {100.0 * prior['worn']:.0f} %"
    return f"Before the recording: {any_worn}, and then of joints at once {enumerate_words(shares)}{own}."


def enumerate_words(words: Sequence[str]) -> str:
    """Return words joined by commas and an "and"."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def capital(text: str) -> str:
    """Return a text with its first letter as a capital."""
    return text[:1].upper() + text[1:]
