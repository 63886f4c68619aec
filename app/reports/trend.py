"""The past of an asset in its report: clearance over time by joint, as an SVG of plain colours and attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from jointplay.app.reports.figures import INK, SOFT, Scale, label, line

WIDTH, HEIGHT = 360.0, 170.0
LEFT, RIGHT, TOP, BOTTOM = 38.0, 12.0, 24.0, 24.0
COLOURS = ("#1297d9", "#a37a29", "#5412d9", "#0b8484", "#41085e", "#522914")
SIGNS = {"repair": "↺", "finding": "◆"}
SAID = "By all recordings up to each, with 90 % intervals.   ↺ repaired   ◆ found by an inspection"
STEPS_UM = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
DATES = 4
MOST_POINTS = 100
"""Of a joint, the last so many: more are drawn one over the other."""


def trend_svg(data: Mapping[str, Any]) -> str:
    """Return clearances with their 90 % intervals over time, repairs and findings, and limits of wear.

    Parameters
    ----------
    data : Mapping
        ``joints``, ``events`` and ``limits`` as the chart of the state of wear on the asset's page has them.
    """
    joints, events = [{**joint, "points": joint["points"][-MOST_POINTS:]} for joint in data["joints"]], data["events"]
    marked = [point for joint in joints for point in joint["points"]]
    times = [point["at"] for point in marked] + [event["at"] for event in events]
    limits = [limit["um"] for limit in data["limits"]]
    highs = [point["high"] for point in marked] + [event.get("um") or 0.0 for event in events]
    top = 1.1 * max([1.0, *highs, *limits])
    across = Scale(min(times), max(times), LEFT + 14, WIDTH - RIGHT - 14)
    up = Scale(0.0, top, HEIGHT - BOTTOM, TOP)
    parts = [*_grid(across, up, top, min(times), max(times)), label(LEFT, 11, "radial clearance, µm", INK, "start", 10)]
    for limit in limits:
        y = up(limit)
        parts.append(
            f'<line x1="{LEFT:.1f}" y1="{y:.1f}" x2="{WIDTH - RIGHT:.1f}" y2="{y:.1f}" stroke="{INK}"'
            ' stroke-width="0.8" stroke-dasharray="5 3"/>'
        )
        parts.append(label(LEFT + 2, y - 3, "limit", INK, "start"))
    for joint in joints:
        parts += _course(joint["points"], COLOURS[joint["look"]], across, up)
    place = LEFT + 110
    for joint in joints:
        parts.append(label(place, 11, f"● {joint['name']}", COLOURS[joint["look"]], "start", 10))
        place += 26 + 6 * len(joint["name"])
    for event in events:
        text = SIGNS[event["kind"]] + (f" {event['joint']}" if event.get("joint") else "")
        parts.append(label(across(event["at"]), up(event.get("um") or 0.0) - 3, text, INK, "middle", 10))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" '
        'font-family="system-ui, sans-serif" font-size="9"><title>Radial clearance over time</title>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def _course(points: Sequence[Mapping[str, float]], colour: str, across: Scale, up: Scale) -> list[str]:
    """One joint: a line through its clearances, each with the bar of its interval."""
    at = [(across(point["at"]), up(point["um"])) for point in points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in at)
    parts = [f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.2"/>'] if len(at) > 1 else []
    for (x, y), point in zip(at, points, strict=True):
        low, high = up(point["low"]), up(point["high"])
        parts.append(
            f'<path d="M{x:.1f} {low:.1f} V{high:.1f} M{x - 3:.1f} {low:.1f} h6 M{x - 3:.1f} {high:.1f} h6"'
            f' fill="none" stroke="{colour}" stroke-width="1"/>'
        )
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{colour}"/>')
    return parts


def _grid(across: Scale, up: Scale, top: float, first: float, last: float) -> list[str]:
    """Lines and numbers of both axes."""
    step = next((each for each in STEPS_UM if top / each <= 5), STEPS_UM[-1])
    parts = []
    for level in range(0, int(top) + 1, step):
        parts += [
            line(LEFT, up(level), WIDTH - RIGHT, up(level)),
            label(LEFT - 4, up(level) + 3, str(level), SOFT, "end"),
        ]
    days: dict[str, float] = {}
    for index in range(DATES):
        at = first + (last - first) * index / (DATES - 1)
        days.setdefault(f"{datetime.fromtimestamp(at, UTC):%Y-%m-%d}", at)
    for day, at in days.items():
        parts.append(label(across(at), HEIGHT - BOTTOM + 12, day, SOFT, "middle"))
    return parts
