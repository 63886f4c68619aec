"""Sines of whole multiples of an angle, from its own sine and cosine: a product each in place of a series."""

from __future__ import annotations

import math

import casadi as ca


class Harmonics:
    """Sines and cosines of multiples of an angle.

    Parameters
    ----------
    angle : casadi.SX
        rad.
    """

    def __init__(self, angle: ca.SX) -> None:
        self._angle = angle
        self._known: dict[int, tuple[ca.SX, ca.SX]] = {}

    def wave(self, order: float, phase: float) -> tuple[ca.SX, ca.SX]:
        """Return sin(order angle + phase) and cos(order angle + phase)."""
        whole = round(order)
        if order != whole or whole < 1:
            turned = order * self._angle + phase
            return ca.sin(turned), ca.cos(turned)
        sine, cosine = self._multiple(whole)
        s, c = _exact(phase)
        return sine * c + cosine * s, cosine * c - sine * s

    def _multiple(self, order: int) -> tuple[ca.SX, ca.SX]:
        if order not in self._known:
            if order == 1:
                self._known[1] = (ca.sin(self._angle), ca.cos(self._angle))
            else:
                (s, c), (t, d) = self._multiple(order // 2), self._multiple(order - order // 2)
                self._known[order] = (s * d + c * t, c * d - s * t)
        return self._known[order]


def _exact(phase: float) -> tuple[float, float]:
    """Sine and cosine of a phase; of quarter turns without rounding, so that one of the products vanishes."""
    quarters = phase / (0.5 * math.pi)
    if quarters == round(quarters):
        return ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))[round(quarters) % 4]
    return math.sin(phase), math.cos(phase)
