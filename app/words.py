"""A diagnosis in words and numbers a person reads, the same on the terminal and on the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def sentence(result: Mapping[str, Any]) -> str:
    """Return the verdict in one sentence.

    Parameters
    ----------
    result : Mapping
        The members of a diagnosis.
    """
    ranking: Sequence[Mapping[str, Any]] = result["hypotheses"]
    verdict = result["verdict"]
    if verdict == "healthy":
        return f"No worn joint: the recording fits a machine without wear, probability {percent(sound(ranking))}."
    worn = next((entry for entry in ranking if entry["joints"]), None)
    if verdict == "unknown" or worn is None:
        closest = f"; the closest is {label(ranking[0])}" if ranking else ""
        return f"No verdict: the recording fits none of the hypotheses of this catalogue{closest}."
    joints = worn["joints"]
    named = enumerate_words(list(joints))
    several = len(joints) > 1
    found = "; ".join(clearance(entry, joint if several else "", "90 %: ") for joint, entry in joints.items())
    subject = f"Joints {named} are" if several else f"Joint {named} is"
    return f"{subject} worn: radial clearance {found}, probability {percent(worn['probability'])}."


def sound(ranking: Sequence[Mapping[str, Any]]) -> float:
    """Return the probability that no joint is worn."""
    return float(sum(entry["probability"] for entry in ranking if not entry["joints"]))


def label(entry: Mapping[str, Any]) -> str:
    """Return the short name of a hypothesis: its joints."""
    return str(entry["label"])


def clearance(entry: Mapping[str, Any], joint: str = "", interval: str = "") -> str:
    """Return a clearance with its interval, and what the interval is called."""
    prefix = f"{joint} " if joint else ""
    value, bounds = clearance_parts(entry)
    return f"{prefix}{value} ({interval}{bounds})"


def clearance_parts(entry: Mapping[str, Any]) -> tuple[str, str]:
    """Return a clearance and its interval."""
    low, high = entry["interval_um"]
    return f"{micrometres(entry['clearance_um'])} µm", f"{micrometres(low)} to {micrometres(high)}"


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


def enumerate_words(words: Sequence[str]) -> str:
    """Return words joined by commas and an "and"."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def short(result: Mapping[str, Any]) -> str:
    """Return the verdict in a word or two, for a title."""
    if result["verdict"] == "healthy":
        return "no wear"
    worn = next((entry for entry in result["hypotheses"] if entry["joints"]), None)
    if result["verdict"] == "unknown" or worn is None:
        return "no verdict"
    return f"{label(worn)} worn"
