"""Where a drawing's labels go: near what they name, away from everything else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

__all__ = ["place_labels"]

Pixel: TypeAlias = tuple[float, float]
Segment: TypeAlias = tuple[Pixel, Pixel]

CHARACTER = 8.0
"""Mean width of a character of 13 pixels, with a little air."""

HEIGHT = 14.0


def place_labels(
    labels: Sequence[tuple[str, Pixel]],
    segments: Sequence[Segment],
    blocked: Sequence[tuple[Pixel, float]],
    sheet: Pixel,
) -> list[Pixel]:
    """Choose a place for each label, one after the other.

    Parameters
    ----------
    labels : sequence of (text, pixel)
        What to write, and the point that it names.
    segments : sequence of pairs of pixels
        Lines that a label should not cross.
    blocked : sequence of (pixel, radius)
        Marks that a label should not cover.
    sheet : (width, height)
        Labels stay inside.

    Returns
    -------
    list of pixels
        Middle of each text's base line.
    """
    taken: list[tuple[Pixel, float]] = []
    places = []
    for text, at in labels:
        half = max(len(text), 2) * CHARACTER / 2
        candidates = [
            (at[0] + math.cos(angle) * (reach + half), at[1] + math.sin(angle) * (reach + HEIGHT / 2))
            for reach in (8.0, 14.0, 24.0)
            for angle in (step * math.pi / 6 for step in range(12))
        ]
        best = min(candidates, key=lambda middle: _cost(middle, half, at, segments, blocked, taken, sheet))
        taken.append((best, half))
        places.append((best[0], best[1] + HEIGHT / 3))
    return places


def _cost(
    middle: Pixel,
    half: float,
    at: Pixel,
    segments: Sequence[Segment],
    blocked: Sequence[tuple[Pixel, float]],
    taken: Sequence[tuple[Pixel, float]],
    sheet: Pixel,
) -> float:
    """Sum what speaks against a place: overlaps count most, then crossing a line, then being far away."""
    x, y = middle
    cost = 0.02 * math.dist(middle, at)
    outside = max(half - x, x + half - sheet[0], HEIGHT / 2 - y, y + HEIGHT / 2 - sheet[1], 0.0)
    cost += 10 * outside
    for (other_x, other_y), other_half in taken:
        over_x, over_y = half + other_half - abs(x - other_x), HEIGHT - abs(y - other_y)
        if over_x > 0 and over_y > 0:
            cost += 20 + min(over_x, over_y)
    for (mark_x, mark_y), radius in blocked:
        gap = math.hypot(max(abs(x - mark_x) - half, 0.0), max(abs(y - mark_y) - HEIGHT / 2, 0.0))
        cost += max(radius - gap, 0.0)
    for a, b in segments:
        gap = min(_distance((x + part * half, y), a, b) for part in (-1.0, -0.5, 0.0, 0.5, 1.0))
        cost += 0.5 * max(HEIGHT - gap, 0.0)
    return cost


def _distance(point: Pixel, a: Pixel, b: Pixel) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    part = 0.0 if length == 0 else ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / length
    part = min(max(part, 0.0), 1.0)
    return math.dist(point, (a[0] + part * dx, a[1] + part * dy))
