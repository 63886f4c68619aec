"""Figures in files: a simulation, the work-precision diagram of a trade-off, and the evidence of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from jointplay.app import words
from jointplay.app.figures.outputs import check_output
from jointplay.app.figures.simulation_file import ALWAYS, AskedSpectra, SimulationFile
from jointplay.app.rows import Comparison, comparisons, deciding, has_decided, hypothesis_rows
from jointplay.catalogue.diagnosing.answer import BandEvidence, Diagnosis
from jointplay.solver.cases.history import MOTIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.simulation.choices import ModelChoices
    from jointplay.solver.simulation.tradeoff import TradeOff


ENDINGS = (".png", ".svg", ".pdf")
SHOWN_REVOLUTIONS = 3.0
SHOWN_DECADES = 8.0
SHOWN_HYPOTHESES = 5
SYMBOLS = {"x": "x", "y": "y", "theta": "θ"}
BLUE, ORANGE, GREEN, RING = "#1f5fa8", "#b54708", "#0e9384", "#17212b"


def check_ending(path: Path) -> None:
    """Refuse a plot's file name before any work is done.

    Raises
    ------
    OutputError
        For another ending than .png, .svg or .pdf, or a folder that does not exist.
    """
    check_output(path, ENDINGS, "must end in .png, .svg or .pdf")


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the file's ending asks for."""
    check_ending(path)
    figure.savefig(path, dpi=150)


def plot_simulation(recording: SimulationFile, path: Path, asked: AskedSpectra | None = None) -> None:
    """Draw motion over time and its spectrum by order, for x, y and theta of the frame.

    Parameters
    ----------
    recording : SimulationFile
    path : Path
    asked : AskedSpectra, optional
        What to draw in place of the density of the acceleration: three rows for each quantity.
    """
    wanted = asked or ALWAYS
    figure = Figure(figsize=(11, 8 * len(wanted.quantities)), layout="constrained")
    grid = figure.subplots(3 * len(wanted.quantities), 2)
    attributes = recording.attributes
    fault = attributes["fault"] or "no play"
    figure.suptitle(f"{attributes['machine']}, {fault}: {', '.join(wanted.quantities)} of {attributes['frame']}")
    speed = float(attributes["drive_speed_rad_per_s"])  # type: ignore[arg-type]
    blocks = [(quantity, motion) for quantity in wanted.quantities for motion in range(len(MOTIONS))]
    for (left, right), (quantity, motion) in zip(grid, blocks, strict=True):
        history, spectrum = f"frame_{quantity}", wanted.name(quantity, "frame")
        draw_over_time(left, recording.arrays["t"], recording.arrays[history][:, motion], speed)
        left.set_ylabel(f"{SYMBOLS[MOTIONS[motion]]} [{recording.units[history].split(',')[motion]}]")
        if spectrum in recording.arrays:
            unit, values = recording.units[spectrum].split(",")[motion], recording.arrays[spectrum][:, motion]
            draw_spectrum(right, recording.arrays["f"], values, speed, unit)
        elif "cascade_speed" in recording.arrays and quantity == "acceleration":
            unit = recording.units["cascade_level_frame"].split(",")[motion]
            level = np.asarray(recording.arrays["cascade_level_frame"])[:, :, motion]
            draw_cascade(right, recording.arrays["cascade_speed"], recording.arrays["orders"], level, unit)
        else:
            right.set_axis_off()
    if "cascade_speed" in recording.arrays:
        grid[0, 1].set_title(recording.missing, fontsize="small", wrap=True)
    elif recording.missing:
        grid[0, 1].text(0.0, 0.5, f"no spectra: {recording.missing}", wrap=True)
    grid[-1, 0].set_xlabel("time [s]")
    save(figure, path)


def draw_over_time(axes: Axes, time: npt.ArrayLike, values: npt.ArrayLike, drive_speed: float = 0.0) -> None:
    """Draw the last revolutions of one motion; all of it where nothing turns."""
    t = np.asarray(time, dtype=np.float64)
    if not len(t):
        return
    span = SHOWN_REVOLUTIONS * 2 * math.pi / abs(drive_speed) if drive_speed else math.inf
    shown = t >= max(t[0], t[-1] - span)
    axes.plot(t[shown], np.asarray(values)[shown], color=BLUE, linewidth=0.8)
    axes.grid(alpha=0.3)


