"""What the page shows of an asset's past: clearance over time by joint, the diagnoses, and what inspections found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from jointplay.app import words
from jointplay.app.rows import micrometres, plays
from jointplay.app.storage.asset_rows import FindingRow
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.words import spell_moment

PLACES = (0.12, 0.5, 0.3, 0.7, 0.88)
"""Where along the axis the text of a limit may stand."""

ROOM = (0.16, 0.05)
"""Half the width and the height of such a text beside the axes, on a narrow screen."""

FORESEEN_S = 60 * 86400.0
"""How far ahead a chart looks at least, where a limit is foretold [s]."""


def history(
    diagnoses: Sequence[DiagnosisRow],
    measurements: Mapping[str, MeasurementRow],
    made: Mapping[str, datetime],
    findings: Sequence[FindingRow],
) -> dict[str, Any]:
    """Return the members that an asset's page shows of its past.

    Parameters
    ----------
    diagnoses : sequence of DiagnosisRow
        Of the asset, what was asked last first.
    measurements, made : Mapping
        Their recordings by id, and when these were made.
    findings : sequence of FindingRow
        Of the asset, the newest first.

    Returns
    -------
    dict
        ``rows`` (what was measured last first) and ``findings`` of the tables, and ``chart``, None where there is
        nothing to draw.
    """
    return {
        "rows": [
            diagnosis_row(row, measurements, measured(row, made))
            for row in sorted(diagnoses, key=lambda row: measured(row, made), reverse=True)
        ],
        "findings": [finding_row(row) for row in findings],
        "chart": chart(diagnoses, made, findings) if diagnoses or findings else None,
    }


def diagnosis_row(row: DiagnosisRow, measurements: Mapping[str, MeasurementRow], at: datetime) -> dict[str, Any]:
    """Return the row of a diagnosis in the table."""
    result = row.answer
    name = measurements[row.measurement].name
    return {
        "id": row.id,
        "verdict": result.verdict,
        "short": words.short(result),
        "plays": plays(words.named_joints(result)),
        "percent": words.probability(result),
        "measured": spell_moment(at),
        "received": any(measurements[key].measured_at_source == "received" for key in row.measurements),
        "diagnosed": spell_moment(row.created_at),
        "measurement": row.measurement,
        "recording": words.recorded(result, name),
        "effort": result.effort,
    }


def finding_row(row: FindingRow) -> dict[str, Any]:
    """Return the row of a finding in the table."""
    found = []
    for name, joint in row.joints.items():
        said = [f"{micrometres(joint['clearance_um'])} µm"] if "clearance_um" in joint else []
        found.append(f"{name} {', '.join([*said, *(['repaired'] if joint.get('repaired') else [])])}")
    return {
        "at": spell_moment(row.at),
        "id": row.id,
        "diagnosis": row.diagnosis,
        "joints": "; ".join(found),
        "text": row.text,
    }


def latest(diagnoses: Sequence[DiagnosisRow]) -> list[DiagnosisRow]:
    """Return the last diagnosis of each recording, or of several together, of a list with the last first."""
    return list({row.measurements: row for row in reversed(diagnoses)}.values())


def measured(row: DiagnosisRow, made: Mapping[str, datetime]) -> datetime:
    """Return when the recording of a diagnosis was made, or the last of several."""
    return max(made[key] for key in row.measurements)


def chart(
    diagnoses: Sequence[DiagnosisRow], made: Mapping[str, datetime], findings: Sequence[FindingRow]
) -> dict[str, Any]:
    """Return the chart: its data for the script and its content in words for those who do not see it.

    A recording stands at the time when it was made, with its last diagnosis.
    """
    shown = sorted(latest(diagnoses), key=lambda row: measured(row, made))
    points: dict[str, list[dict[str, float]]] = {}
    order = sorted({name for row in shown for name in row.answer.joints})
    events: list[dict[str, Any]] = []
    for row in shown:
        at = measured(row, made).timestamp()
        worn = words.named_joints(row.answer)
        if not worn:
            events.append({"at": at, "kind": row.answer.verdict})
        for joint, found in worn.items():
            low, high = found.interval_um
            points.setdefault(joint, []).append({"at": at, "um": found.clearance_um, "low": low, "high": high})
    for finding in findings:
        event = {"at": finding.at.timestamp(), "kind": "finding"}
        events += [
            {**event, "joint": joint, "um": found["clearance_um"]}
            for joint, found in finding.joints.items()
            if "clearance_um" in found
        ] or [event]
    joints = sorted(points, key=order.index)
    return {
        "joints": [{"name": name, "look": order.index(name) % 6} for name in joints],
        "kinds": sorted({event["kind"] for event in events}),
        "summary": summary(joints, points, len(shown), len(findings)),
        "data": course(
            [{"name": name, "look": order.index(name) % 6, "points": points[name]} for name in joints], events
        ),
    }


def course(
    joints: Sequence[Mapping[str, Any]],
    events: Sequence[Mapping[str, Any]],
    limits: Sequence[Mapping[str, Any]] = (),
    reached: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Return what the script draws of clearances over time, with the ends of both axes.

    As far ahead as a limit is foretold, but no further than the past reaches back.

    Parameters
    ----------
    joints : sequence of mapping
        ``name``, ``look`` and ``points``: ``at`` [s], ``um``, ``low`` and ``high``.
    events : sequence of mapping
        ``at``, ``kind``, and where they have them ``joint`` and ``um``.
    limits : sequence of mapping
        ``um`` and ``text``; the time at which the text stands is found here.
    reached : sequence of mapping
        ``um`` of a limit, and ``at``: when it is reached at the earliest, likely, and at the latest.
    """
    points = [point for joint in joints for point in joint["points"]]
    times = [each["at"] for each in (*points, *events)]
    first, last = min(times), max(times)
    farthest = last + max(last - first, FORESEEN_S)
    late = [farthest if each["at"][2] is None else each["at"][2] for each in reached]
    end = min(farthest, max([last, *late]))
    margin = max(0.05 * (end - first), 1800.0)
    sizes = [point["high"] for point in points] + [each.get("um") or 0.0 for each in (*events, *limits)]
    ends, top = (first - margin, end + margin), 1.1 * max([1.0, *sizes])
    taken = [(point["at"], point["low"], point["high"]) for point in points]
    taken += [(each["at"], each["um"], each["um"]) for each in events if each.get("um") is not None]
    return {
        "label": "radial clearance, µm",
        "joints": joints,
        "events": events,
        "limits": with_places(limits, taken, ends, top),
        "reached": reached,
        "ends": list(ends),
        "top": top,
    }


