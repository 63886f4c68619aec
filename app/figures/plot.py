"""A picture of whatever a program has in hand."""

from __future__ import annotations

import functools

import numpy as np
from matplotlib.figure import Figure

from jointplay.app.figures.plots import draw_diagnosis, draw_over_time, draw_spectrum
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.measurements.measurement import SI_UNITS, Recording
from jointplay.solver.cases.history import MOTIONS, History
from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.spectrum import Spectrum, frame_units


@functools.singledispatch
def plot(result: object) -> Figure:
    """Draw a history, a spectrum, a recording over time or a diagnosis.

    Parameters
    ----------
    result : History, Spectrum, Recording or Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it; ``savefig`` writes it.

    Raises
    ------
    TypeError
        Nothing that can be drawn.
    """
    raise TypeError(f"{type(result).__name__}: must be a History, a Spectrum, a Recording or a Diagnosis")


@plot.register
def _(result: History) -> Figure:
    spectrum, missing = None, ""
    try:
        spectrum = result.spectrum()
    except SettingsError as error:
        missing = f"no spectrum: {error}"
    figure = Figure(figsize=(11, 8), layout="constrained")
    figure.suptitle(f"{result.case.fault.label}: acceleration of the frame")
    for row, motion in enumerate(MOTIONS):
        left, right = figure.add_subplot(3, 2, 2 * row + 1), figure.add_subplot(3, 2, 2 * row + 2)
        draw_over_time(left, result.t, result.band_limited_acceleration[:, row], result.drive_speed)
        left.set_ylabel(f"{motion} [{frame_units((motion,), 'acceleration')[0]}]")
        if spectrum is None:
            right.set_axis_off()
            right.text(0.0, 0.5, missing if row == 0 else "", wrap=True)
        else:
            unit = spectrum.value_units[row]
            draw_spectrum(right, spectrum.frequency, spectrum.values[:, row], result.drive_speed, unit)
    left.set_xlabel("time [s]")
    return figure


@plot.register
def _(result: Spectrum) -> Figure:
    figure = Figure(figsize=(9, 2.7 * len(result.channels)), layout="constrained")
    for column, (channel, unit) in enumerate(zip(result.channels, result.value_units, strict=True)):
        axes = figure.add_subplot(len(result.channels), 1, column + 1)
        draw_spectrum(axes, result.frequency, result.values[:, column], result.drive_speed, f"{channel} [{unit}]")
    return figure


@plot.register
def _(result: Recording) -> Figure:
    figure = Figure(figsize=(9, 2.0 * len(result.channels)), layout="constrained")
    time = np.arange(len(result.signal)) / result.sample_rate
    for column, channel in enumerate(result.channels):
        axes = figure.add_subplot(len(result.channels), 1, column + 1)
        draw_over_time(axes, time, result.signal[:, column])
        axes.set_ylabel(f"{channel.name} [{SI_UNITS[channel.quantity]}]")
    axes.set_xlabel("time [s]")
    return figure


@plot.register
def _(result: Diagnosis) -> Figure:
    return draw_diagnosis(result, result.machine)
