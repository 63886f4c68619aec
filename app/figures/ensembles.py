"""What `jointplay simulate --starts` writes, prints and draws: averaged spectra and their spread."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from jointplay.app.figures.plots import BLUE, SHOWN_DECADES, SYMBOLS, save
from jointplay.app.figures.simulation_file import Attribute, SimulationFile, accuracy_of, identity
from jointplay.solver.cases.case import Settings
from jointplay.solver.cases.history import MOTIONS
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.ensemble import EnsembleResult

WINDOW = "hann"


def record_ensemble(machine: Machine, found: EnsembleResult, settings: Settings, version: str) -> SimulationFile:
    """Collect what there is to store of an ensemble: no time histories, as no single one stands for it.

    Parameters
    ----------
    machine : Machine
    found : EnsembleResult
        Of status ok.
    settings : Settings
        Of the simulation.
    version : str
        Of the solver.
    """
    frame = slice(0, len(MOTIONS))
    units = found.units[: len(MOTIONS)]
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "f": found.frequency,
        "psd_frame": found.psd[:, frame],
        "psd_frame_spread_db": found.psd_spread_db[:, frame],
        "orders": found.orders,
        "order_level_frame": found.level[:, frame],
        "order_level_frame_spread_db": found.spread_db[:, frame],
        **({"order_level_frame_error_db": found.error_db[:, frame]} if math.isfinite(found.error) else {}),
        "member_angle": np.array([member.angle for member in found.members]),
        "member_status": np.array([str(member.status) for member in found.members]),
    }
    named = {
        "f": "Hz",
        "psd_frame": ",".join(f"({unit})^2/Hz" for unit in units),
        "orders": "multiples of the drive frequency",
        "order_level_frame": ",".join(f"{unit} rms" for unit in units),
        "member_angle": "rad",
    }
    for column, sensor in enumerate(machine.sensors, start=len(MOTIONS)):
        arrays[f"psd_sensor_{sensor.name}"] = found.psd[:, column]
        arrays[f"psd_sensor_{sensor.name}_spread_db"] = found.psd_spread_db[:, column]
        named[f"psd_sensor_{sensor.name}"] = f"({found.units[column]})^2/Hz"
    named.update({name: "dB" for name in arrays if name.endswith("_db")})
    attributes: dict[str, Attribute] = {
        **identity(machine, found.case, version),
        **accuracy_of(settings),
        "status": str(found.status),
        "message": found.message,
        "sample_rate_hz": found.sample_rate,
        "drive_speed_rad_per_s": found.drive_speed,
        "psd_quantity": "acceleration",
        "psd_scaling": "one-sided power spectral density, mean over members and time",
        "psd_window": WINDOW,
        "psd_resolution_hz": float(found.frequency[1]),
        "order_level": "rms in the band one order wide around each order, of the mean power",
        "spread": "standard deviation of the members' levels, each over the whole time",
        "error": "standard error of the mean level",
        **{f"ensemble_{name}": value for name, value in summary(found).items() if value is not None},
    }
    return SimulationFile(arrays, named, attributes)


def summary(found: EnsembleResult) -> dict[str, str | float | int | bool | None]:
    """Return how the ensemble was run and how well its mean is known; None for what does not exist."""
    asked = found.ensemble
    return {
        "starts": asked.starts,
        "starts_by": asked.kind,
        "seed": asked.seed,
        "from_healthy": found.from_healthy,
        "dropped_revolutions": found.transient,
        "revolutions": found.revolutions,
        "asked_db": asked.converged_db,
        "error_db": found.error if math.isfinite(found.error) else None,
        "converged": found.converged if asked.converged_db is not None else None,
        "spread_db": found.overall_spread,
    }


def document(found: EnsembleResult, recording: SimulationFile, output: Path, plot: Path | None) -> dict[str, object]:
    """Return what was computed as JSON values."""
    return {
        "output": str(output),
        "plot": None if plot is None else str(plot),
        "status": str(found.status),
        "message": found.message,
        "sample_rate_hz": found.sample_rate,
        "computing_s": found.seconds,
        "ensemble": summary(found),
        "members": [
            {"angle_rad": member.angle, "status": str(member.status), "message": member.message}
            for member in found.members
        ],
        "datasets": sorted(recording.arrays),
    }


def report(found: EnsembleResult) -> str:
    """Return what was computed as text."""
    ended = sum(member.status == "ok" for member in found.members)
    began = "the healthy machine's steady state" if found.from_healthy else "the drawn pose"
    began = "the limit cycle" if found.from_limit_cycle else began
    known = f"known to {found.error:.2g} dB" if math.isfinite(found.error) else "not known how well"
    lines = [
        f"{ended} of {len(found.members)} members from {began}, {found.revolutions} revolutions each after the "
        f"{found.transient:g} dropped",
        f"one-order bands: the mean is {known}, members scatter by {found.overall_spread:.2g} dB",
    ]
    if found.ensemble.converged_db is not None and found.converged:
        lines.append(f"converged to the {found.ensemble.converged_db:g} dB asked for")
    if found.message:
        lines.append(f"note: {found.message}")
    return "\n".join(lines)


def plot_ensemble(recording: SimulationFile, path: Path) -> None:
    """Draw levels by order with the members' spread, for x, y and theta of the frame."""
    figure = Figure(figsize=(9, 9), layout="constrained")
    grid = figure.subplots(len(MOTIONS), 1, sharex=True)
    attributes: Mapping[str, Attribute] = recording.attributes
    figure.suptitle(f"{attributes['machine']}, {attributes['fault']}: {attributes['ensemble_starts']} starts")
    orders = np.asarray(recording.arrays["orders"], dtype=np.float64)
    for row, motion in enumerate(MOTIONS):
        level = np.asarray(recording.arrays["order_level_frame"], dtype=np.float64)[:, row]
        spread = np.asarray(recording.arrays["order_level_frame_spread_db"], dtype=np.float64)[:, row]
        level = np.maximum(level, (float(level.max()) or 1.0) * 10.0 ** (-SHOWN_DECADES / 2))
        low, high = level * 10 ** (-spread / 20), level * 10 ** (spread / 20)
        grid[row].fill_between(orders, low, high, color=BLUE, alpha=0.25, label="one standard deviation of a member")
        grid[row].loglog(orders, level, color=BLUE, linewidth=0.9, label="mean")
        unit = recording.units["order_level_frame"].split(",")[row]
        grid[row].set_ylabel(f"{SYMBOLS[motion]} [{unit}]")
        grid[row].grid(alpha=0.3, which="both")
    grid[0].legend(fontsize="small")
    grid[-1].set_xlabel("order of the drive")
    save(figure, path)