def with_places(
    limits: Sequence[Mapping[str, Any]], taken: list[tuple[float, float, float]], ends: tuple[float, float], top: float
) -> list[dict[str, Any]]:
    """Return limits with ``at``: where their text is least in the way of what is drawn, and of each other.

    Parameters
    ----------
    limits : sequence of mapping
        ``um`` and ``text``.
    taken : list of tuple
        Time, lowest and highest clearance of what is drawn besides.
    ends : tuple of float
        Of the axis of time.
    top : float
        Of the axis of clearance [µm].
    """
    begin, span = ends[0], ends[1] - ends[0]
    found: list[dict[str, Any]] = []
    for limit in sorted(limits, key=lambda each: float(each["um"])):
        low, high = limit["um"] - ROOM[1] * top, limit["um"] + 2 * ROOM[1] * top
        near = [at for at, lowest, highest in taken if lowest < high and highest > low]
        places = [begin + share * span for share in PLACES]
        at = min(places, key=lambda place: sum(abs(place - each) < ROOM[0] * span for each in near))
        found.append({**limit, "at": at})
        taken = [*taken, (at, limit["um"], limit["um"] + ROOM[1] * top)]
    return found


def summary(joints: Sequence[str], points: Mapping[str, Sequence[Mapping[str, float]]], count: int, found: int) -> str:
    """Return a chart in words."""
    said = [
        f"{name} from {micrometres(points[name][0]['um'])} to {micrometres(points[name][-1]['um'])} µm"
        if len(points[name]) > 1
        else f"{name} once, {micrometres(points[name][0]['um'])} µm"
        for name in joints
    ]
    worn = f"Found worn: {'; '.join(said)}." if said else "No joint was found worn."
    shown = f"{count} recording{'s' * (count != 1)} and {found} finding{'s' * (found != 1)}"
    return f"Radial clearance over time, of {shown}. {worn} The tables below have the values."
