"""Spectra with known answers, for tests of what is learned from catalogues.

Every joint raises the frame's band powers in a way of its own as its clearance grows; pairs add their powers; a draw
scatters by some decibels. Machines of the wide stratum scatter more.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.plans.entry import Hypothesis, Stratum
from jointplay.catalogue.storage.cross_power import COLUMNS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOW, HIGH = float(np.log(30e-6)), float(np.log(1e-3))
GROUPS = 16


class SpectraModel:
    """`count` draws of the healthy machine, of every single, and of pairs where asked for."""

    cuts = tuple(range(GROUPS + 1))
    edges = tuple(np.geomspace(0.5, 400.0, GROUPS + 1).tolist())
    nominal_speed = 2.0 * np.pi * 10.0
    joints = ("A", "B", "C")
    speeds = (1.0,)

    def __init__(self, count: int, *, pairs: bool = False, wide: int = 0, seed: int = 1) -> None:
        generator = np.random.default_rng(seed)
        worn = [(), *((joint,) for joint in self.joints)]
        worn += list(itertools.combinations(self.joints, 2)) if pairs else []
        self.hypotheses = tuple(Hypothesis.of(joints) for joints in worn)
        labels, strata, clearances, powers = [], [], [], []
        for known in self.hypotheses:
            for stratum, draws, scatter in (("trusted", count, 1.5), ("wide", wide, 4.0)):
                clearance = np.zeros((draws, len(self.joints)))
                for joint in known.joints:
                    clearance[:, self.joints.index(joint)] = np.exp(generator.uniform(LOW, HIGH, draws))
                labels += [known.label] * draws
                strata += [stratum] * draws
                clearances.append(clearance)
                powers.append(self.power(clearance, scatter, generator))
        self.label, self.stratum = np.array(labels), np.array(strata)
        self.clearances, self.powers = np.concatenate(clearances), np.concatenate(powers)
        self.id = f"model {count} {pairs} {wide} {seed}"

    def power(self, clearance: FloatArray, scatter: float, generator: np.random.Generator) -> FloatArray:
        """Packed spectra (n, G, 33), nothing locked to the crank, of machines with clearances (n, joints)."""
        level = np.full((len(clearance), GROUPS, 3), 1e-6)
        for j in range(len(self.joints)):
            shape = np.random.default_rng([5, j])
            offset, slope = shape.normal(-20.0, 8.0, (GROUPS, 3)), shape.normal(4.0, 2.0, (GROUPS, 3))
            growth = np.maximum(np.log(np.maximum(clearance[:, j], 1e-12)) - LOW, 0.0)
            worn = clearance[:, j] > 0.0
            level += worn[:, None, None] * 10.0 ** (0.1 * (offset + slope * growth[:, None, None]))
        packed = np.zeros((*level.shape[:2], COLUMNS))
        packed[..., :3] = level * 10.0 ** (0.1 * scatter * generator.normal(size=level.shape))
        return packed

    def rows(
        self, label: str, stratum: Stratum | None = None, *, draws: int | None = None, speed: float | None = None
    ) -> IntArray:
        """Rows of a hypothesis."""
        rows = np.flatnonzero((self.label == label) & ((stratum is None) | (self.stratum == stratum)))
        return rows if draws is None else rows[:draws]

    def nearest_speed(self, speed: float) -> float:
        """There is one."""
        return 1.0

    def individuals(self, rows: IntArray) -> IntArray:
        """Each is of a machine of its own."""
        return rows

    def in_order(self, rows: IntArray) -> IntArray:
        """None of them is there in order."""
        return np.full(len(rows), -1)

    def packed(self, rows: IntArray) -> FloatArray:
        """Spectra of rows."""
        chosen: FloatArray = self.powers[rows]
        return chosen

    def clearance(self, rows: IntArray) -> FloatArray:
        """Clearances of rows."""
        chosen: FloatArray = self.clearances[rows]
        return chosen


def sensing(noise: float = 1e-5) -> Sensing:
    """Look at all three motions with white noise of a density, for 5 s."""
    width = np.diff(SpectraModel.edges) * SpectraModel.nominal_speed / (2.0 * np.pi)
    power = noise * np.repeat(width[:, None], 3, axis=1)
    return Sensing(np.eye(3), np.eye(3), SpectraModel.cuts, power, np.maximum(2.0, 10.0 * width))


WATCHED = np.repeat(np.arange(GROUPS) < 4, 3)
