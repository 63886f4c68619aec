"""Places for labels: near what they name, away from everything else, and never over each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from jointplay.solver.arrays import FloatArray

Pixel: TypeAlias = tuple[float, float]

#: Width and height of a character as parts of the size of the letters, with a little air.
CHARACTER, LINE = 0.64, 1.15
_REACHES = (9.0, 15.0, 23.0, 34.0, 48.0)
_DIRECTIONS = 16
_AIR = 4.0
_ROUNDS = 3
_ON_THE_WAY = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Label:
    """What to write: the point that it names, the size of its letters, and how far from there they begin at least."""

    text: str
    at: Pixel
    size: float = 13.0
    clear: float = 0.0

    @property
    def half(self) -> Pixel:
        """Half of its width and height, pixels."""
        return max(len(self.text), 2) * CHARACTER * self.size / 2, LINE * self.size / 2


def place_labels(
    labels: Sequence[Label], segments: Sequence[tuple[Pixel, Pixel, float]], sheet: tuple[float, float, float, float]
) -> list[Pixel]:
    """Choose a place for each label.

    Parameters
    ----------
    labels : sequence of Label
    segments : sequence of (pixel, pixel, width)
        Lines that a label should not cross.
    sheet : (left, top, right, bottom)
        Labels stay inside where it costs them little.

    Returns
    -------
    list of pixels
        Middle of each text.
    """
    lines = np.array([(*a, *b, width) for a, b, width in segments]).reshape(-1, 5)
    options = [_options(label) for label in labels]
    costs = [_cost(label, places, lines, sheet) for label, places in zip(labels, options, strict=True)]
    halves = np.array([label.half for label in labels]).reshape(-1, 2)
    chosen: list[int] = []
    for _ in range(_ROUNDS):  # the first round sees those before it alone
        for index, (places, cost) in enumerate(zip(options, costs, strict=True)):
            others = [k for k in range(len(chosen)) if k != index]
            at = np.array([options[k][chosen[k]] for k in others]).reshape(-1, 2)
            room = halves[others] + halves[index] + _AIR
            over = room[None] - np.abs(places[:, None] - at[None])
            overlaps = np.where((over > 0).all(axis=2), 200 + over.min(axis=2), 0.0).sum(axis=1)
            own, theirs = np.array(labels[index].at), np.array([labels[k].at for k in others]).reshape(-1, 2)
            for part in _ON_THE_WAY:  # lines to what is named should not cross other texts
                there = own + part * (places - own)
                overlaps += 40 * (np.abs(there[:, None] - at[None]) < halves[others]).all(axis=2).sum(axis=1)
                crossed = np.abs(places[:, None] - (theirs + part * (at - theirs))[None]) < halves[index]
                overlaps += 40 * crossed.all(axis=2).sum(axis=1)
            best = int((cost + overlaps).argmin())
            chosen[index : index + 1] = [best]
    return [(float(x), float(y)) for x, y in (places[k] for places, k in zip(options, chosen, strict=True))]


def _options(label: Label) -> FloatArray:
    half_x, half_y = label.half
    angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    return np.array([
        (label.at[0] + math.cos(angle) * (reach + half_x), label.at[1] + math.sin(angle) * (reach + half_y))
        for reach in (label.clear + each for each in _REACHES)
        for angle in angles
    ])  # fmt: skip


def _cost(label: Label, places: FloatArray, lines: FloatArray, sheet: tuple[float, float, float, float]) -> FloatArray:
    """Sum what speaks against each place: leaving the sheet, crossing a line, being far away."""
    half = np.array(label.half)
    low, high = np.array(sheet[:2]), np.array(sheet[2:])
    outside = np.maximum(low - (places - half), 0) + np.maximum(places + half - high, 0)
    cost: FloatArray = 0.15 * np.linalg.norm(places - label.at, axis=1) + 0.2 * outside.sum(axis=1)
    if not len(lines):
        return cost
    parts = np.linspace(-1, 1, max(3, round(half[0] / 4)))
    points = places[:, None] + np.stack([parts * half[0], np.zeros(len(parts))], axis=1)  # on the middle of the text
    starts, ways = lines[:, :2], lines[:, 2:4] - lines[:, :2]
    lengths = np.maximum((ways**2).sum(axis=1), 1e-9)
    off = points[:, :, None] - starts
    along = np.clip((off * ways).sum(axis=3) / lengths, 0, 1)
    gaps = np.linalg.norm(off - along[..., None] * ways, axis=3).min(axis=1) - lines[:, 4] / 2
    cost += 0.6 * np.maximum(half[1] + 2 - gaps, 0).sum(axis=1)
    return cost


def distance_to_box(point: Pixel, middle: Pixel, half: Pixel) -> float:
    """How far a point is from a text, pixels."""
    return math.hypot(*(max(abs(point[k] - middle[k]) - half[k], 0.0) for k in (0, 1)))
