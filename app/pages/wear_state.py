"""What the page of an asset says of its wear: the state after its last recording, and its course for the chart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jointplay.app.pages.history import course
from jointplay.app.pages.standing import day
from jointplay.app.rows import between, length, micrometres, percent
from jointplay.app.storage.asset_rows import FindingRow
from jointplay.app.words import spell_moment
from jointplay.catalogue.following.state import JointFollowed, WearState

WORN = 0.5
"""Probability from which on a clearance is that of wear, and is drawn."""

MOVED = 0.05
"""Change of a probability of wear, by the last recording, from which on it is told."""

SHOWN = 6
"""Causes and repairs that a report tells."""

LOOKS = 6
"""Looks of joints in charts."""


def show_state(state: WearState, findings: Sequence[FindingRow] = ()) -> dict[str, Any]:
    """Return what a template shows of a state of wear, and of what inspections found meanwhile."""
    joints = sorted(state.joints.items(), key=lambda item: (-item[1].p_over_limit, -item[1].p_worn))
    return {
        "at": spell_moment(state.at),
        "visits": state.visits,
        "joints": [joint_row(name, found) for name, found in joints],
        "moved": what_moved(state),
        "besides": what_besides(state),
        "chart": chart(state, findings),
    }


def what_moved(state: WearState) -> str:
    """Return in words what the last recording has changed, of which joints are worn."""
    told = [
        f"{name} from {percent(found.course[-1].p_worn - found.moved_by)} to {percent(found.course[-1].p_worn)}"
        for name, found in state.joints.items()
        if abs(found.moved_by) >= MOVED
    ]
    if not told:
        return "The last recording has changed little of which joints are worn."
    return f"The last recording has moved the probability of wear of {'; '.join(told)}."


def what_besides(state: WearState) -> list[str]:
    """Return in words which causes other than play there are, and what was repaired."""
    told = []
    for name, cause in state.causes.items():
        if cause.probability >= WORN:
            moves = f" ({cause.per_year:+.2g} a year)" if cause.per_year else ""
            since = f", since {day(cause.since)}" if cause.since else ""
            told.append(f"Besides: {name}, {cause.size:.3g} {cause.unit}{moves}, {percent(cause.probability)}{since}.")
    for repair in state.repairs:
        at = f"by {day(repair.at)}, {percent(repair.probability)}" if not repair.is_told else f"on {day(repair.at)}"
        told.append(f"Joint {repair.joint} was repaired {at}.")
    return told


def past_words(state: WearState) -> tuple[str, ...]:
    """Return in words, for a report, what the answers to all recordings up to one say of an asset."""
    likeliest = max(state.joints, key=lambda name: state.joints[name].p_worn)
    worn = {name: found for name, found in state.joints.items() if found.p_worn >= WORN}
    said = [joint_words(name, found) for name, found in worn.items()] or [
        f"No joint is likelier worn than not; the likeliest is {likeliest}, {percent(state.joints[likeliest].p_worn)}."
    ]
    besides = what_besides(state)
    more = [f"{len(besides) - SHOWN} more before, in the state of the asset."] if len(besides) > SHOWN else []
    by = f"The verdict above is by its recording; this is by all {state.visits} answers up to it."
    return (by, *said, what_moved(state), *more, *besides[-SHOWN:])


def joint_words(name: str, found: JointFollowed) -> str:
    """Return what is known of a worn joint in a sentence."""
    early, likely, late = found.limit_at
    limit = f"its limit of {length(found.limit_um)}"
    if found.p_over_limit >= WORN:
        reached = f"it is beyond {limit}"
    elif early is None:
        reached = f"{limit} is not foreseen to be reached"
    else:
        reached = f"it reaches {limit} {f'between {day(early)} and {day(late)}' if late else f'from {day(early)} on'}"
        reached += f", likely {day(likely)}" if likely else ""
    sure = f", sure since {day(found.first_sure_at)}" if found.first_sure_at else ""
    return (
        f"Joint {name} is worn, {percent(found.p_worn)}{sure}: {length(found.clearance_um)}"
        f" ({between(*found.interval_um)}), growing by {micrometres(found.um_per_year)} µm a year; {reached}."
    )


def joint_row(name: str, found: JointFollowed) -> dict[str, Any]:
    """Return the row of a joint in the table."""
    early, likely, late = found.limit_at
    worn, beyond = found.p_worn >= WORN, found.p_over_limit >= WORN
    reached = "now" if beyond else f"{day(early)} to {day(late) or 'not within a century'}" if early else "not foreseen"
    return {
        "name": name,
        "condition": "worn" if worn else "in_order",
        "said": "worn" if worn else "in order",
        "percent": percent(found.p_worn),
        "clearance": length(found.clearance_um),
        "interval": between(*found.interval_um),
        "rate": f"{micrometres(found.um_per_year)} µm a year" if worn else "–",
        "limit": length(found.limit_um),
        "reached": reached if worn else "–",
        "likely": day(likely) if likely and worn and not beyond else "",
        "sure": day(found.first_sure_at),
    }


def chart(state: WearState, findings: Sequence[FindingRow]) -> dict[str, Any] | None:
    """Return the course of worn joints, their limits and findings for the script, and in words; None of no wear."""
    order = list(state.joints)
    points = {
        name: [
            {
                "at": point.at.timestamp(),
                "um": point.clearance_um,
                "low": point.interval_um[0],
                "high": point.interval_um[1],
            }
            for point in found.course
            if point.p_worn >= WORN
        ]
        for name, found in state.joints.items()
    }
    drawn = [name for name in order if points[name]]
    if not drawn:
        return None
    looks = [{"name": name, "look": order.index(name) % LOOKS} for name in drawn]
    said = [f"{name} {micrometres(points[name][-1]['um'])} µm" for name in drawn]
    events: list[dict[str, Any]] = [
        {"at": repair.at.timestamp(), "kind": "repair", "joint": repair.joint} for repair in state.repairs
    ]
    events += [
        {"at": finding.at.timestamp(), "kind": "finding", "joint": name, "um": found["clearance_um"]}
        for finding in findings
        for name, found in finding.joints.items()
        if "clearance_um" in found
    ]
    limits: dict[float, list[str]] = {}
    for name in drawn:
        limits.setdefault(state.joints[name].limit_um, []).append(name)
    reached = [
        {**look, "um": found.limit_um, "at": [None if at is None else at.timestamp() for at in found.limit_at]}
        for look in looks
        for found in [state.joints[str(look["name"])]]
        if found.p_worn >= WORN and found.limit_at[0] is not None
    ]
    return {
        "joints": looks,
        "kinds": sorted({event["kind"] for event in events} | ({"limit"} if reached else set())),
        "summary": f"Radial clearance by all recordings up to each. Last: {', '.join(said)}. The table has the values.",
        "data": course(
            [{**look, "points": points[str(look["name"])]} for look in looks],
            events,
            [{"um": um, "text": f"limit {', '.join(names)}"} for um, names in limits.items()],
            reached,
        ),
    }