def draw_spectrum(
    axes: Axes, frequency: npt.ArrayLike, spectrum: npt.ArrayLike, drive_speed: float | None, unit: str
) -> None:
    """Draw a spectrum (n,) over orders, or over frequency where nothing turns evenly."""
    base = abs(drive_speed) / (2 * math.pi) if drive_speed else 1.0
    values = np.asarray(spectrum, dtype=np.float64)[1:]
    top = float(values.max(initial=0.0)) or 1.0
    # What is far below the rest is rounding, and would only squeeze the part that matters.
    shown = np.maximum(values, top * 10.0**-SHOWN_DECADES)
    axes.loglog(np.asarray(frequency, dtype=np.float64)[1:] / base, shown, color=BLUE, linewidth=0.8)
    axes.set_ylabel(unit)
    axes.set_xlabel("order of the drive" if drive_speed else "frequency [Hz]")
    axes.grid(alpha=0.3, which="both")


def draw_cascade(
    axes: Axes, speed: npt.ArrayLike, orders: npt.ArrayLike, level: npt.NDArray[np.float64], unit: str
) -> None:
    """Draw levels (w, k) in orders (k,) over the speed (w,) of a run-up, in colours, the slowest below."""
    rpm = np.asarray(speed, dtype=np.float64) * 30 / math.pi
    rising = np.argsort(rpm, kind="stable")
    # What is far below the rest is rounding, and would only take the colours from what matters.
    floor = float(np.nanmax(level, initial=0.0)) * 10.0 ** (-SHOWN_DECADES / 2) or 1e-300
    shown = 20 * np.log10(np.maximum(level[rising], floor))
    image = axes.pcolormesh(np.asarray(orders, dtype=np.float64), rpm[rising], shown, shading="nearest")
    axes.figure.colorbar(image, ax=axes, label=f"dB re 1 {unit}")
    axes.set_xscale("log")
    axes.set_ylabel("speed [rpm]")
    axes.set_xlabel("order of the drive")


def plot_diagnosis(result: Diagnosis, name: str, path: Path) -> None:
    """Draw a diagnosis as :func:`draw_diagnosis` into a file."""
    save(draw_diagnosis(result, name), path)


def draw_diagnosis(result: Diagnosis, name: str) -> Figure:
    """Draw the ranking, and measured against matched levels by order for every channel.

    Parameters
    ----------
    result : Diagnosis
    name : str
        Of the recording.
    """
    found = comparisons(result)
    figure = Figure(figsize=(11, 2.2 + 2.6 * (1 + len(found))), layout="constrained")
    grid = figure.subplots(1 + len(found), 1, squeeze=False)[:, 0]
    figure.suptitle(f"{name}: {words.sentence(result)}", wrap=True)
    draw_ranking(grid[0], result)
    decided = deciding(result, found)
    names = [f"matched: {entry.label}" for entry in result.hypotheses[:1]] or ["matched"]
    for axes, comparison in zip(grid[1:], found, strict=True):
        rings = [band for other, band in decided if other is comparison]
        draw_comparison(axes, comparison, names[0], result.evidence.rival, rings)
    if len(found) and (said := words.rings_sentence(result)):
        grid[1].set_title(said, loc="right", fontsize="small", color=RING)
    grid[-1].set_xlabel("order of the drive")
    return figure


def draw_ranking(axes: Axes, result: Diagnosis) -> None:
    """Draw probabilities of the first hypotheses as bars, the most probable on top."""
    shown = hypothesis_rows(result, SHOWN_HYPOTHESES)[::-1]
    names = ["\n".join([row.label, *(play.say() for play in row.plays)]) for row in shown]
    # Bars that are filled would say that something was decided.
    look: dict[str, Any] = (
        {"color": ORANGE} if has_decided(result) else {"color": "none", "edgecolor": "0.6", "linestyle": ":"}
    )
    bars = axes.barh(range(len(shown)), [row.probability for row in shown], **look)
    axes.set_yticks(range(len(shown)), names, fontsize="small")
    axes.bar_label(bars, [row.percent for row in shown], padding=3)
    axes.set_xlim(0, 1.12)
    axes.set_xlabel("probability" if has_decided(result) else "probability beside each other: none of them explains it")


