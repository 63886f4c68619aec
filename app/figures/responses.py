"""The frequency response of a frame as a figure: for files, and as SVG for pages and reports."""

from __future__ import annotations

import io
import math
import re
from xml.etree import ElementTree

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from jointplay.solver.cases.answers import say_band
from jointplay.solver.cases.remarks import strong_orders
from jointplay.solver.cases.responses import FrameResponse, find_response
from jointplay.solver.equations.drive import drive_rates
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.response import FORCES

SVG, LINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
ElementTree.register_namespace("", SVG)
ElementTree.register_namespace("xlink", LINK)
UNSAID = dict.fromkeys(("Creator", "Date", "Format", "Type"))
SHOWN_DECADES = 4.0  # of magnitudes: what is further below only squeezes the rest
UNITS = dict(zip(FORCES, ("m/s2/N", "m/s2/N", "m/s2/(N m)"), strict=True))


def draw_response(machine: Machine, phase: bool = True) -> Figure:
    """Draw what sensors answer to each force over frequency and orders of the drive: magnitude, and phase below.

    Orders that the drive shakes the frame with are lines. What a measured response does not know is not drawn, and
    grey where the drive's own frequency lies there.

    Parameters
    ----------
    machine : Machine
        That has a response.
    phase : bool
        Whether to draw it.
    """
    response = find_response(machine)
    frequency = response.frequency
    drive = abs(drive_rates(machine, {})[0]) / (2 * math.pi)
    missing = bool(drive) and drive < frequency[0]
    figure = Figure(figsize=(10, 4.4) if phase else (6.4, 3.0), layout="constrained")
    # A name may be any line of text, with $ in it.
    title = figure.suptitle(say_response(machine, response), x=0.01, horizontalalignment="left", parse_math=False)
    title.set_fontsize("medium" if phase else "small")
    shares = (3, 2) if phase else (1,)
    grid = figure.subplots(len(shares), len(FORCES), sharex=True, squeeze=False, height_ratios=shares)
    for column, (force, unit) in enumerate(UNITS.items()):
        above, below = grid[0, column], grid[-1, column]
        answers = response.accelerances[:, :, column]
        above.set_title(f"to {force} [{unit}]", fontsize="small")
        for sensor, answer in zip(machine.sensors, answers.T, strict=True):
            above.loglog(frequency, np.abs(answer), linewidth=0.9, label=sensor.name)
            if phase:
                turned = np.degrees(np.angle(answer))
                breaks = np.flatnonzero(np.abs(np.diff(turned)) > 180) + 1  # from -180 to 180 is no jump
                below.semilogx(np.insert(frequency, breaks, np.nan), np.insert(turned, breaks, np.nan), linewidth=0.9)
        above.set_ylim(bottom=max(above.get_ylim()[0], np.abs(answers).max() * 10.0**-SHOWN_DECADES))
        above.yaxis.set_major_formatter("{x:g}")
        if phase:
            below.set_ylim(-190, 190)
            below.set_yticks(range(-180, 181, 90))
        below.set_xlim(0.8 * drive if missing else frequency[0], frequency[-1])
        shown = list(grid[:, column])
        for axes in shown:
            axes.grid(alpha=0.3)
            axes.xaxis.set_major_formatter("{x:g}")
            if missing:
                axes.axvspan(0.8 * drive, frequency[0], color="0.88")
            for order in strong_orders(machine) if drive else ():
                axes.axvline(order * drive, color="0.3", linewidth=1.0, linestyle="--")
        if drive:
            shown.append(above.secondary_xaxis("top", functions=(lambda x: x / drive, lambda x: x * drive)))
            shown[-1].xaxis.set_major_formatter("{x:g}")
        for axes in shown:
            axes.minorticks_off()  # most of the time to draw it
            axes.tick_params(labelsize=8)
    figure.supxlabel("frequency [Hz]; above, order of the drive" if drive else "frequency [Hz]", fontsize="small")
    grid[0, 0].legend(fontsize="x-small")
    grid[0, 0].set_ylabel("magnitude", fontsize="small")
    if phase:
        grid[1, 0].set_ylabel("phase [deg]", fontsize="small")
    return figure


def say_response(machine: Machine, response: FrameResponse) -> str:
    """Return in two lines what is drawn: answers of which machine, to forces where, and where from."""
    modes = ", ".join(f"{mode.frequency:g} Hz" for mode in machine.modes)
    source = say_band(machine) if machine.response else f"by the modes at {modes} of {machine.frame} on its supports"
    return f"{machine.name}, what its sensors answer to forces at {response.point}\n{source}"


def say_strongest(machine: Machine, response: FrameResponse) -> str:
    """Return in one clause where sensors answer to each force most."""
    sizes = np.abs(response.accelerances)
    found = []
    for column, (force, unit) in enumerate(UNITS.items()):
        line, index = np.unravel_index(int(sizes[:, :, column].argmax()), sizes.shape[:2])
        most = f"{sizes[line, index, column]:.2g} {unit} at {response.frequency[line]:.3g} Hz"
        found.append(f"to {force} {most} ({machine.sensors[index].name})")
    return f"the strongest answers: {', '.join(found)}"


def response_svg(machine: Machine, phase: bool) -> str:
    """Return the figure as one SVG element that can be read aloud; without styles, which policies of pages forbid."""
    response, file = find_response(machine), io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "response"}):
        draw_response(machine, phase).savefig(file, format="svg", metadata=UNSAID)
    drawn = ElementTree.fromstring(file.getvalue())
    drawn.remove(drawn[0])  # a style sheet, of how lines end
    for element in drawn.iter():
        for part in filter(None, element.attrib.pop("style", "").split("; ")):
            name, value = part.split(": ")
            element.set(name, "system-ui, sans-serif" if name == "font-family" else value)
        if "d" in element.attrib:
            element.set("d", re.sub(r"(\.\d\d)\d+", r"\1", element.attrib["d"]))
    drawn.set("role", "img")
    title = ElementTree.Element(f"{{{SVG}}}title")
    title.text = f"{say_response(machine, response)}; {say_strongest(machine, response)}".replace("\n", "; ")
    drawn.insert(0, title)
    return ElementTree.tostring(drawn, encoding="unicode")
