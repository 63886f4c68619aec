"""Figures of a report as SVG: the mechanism, and measured against matched levels.

Plain colours and attributes alone, no style sheet, because they are put into a PDF too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from jointplay.app import words
from jointplay.app.rows import Comparison, comparisons, deciding, joint_colours
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.catalogue.diagnosing.answer import Answer, BandEvidence
from jointplay.solver.machines.drawing import machine_svg
from jointplay.solver.machines.machine import Machine, parse_machine

WEAR = (232, 106, 20)
INK, SOFT, GRID = "#16202b", "#566373", "#d4dae1"
MEASURED, MATCHED, SCATTER, RIVAL, DECIDED = "#1f5fa8", "#b54708", "#f4dccb", "#0e9384", "#17212b"
FAINTEST = 0.005
WIDTH, HEIGHT = 240.0, 170.0
LEFT, RIGHT, TOP, BOTTOM = 27.0, 6.0, 20.0, 30.0
TICKS_DB = (1, 2, 5, 10, 20, 50, 100)
ORDERS = (1, 3, 10, 30, 100, 300, 1000, 3000)
SHOWN_SPECTRA = 3


@dataclass(frozen=True)
class ReportFigures:
    """The figures of a report, each one SVG element, and what is said below the spectra.

    ``response`` is that of the machine's frame, empty where its file does not say it; ``trend`` the past of the asset,
    empty where there is none.
    """

    mechanism: str
    response: str
    spectra: tuple[str, ...]
    caption: str
    trend: str = ""


def figures_of(row: DiagnosisRow, response: str = "", trend: str = "") -> ReportFigures:
    """Return the figures of a stored diagnosis, beside the response of its machine's frame and its asset's past."""
    machine = parse_machine(row.machine)
    channels = comparisons(row.answer)
    decided = deciding(row.answer, channels)
    return ReportFigures(
        mechanism(machine, joint_colours(row.answer)),
        response,
        tuple(spectrum(each, [band for other, band in decided if other is each]) for each in channels[:SHOWN_SPECTRA]),
        caption(row.answer, len(channels) - SHOWN_SPECTRA),
        trend,
    )


def caption(result: Answer, more: int) -> str:
    """Return what lines and signs of the spectra mean, and how many channels are not drawn."""
    rival = result.evidence.rival
    matched = f" ({result.hypotheses[0].label})" if result.hypotheses else ""
    parts = [
        f"Blue: measured. Orange, dashed: matched{matched}, its scatter (two standard deviations) shaded.",
        f"Green, dotted: second ({rival})." if rival else "",
        words.rings_sentence(result),
        f"Not drawn: {more} more, which are in the answer itself." if more > 0 else "",
    ]
    return " ".join(part for part in parts if part)


def mechanism(machine: Machine, probabilities: Mapping[str, float]) -> str:
    """Return the drawing of a machine, each joint the deeper in colour the more probable its wear.

    Parameters
    ----------
    machine : Machine
    probabilities : Mapping
        Joint to probability, 0 to 1.
    """
    colours = {joint: blend(share) for joint, share in probabilities.items() if share >= FAINTEST}
    drawn = machine_svg(machine, colours, f"{machine.name}, joints coloured by the probability of wear")
    return drawn.replace('"currentColor"', f'"{INK}"')


def blend(share: float) -> str:
    """Return the colour of wear on white."""
    return "#{:02x}{:02x}{:02x}".format(*(round(255 + (part - 255) * min(share, 1.0)) for part in WEAR))


def spectrum(comparison: Comparison, decided: Sequence[BandEvidence] = ()) -> str:
    """Return one channel over orders as SVG: measured, matched and its scatter, second; rings: bands that decided."""
    bands = comparison.bands
    across, along = scales(bands)
    orders = [across(band.order) for band in bands]
    scatter = [
        *((x, along(band.predicted_db + 2 * band.spread_db)) for x, band in zip(orders, bands, strict=True)),
        *(
            (x, along(band.predicted_db - 2 * band.spread_db))
            for x, band in reversed(list(zip(orders, bands, strict=True)))
        ),
    ]
    matched = [(x, along(band.predicted_db)) for x, band in zip(orders, bands, strict=True)]
    measured = [(x, along(band.measured_db)) for x, band in zip(orders, bands, strict=True)]
    second = [(x, along(band.rival_db)) for x, band in zip(orders, bands, strict=True) if band.rival_db is not None]
    rings = [at for at, band in zip(measured, bands, strict=True) if band in decided]
    title = f"{comparison.title}: level by order of the drive, measured and matched"
    parts = [
        *grid(bands),
        f'<polygon points="{points(scatter)}" fill="{SCATTER}" stroke="none"/>',
        curve(matched, MATCHED, ' stroke-dasharray="4 3"'),
        curve(second, RIVAL, ' stroke-dasharray="1 2"') if second else "",
        curve(measured, MEASURED),
        *(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5" fill="{MEASURED}"/>' for x, y in measured),
        *(ring(*at) for at in rings),
        label(LEFT, 13, comparison.title, INK, "start", 11),
        label(WIDTH - RIGHT, 13, comparison.label, SOFT, "end"),
        label((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 4, "order of the drive", SOFT, "middle"),
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" '
        f'font-family="system-ui, sans-serif" font-size="9"><title>{escape(title)}</title>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


class Scale:
    """From a range of values to a range of pixels.

    Parameters
    ----------
    low, high : float
        Values at the two ends; equal ones are put in the middle.
    start, end : float
        Pixels there.
    logarithmic : bool
        Whether equal ratios are equally far apart; values are > 0 then.
    """

    def __init__(self, low: float, high: float, start: float, end: float, logarithmic: bool = False) -> None:
        self._of = math.log if logarithmic else float
        self._low, self._span = self._of(low), self._of(high) - self._of(low)
        self._start, self._length = start, end - start

    def __call__(self, value: float) -> float:
        """Return where a value lies."""
        part = (self._of(value) - self._low) / self._span if self._span else 0.5
        return self._start + part * self._length


def limits(bands: Sequence[BandEvidence]) -> tuple[float, float]:
    """Return the lowest and highest level shown [dB]; scatter further off than the levels by 20 dB is cut."""
    levels = [level for band in bands for level in (band.measured_db, band.predicted_db)]
    low = min(band.predicted_db - 2 * band.spread_db for band in bands)
    high = max(band.predicted_db + 2 * band.spread_db for band in bands)
    return max(min(*levels, low), min(levels) - 20), min(max(*levels, high), max(levels) + 20)


def scales(bands: Sequence[BandEvidence]) -> tuple[Scale, Scale]:
    """Return the scales of orders and of levels."""
    low, high = limits(bands)
    across = Scale(bands[0].order, bands[-1].order, LEFT, WIDTH - RIGHT, logarithmic=True)
    up = Scale(low, high, HEIGHT - BOTTOM, TOP)
    return across, up


def grid(bands: Sequence[BandEvidence]) -> list[str]:
    """Return lines and numbers of both axes."""
    across, along = scales(bands)
    low, high = limits(bands)
    step = next((tick for tick in TICKS_DB if (high - low) / tick <= 6), TICKS_DB[-1])
    parts = []
    for level in range(math.ceil(low / step) * step, math.floor(high) + 1, step):
        y = along(level)
        parts.append(line(LEFT, y, WIDTH - RIGHT, y))
        parts.append(label(LEFT - 4, y + 3, str(level), SOFT, "end"))
    for order in ORDERS:
        if bands[0].order <= order <= bands[-1].order:
            x = across(order)
            parts.append(line(x, TOP, x, HEIGHT - BOTTOM))
            parts.append(label(x, HEIGHT - BOTTOM + 11, str(order), SOFT, "middle"))
    return parts


def line(x1: float, y1: float, x2: float, y2: float) -> str:
    """Return a line of the grid."""
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{GRID}" stroke-width="0.6"/>'


def curve(pixels: Sequence[tuple[float, float]], colour: str, more: str = "") -> str:
    """Return a line through points."""
    return f'<polyline points="{points(pixels)}" fill="none" stroke="{colour}" stroke-width="1.2"{more}/>'


def ring(x: float, y: float) -> str:
    """Return the mark of a band that decided."""
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="none" stroke="{DECIDED}" stroke-width="1.1"/>'


def label(x: float, y: float, text: str, colour: str, anchor: str, size: float = 9) -> str:
    """Return a text."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-size="{size}" text-anchor="{anchor}">{escape(text)}</text>'
    )


def points(pixels: Sequence[tuple[float, float]]) -> str:
    """Return the points of a line, kept inside the frame of the figure."""
    return " ".join(f"{x:.1f},{min(max(y, TOP), HEIGHT - BOTTOM):.1f}" for x, y in pixels)