def draw_comparison(
    axes: Axes, comparison: Comparison, matched: str, rival: str | None, decided: Sequence[BandEvidence]
) -> None:
    """Draw one channel: measured, matched and how far it may scatter, the second; rings where bands decided."""
    orders = [band.order for band in comparison.bands]
    lower = [band.predicted_db - 2 * band.spread_db for band in comparison.bands]
    upper = [band.predicted_db + 2 * band.spread_db for band in comparison.bands]
    axes.fill_between(orders, lower, upper, color=ORANGE, alpha=0.2, label="scatter, two standard deviations")
    axes.plot(orders, [band.predicted_db for band in comparison.bands], color=ORANGE, linestyle="--", label=matched)
    if rival is not None:
        second = [math.nan if band.rival_db is None else band.rival_db for band in comparison.bands]
        axes.plot(orders, second, color=GREEN, linestyle=":", label=f"second: {rival}")
    axes.plot(
        orders, [band.measured_db for band in comparison.bands], color=BLUE, marker="o", markersize=3, label="measured"
    )
    ringed = [band.order for band in decided], [band.measured_db for band in decided]
    axes.plot(*ringed, color=RING, marker="o", markersize=11, fillstyle="none", linestyle="none")
    axes.set_xscale("log")
    axes.set_title(comparison.title, loc="left", fontsize="medium")
    axes.set_ylabel(comparison.label)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")


def plot_trade_off(
    machine: Machine, found: TradeOff, wanted_db: float, path: Path, choices: ModelChoices | None = None
) -> None:
    """Draw error over processor time for both methods, the wanted error, and what nothing can be claimed below; what
    choices of the model cost and change, where they are given.
    """
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots()
    for method, colour in (("adaptive", BLUE), ("gill", ORANGE)):
        shown = [p for p in found.points if p.settings.integrator == method and math.isfinite(p.error_db)]
        axes.loglog(
            [point.seconds for point in shown],
            [point.error_db for point in shown],
            color=colour,
            marker="o",
            label=method,
        )
        for point in shown:
            name = f"{point.settings.rtol:g}" if point.settings.rtol else f"{point.step:.2g} s"
            axes.annotate(
                f"{name} {point.accuracy}".strip(), (point.seconds, point.error_db), textcoords="offset points",
                xytext=(6, 4), fontsize="x-small",
            )  # fmt: skip
    if choices is not None:
        # Choices lie close together: letters, and what they stand for in a box.
        told = [each for each in choices.choices if each.difference_db > choices.floor_db]
        axes.loglog([c.seconds for c in told], [c.difference_db for c in told], "s", color="0.3", label="model")
        for choice, letter in zip(told, ascii_lowercase, strict=False):
            place = (choice.seconds, choice.difference_db)
            axes.annotate(letter, place, textcoords="offset points", xytext=(-2, -13), fontsize="x-small", color="0.3")
        listed = "\n".join(f"{letter}  {choice.name}" for choice, letter in zip(told, ascii_lowercase, strict=False))
        axes.text(0.98, 0.04, listed, transform=axes.transAxes, ha="right", va="bottom", fontsize="x-small")
    axes.axhline(wanted_db, color="0.4", linestyle="--", linewidth=0.8, label="wanted")
    if found.chaotic:
        axes.axhline(found.spread_db, color="0.4", linestyle=":", label="spread of single runs")
    axes.axhline(found.reference_error_db, color="0.7", linewidth=0.8, label="error of the reference")
    axes.set_title(f"{machine.name}, {found.case.fault.label}: {found.computer}", fontsize="medium")
    axes.set_xlabel("processor seconds per simulated second, lanes filled")
    measure = "one-order bands" if found.chaotic else "harmonics"
    axes.set_ylabel(f"mean |error| of {found.compared} {measure}, {found.motion} of {machine.frame} [dB]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    save(figure, path)
