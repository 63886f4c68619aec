"""What machines of a catalogue shake like, beside the spectrum of a recording: first, second, those in order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.sensors import MOTIONS, map_sensors
from jointplay.catalogue.signals.shown_motion import ShownLine, ShownSignal, motion_of
from jointplay.catalogue.signals.shown_units import UNITS
from jointplay.catalogue.signals.signal_question import LineKind, SignalQuestion
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import AnyComplexArray, FloatArray, IntArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.spectrum import DERIVATIVES, scale_power, value_units

#: Entries of which the median is shown: one alone has the contact of its own draw.
ALIKE = 9
IN_ORDER = "healthy"
"""Label of the machines in order: no joint is worn, every one has the play of a new fit."""


@dataclass(frozen=True)
class ShownHypothesis:
    """A machine of the catalogue that is laid over a recording.

    Parameters
    ----------
    kind : {"first", "second", "in_order"}
    label : str
        Of its hypothesis.
    clearances : mapping of joint to float
        Radial, m: of the entries nearest to them the median is shown; where there are none, that of all.
    """

    kind: LineKind
    label: str
    clearances: Mapping[str, float]


def show_matched(
    recording: Recording,
    question: SignalQuestion,
    machine: Machine,
    mapping: Mapping[str, str] | None,
    catalogue: Catalogue,
    hypotheses: Sequence[ShownHypothesis],
) -> ShownSignal:
    """Show what machines of a catalogue have at each order of the drive.

    Parameters
    ----------
    recording : Recording
    question : SignalQuestion
        With a speed, and the channel where only one is wanted.
    machine : Machine
    mapping : mapping of column to sensor, optional
    catalogue : Catalogue
        Of that machine.
    hypotheses : sequence of ShownHypothesis
        One that the catalogue has no entries of is left out.

    Returns
    -------
    ShownSignal
        A line for each channel and hypothesis, its level at every order; where a band of the catalogue holds several
        orders, each has its share of the band.

    Raises
    ------
    MeasurementError
        The speed is missing, or a channel is none of the machine's sensors.
    """
    if question.speed is None:
        rule = "orders need the drive speed: give speed, or name a diagnosis"
        raise MeasurementError(recording.name, rule=rule, field="speed")
    motion = motion_of(recording, question, machine, mapping)
    if question.of == "frame":
        seen = {name: np.eye(3)[MOTIONS.index(name)] for name in motion.names}
    else:
        sensing = map_sensors(recording, machine, mapping)
        columns = zip(sensing.columns, sensing.transform, strict=True)
        seen = {recording.channel_names[column]: row for column, row in columns}
    if question.channel:
        motion = motion.only(question.channel)
    turn = abs(question.speed) / (2.0 * math.pi)
    edges = np.asarray(catalogue.matrix.edges)
    last = math.floor(min(float(edges[-1]), 0.5 * recording.sample_rate / turn))
    orders = np.arange(max(1, math.ceil(float(edges[0]))), last + 1, dtype=np.float64)
    if not len(orders):
        raise MeasurementError(recording.name, rule="no order of the catalogue lies in this recording", field="view")
    band = np.searchsorted(edges, orders, side="right").clip(1, len(edges) - 1) - 1
    width = np.maximum(np.diff(edges), 1.0)
    times = DERIVATIVES[UNITS[question.unit].quantity] - DERIVATIVES["acceleration"]
    scale = (2.0 * math.pi * turn * orders) ** times
    units = value_units(motion.units, question.scaling)
    lines: list[ShownLine] = []
    for hypothesis in hypotheses:
        rows = trusted_rows(catalogue.matrix, hypothesis.label)
        if hypothesis.clearances and len(rows):
            rows = np.sort(nearest_rows(catalogue.matrix, rows, hypothesis.clearances)[:ALIKE])
        if not len(rows):
            continue
        power: AnyComplexArray = catalogue.matrix.cross_power(rows)
        for name, unit, factor in zip(motion.names, units, motion.factors, strict=True):
            if name not in seen:
                continue
            level = np.median(np.einsum("i,rgij,j->rg", seen[name], power, seen[name]).real, axis=0) / width
            found = np.maximum(level[band], 0.0) * (factor * scale) ** 2
            # The width of a band of one order: what a sine has in it is all there is at an order.
            lines.append(ShownLine(name, hypothesis.kind, unit, scale_power(found, turn, question.scaling)))
    at: FloatArray = orders if question.axis == "order" else orders * turn
    return ShownSignal(
        "order" if question.axis == "order" else "frequency",
        "" if question.axis == "order" else "Hz",
        (float(at[0]), float(at[-1])),
        at,
        tuple(lines),
        notes=tuple(dict.fromkeys(f"{each.kind.replace('_', ' ')}: {each.label}" for each in hypotheses)),
    )


def trusted_rows(matrix: FeatureMatrix, label: str) -> IntArray:
    """Rows at the machine's own speed, of the machine as modelled where there are such entries."""
    for stratum in ("trusted", "wide"):
        rows = matrix.rows(label, stratum, speed=matrix.nominal_speed)
        if len(rows):
            return rows
    return matrix.rows(label)


def nearest_rows(matrix: FeatureMatrix, rows: IntArray, clearances: Mapping[str, float]) -> IntArray:
    """Some rows, those first whose radial clearances [m] are nearest to others, by their ratio."""
    worn = [matrix.joints.index(joint) for joint in clearances]
    off = np.abs(np.log(matrix.clearance(rows)[:, worn] / np.array(list(clearances.values()))))
    return np.asarray(rows[np.argsort(off.sum(axis=1), kind="stable")])
