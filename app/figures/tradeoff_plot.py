"""The work-precision diagram of ``jointplay trade-off``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from jointplay.app.figures.plots import BLUE, ORANGE, save

if TYPE_CHECKING:
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.simulation.tradeoff import TradeOff


def plot_trade_off(machine: Machine, found: TradeOff, wanted_db: float, path: Path) -> None:
    """Draw error over processor time for both methods, the wanted error, and what nothing can be claimed below."""
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
