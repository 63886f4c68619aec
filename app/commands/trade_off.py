"""``jointplay trade-off``: what spectral accuracy costs for a machine on this computer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import Decibels, drive_speed, fault_option, json_option, print_json
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.tables import indent, table

if TYPE_CHECKING:
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.simulation.choices import ModelChoices
    from jointplay.solver.simulation.tradeoff import Recommendation, TradeOff
    from jointplay.solver.simulation.workbench import TradeOffPoint


@click.command("trade-off")
@click.argument("machine")
@fault_option
@click.option("--speed", help='Drive speed instead of the file\'s: "600 rpm", or "0.1 m/s" of a sliding drive.')
@click.option(
    "--error", type=Decibels(), default="0.1dB", show_default=True, metavar="0.1dB", help="Harmonic error wanted."
)
@click.option("--choices", "chosen", is_flag=True, help="Also what choices of the model cost and change: friction, ...")
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE.png|.svg|.pdf", help="Also draw it.")
@json_option
def command(
    machine: str, fault: str | None, speed: str | None, error: float, chosen: bool, plot: Path | None, as_json: bool
) -> None:
    """Measure harmonic error against processor time for MACHINE, and recommend a setting."""
    if plot is not None:
        from jointplay.app.figures.plots import check_ending

        check_ending(plot)
    from jointplay.app.errors import SimulationFailedError
    from jointplay.solver.cases.case import Case
    from jointplay.solver.cases.history import History
    from jointplay.solver.machines.fault import parse_fault
    from jointplay.solver.machines.machine import load_machine
    from jointplay.solver.simulation.tradeoff import measure

    found = load_machine(machine)
    case = Case(parse_fault(fault, found), drive_speed(found, speed))
    with ProgressLine("measuring", "settings") as line:
        measured = measure(found, case, line.show)
    if isinstance(measured, History):
        raise SimulationFailedError(f"{found.name}: no reference: {measured.status}: {measured.message}")
    advice = measured.recommend(error)
    choices: ModelChoices | None = None
    if chosen:
        from jointplay.solver.simulation.choices import measure_choices

        tried = measure_choices(found, case)
        if isinstance(tried, History):
            raise SimulationFailedError(f"{found.name}: no choices: {tried.status}: {tried.message}")
        choices = tried
    if plot is not None:
        from jointplay.app.figures.plots import plot_trade_off

        plot_trade_off(found, measured, error, plot, choices)
    if as_json:
        print_json(document(found, measured, advice, error, plot) | describe_choices(choices))
        return
    click.echo(report(found, measured, advice, error))
    if choices is not None:
        click.echo(f"\n{report_choices(choices)}")
    if plot is not None:
        click.echo(f"\ndrawn: {plot}")


def option_of(point: TradeOffPoint) -> str:
    """Return the options of `jointplay simulate` that ask for a setting."""
    if point.settings.integrator == "gill":
        # A step to all its digits: a shorter one would make for more steps a sample.
        return f"--method gill --accuracy {point.accuracy}" if point.accuracy else f"--step {point.step!r}"
    return f"--accuracy {point.accuracy}" if point.accuracy else f"--rtol {point.settings.rtol:g}"


def document(
    machine: Machine, found: TradeOff, advice: Recommendation, error: float, plot: Path | None
) -> dict[str, object]:
    """Return everything as JSON values; what does not exist is null."""
    best = advice.point
    return {
        "machine": machine.name,
        "fault": found.case.fault.label,
        "drive_frequency_hz": found.frequency,
        "drive_speed_rpm": found.frequency * 60.0,
        "motion": found.motion,
        "measure": "one-order bands" if found.chaotic else "harmonics",
        "compared": found.compared,
        "duration_s": found.duration,
        "transient_s": found.transient,
        "chaotic": found.chaotic,
        "perturbation_growth": found.growth,
        "perturbed_difference_db": found.difference_db,
        "spread_db": found.spread_db if found.chaotic else None,
        "reference": {
            "method": "adaptive",
            "rtol": found.reference_rtol,
            "checked_against_rtol": found.check_rtol,
            "error_db": found.reference_error_db,
        },
        "settings": [describe_point(found, point) for point in found.points],
        "wanted_error_db": error,
        "recommended": None if best is None else describe_point(found, best),
        "reason": advice.reason,
        "computer": found.computer,
        "preparation_s": found.preparation,
        "plot": None if plot is None else str(plot),
    }


def finite(value: float) -> float | None:
    """Return a number, or nothing for one that is none."""
    return value if math.isfinite(value) else None


def describe_point(found: TradeOff, point: TradeOffPoint) -> dict[str, object]:
    """Return one setting as JSON values."""
    return {
        "method": point.settings.integrator,
        "accuracy": point.accuracy or None,
        "rtol": point.settings.rtol,
        "step_s": point.step,
        "option": option_of(point),
        "status": str(point.status),
        "processor_s_per_s": point.seconds,
        "error_db": finite(point.error_db),
        "worst_error_db": finite(point.worst_db),
        "repeatability_db": finite(point.repeat_db),
        "more_pays": found.pays(point),
    }


def describe_choices(found: ModelChoices | None) -> dict[str, object]:
    """Return what choices of the model cost and change as JSON values; nothing where they were not asked for."""
    if found is None:
        return {}
    choices = [
        {
            "kind": each.kind,
            "choice": each.name,
            "status": str(each.status),
            "processor_s_per_s": finite(each.seconds),
            "difference_db": finite(each.difference_db),
        }
        for each in found.choices
    ]
    return {"choices": {"processor_s_per_s": found.seconds, "floor_db": found.floor_db, "choices": choices}}


def report_choices(found: ModelChoices) -> str:
    """Return what choices of the model cost and change as plain text."""
    rows = []
    for each in found.choices:
        ok = math.isfinite(each.difference_db)
        told = f"{each.difference_db:.2g} dB" if each.difference_db > found.floor_db else f"< {found.floor_db:.1g} dB"
        cost = f"{each.seconds / found.seconds:.2f}" if ok else "-"
        rows.append([each.kind, each.name, cost, told if ok else str(each.status)])
    measure = "one-order bands, means of eight runs" if found.chaotic else "harmonics"
    return "\n".join([
        f"choices of the model against the file's, mean |dB| of {measure}; processor time in parts of the file's",
        "", indent(table(("of", "choice", "costs", "changes"), rows, frozenset({2, 3}))),
    ])  # fmt: skip


def report(machine: Machine, found: TradeOff, advice: Recommendation, error: float) -> str:
    """Return everything as plain text."""
    what = f"{found.compared} {'one-order bands' if found.chaotic else 'harmonics'}"
    per = "rpm" if machine.drive is not None and machine.drive.kind in ("rotation", "torque") else "a minute"
    head = [
        f"{machine.name}, {found.case.fault.label}, {found.frequency * 60:.6g} {per}: acceleration of "
        f"{machine.frame} along {found.motion}, mean |dB| over {what}",
        f"{found.duration:.3g} s simulated, of which {found.transient:.3g} s transient; eight runs a rounding apart",
        f"reference: rtol {found.reference_rtol:g}, from which rtol {found.check_rtol:g} is "
        f"{found.reference_error_db:.2g} dB away: nothing below that is claimed",
    ]
    if found.chaotic:
        head.append(
            f"chaotic: a perturbation grows by {found.growth:.1g}, harmonics of the reference then differ by "
            f"{found.difference_db:.2g} dB; band levels of single runs scatter by {found.spread_db:.2g} dB"
        )
    columns = ("setting", "accuracy", "mean step", "processor s/s", "error", "worst run", "repeats within", "")
    rows = [row(found, point) for point in found.points]
    best = advice.point
    if best is None:
        end = f"no recommendation for {error:g} dB: {advice.reason}"
    else:
        end = f"recommended for {error:g} dB: {option_of(best)}; {advice.reason}"
    return "\n".join([
        *head, "", indent(table(columns, rows, frozenset({2, 3, 4, 5, 6}))), "", end,
        f"processor time of {found.computer}, lanes filled; equations and kernels took {found.preparation:.2g} s apart",
    ])  # fmt: skip


def row(found: TradeOff, point: TradeOffPoint) -> list[str]:
    """Return one setting as cells."""
    name: str = point.settings.integrator
    if point.settings.rtol is not None:
        name = f"{name}, rtol {point.settings.rtol:g}"
    cells = [name, point.accuracy, f"{point.step:.2g} s", f"{point.seconds:.4f}"]
    if not math.isfinite(point.error_db):
        return [*cells, "-", "-", "-", str(point.status)]
    errors = [level(found, point.error_db), level(found, point.worst_db), f"{point.repeat_db:.1g} dB"]
    return [*cells, *errors, "" if found.pays(point) else "more does not pay"]


def level(found: TradeOff, error: float) -> str:
    """Return an error with no claim below what the reference is known to."""
    if not found.chaotic and error < found.reference_error_db:
        return f"< {found.reference_error_db:.1g} dB"
    return f"{error:.2g} dB"
