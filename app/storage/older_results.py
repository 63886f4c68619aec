"""Answers stored by versions before 2.3 of the interface, in the form that answers have now."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import parse_machine

PRIOR = {"another": 0.15, "joints": {}}
"""What answers before 2.1 held likely before a measurement."""

VERDICTS = {"fault": "worn", "healthy": "in_order"}
"""Verdicts of then by what they are called now."""

TAIL = NormalDist().inv_cdf(0.95)
"""Standard deviations from the middle of a central 90 % interval to its end."""


def in_present_form(result: Mapping[str, Any], machine: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stored answer in the present form; one that has it already as it is.

    What an older answer did not say is not made up: ``joints`` holds those that it found worn alone, none of them is
    known to have shown from some clearance on, and there are no causes and no flaws of sensors. `id` and `hash` stay.

    Parameters
    ----------
    result : Mapping
        As it was stored.
    machine : Mapping
        File of the machine that was diagnosed.
    """
    if "joint_probabilities" not in result:
        return dict(result)
    prior: Mapping[str, Any] = result.get("prior", PRIOR)
    result = {**result, "prior": {**_prior(result, prior), **prior}}
    if "joints" in result:
        return result
    verdict = VERDICTS.get(result["verdict"], result["verdict"])
    joints = worn_joints(result, machine) if verdict == "worn" else {}
    return {**result, "verdict": verdict, "joints": joints, "causes": [], "sensors": []}


def _prior(result: Mapping[str, Any], prior: Mapping[str, Any]) -> dict[str, Any]:
    """Return what weights of then meant, of which a machine in order had 1: probabilities of wear, and of its joints.

    Before 2.2 every set of joints had a weight of its own, then each number of them had as much as there are joints.
    """
    count = len(result["joint_probabilities"])
    most = max((len(entry["joints"]) for entry in result["hypotheses"]), default=0)
    weights = [
        (count if "numbers" in prior else math.comb(count, worn)) * prior["another"] ** (worn - 1)
        for worn in range(1, most + 1)
    ]
    return {"worn": sum(weights) / (1.0 + sum(weights)), "numbers": [weight / sum(weights) for weight in weights]}


def worn_joints(result: Mapping[str, Any], machine: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the joints of the most probable hypothesis of wear, as an answer says of single joints now."""
    worn: Mapping[str, Any] = next((entry["joints"] for entry in result["hypotheses"] if entry["joints"]), {})
    known = parse_machine(machine).joints if worn else {}
    found = {}
    for name, entry in worn.items():
        joint = known[name]
        assert isinstance(joint, TurningJoint)
        limit, probability = 1e6 * joint.worn_out_from, min(result["joint_probabilities"][name], 1.0)
        found[name] = {
            "condition": "worn" if probability >= result["coverage"] else "open",
            "p_worn": probability,
            "p_over_limit": probability * share_above(limit, entry),
            "limit_um": limit,
            "clearance_um": entry["clearance_um"],
            "interval_um": entry["interval_um"],
            "bound": "none",
            "detectable_from_um": None,
        }
    return found


def share_above(limit_um: float, entry: Mapping[str, Any]) -> float:
    """Return the probability that a clearance of this median and central 90 % interval is above a limit.

    Its logarithm is taken to be normal.
    """
    low, high = entry["interval_um"]
    scatter = math.log(high / low) / (2.0 * TAIL)
    away = math.log(entry["clearance_um"] / limit_um)
    return NormalDist().cdf(away / scatter) if scatter > 0.0 else float(away > 0.0)
