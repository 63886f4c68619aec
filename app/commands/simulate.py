"""``jointplay simulate``: time histories and spectra of the frame."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import (
    Decibels,
    Names,
    QuantityOption,
    drive_speed,
    fault_option,
    json_option,
    print_json,
)

if TYPE_CHECKING:
    from jointplay.app.figures.simulation_file import SimulationFile
    from jointplay.solver.cases.case import Case, Method, Settings
    from jointplay.solver.cases.history import History
    from jointplay.solver.cases.steps import Accuracy
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.simulation.ensemble import Ensemble, EnsembleKind
    from jointplay.solver.spectra.spectrum import Quantity, Scaling


@click.command("simulate")
@click.argument("machine")
@fault_option
@click.option("--speed", help='Drive speed instead of the file\'s: "600 rpm", or "0.1 m/s" of a sliding drive.')
@click.option(
    "--duration", type=QuantityOption("TIME"), help="Length of the histories; by rule from transient and speed."
)
@click.option(
    "--sample-rate", type=QuantityOption("FREQUENCY"), default="20 kHz", show_default=True, help="Of the histories."
)
@click.option(
    "--accuracy",
    type=click.Choice(["draft", "standard", "reference"]),
    help="How finely to integrate [default: standard].",
)
@click.option("--rtol", type=click.FloatRange(1e-12, 1e-2), help="Scaled error of a step, in place of --accuracy.")
@click.option(
    "--method",
    type=click.Choice(["adaptive", "rosenbrock", "gill", "gill-variable", "full"]),
    help="Error-controlled steps, explicit (adaptive) or implicit (rosenbrock) [default: by what is stiff], or "
    "Runge-Kutta-Gill with fixed ones; for cross-checks Gill's with steps halved by their error, or fixed in the whole "
    "system of 3N + 2J equations.",
)
@click.option("--step", type=QuantityOption("TIME"), help="Longest step of gill and full, in place of --accuracy.")
@click.option("--starts", type=click.IntRange(2, 1000), help="Average over so many starts; spectra only (.h5, .npz).")
@click.option(
    "--starts-by",
    type=click.Choice(["perturbation", "phase"]),
    default="perturbation",
    show_default=True,
    help="How starts differ: a millionth of the machine's extent, or the drive's angle.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the starts.")
@click.option(
    "--converged", type=Decibels(), metavar="0.2dB", help="Run until averaged levels are known so well [8 starts]."
)
@click.option("--most-revolutions", type=float, default=400, show_default=True, help="End --converged there.")
@click.option(
    "--quantity",
    "quantities",
    type=Names(("displacement", "velocity", "acceleration")),
    metavar="displacement,velocity,acceleration",
    help="Spectra to write and draw besides the density of the acceleration.",
)
@click.option(
    "--scaling",
    type=click.Choice(["psd", "power", "rms", "peak"]),
    help="Of these spectra: density, mean square, amplitude of a sine as rms or peak [default: psd].",
)
@click.option("--links", is_flag=True, help="Also every link's motion and every reaction (.h5 and .npz).")
@click.option("--whole", is_flag=True, help="Model all of the machine, also what its frame cannot feel.")
@click.option("--decoupled", is_flag=True, help="Run the machine on a frame at rest; move the frame by what that does.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="OUT.h5|.csv|.npz",
    help="File for the results; its ending says which kind.",
)
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE.png|.svg|.pdf", help="Also draw them.")
@json_option
def command(
    machine: str,
    fault: str | None,
    speed: str | None,
    duration: float | None,
    sample_rate: float,
    accuracy: Accuracy | None,
    rtol: float | None,
    method: Method | None,
    step: float | None,
    starts: int | None,
    starts_by: EnsembleKind,
    seed: int,
    converged: float | None,
    most_revolutions: float,
    quantities: list[Quantity] | None,
    scaling: Scaling | None,
    links: bool,
    whole: bool,
    decoupled: bool,
    output: Path,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Simulate MACHINE (a shipped machine's name, or a file) and write what its frame does."""
    from jointplay.app.figures.outputs import writer_for

    if accuracy is not None and rtol is not None:
        raise click.UsageError("--rtol: give either --accuracy or --rtol, not both")
    if accuracy is not None and step is not None:
        raise click.UsageError("--step: give either --accuracy or --step, not both")
    several = starts is not None or converged is not None
    if several:
        refuse_for_ensembles(output, links=links, duration=duration is not None and converged is not None)
    if quantities or scaling:
        refuse_for_spectra(output, plot, several=several)
    write = writer_for(output)
    if plot is not None:
        from jointplay.app.figures.plots import check_ending

        check_ending(plot)
    from jointplay.app.errors import SimulationFailedError, UnassembledError
    from jointplay.app.figures.simulation_file import AskedSpectra, record
    from jointplay.solver.cases.case import Case, Settings, Status
    from jointplay.solver.machines.fault import parse_fault
    from jointplay.solver.machines.machine import load_machine
    from jointplay.solver.simulation.simulate import simulate
    from jointplay.version import __version__

    found = load_machine(machine)
    case = Case(fault=parse_fault(fault, found), parameters=drive_speed(found, speed))
    settings = Settings(
        duration=duration,
        sample_rate=sample_rate,
        accuracy=accuracy or "standard",
        method=method,
        rtol=rtol,
        step=step,
        links=links,
        whole=whole,
        decoupled=decoupled,
    )
    spectra = None
    if quantities or scaling:
        spectra = AskedSpectra(tuple(quantities or ("acceleration",)), scaling or "psd")
    if several:
        from jointplay.solver.simulation.ensemble import Ensemble

        asked = Ensemble(starts or 8, starts_by, converged, most_revolutions, seed)
        run_ensemble(found, case, asked, settings, output, plot, as_json)
        return
    history = simulate(found, case, settings)
    if history.status == Status.CANNOT_ASSEMBLE:
        raise UnassembledError(history.message)
    if history.status != Status.OK:
        raise SimulationFailedError(f"{found.name}: {history.status}: {history.message}")
    recording = record(found, history, settings, __version__, spectra)
    write(output, recording)
    if plot is not None:
        from jointplay.app.figures.plots import plot_simulation

        plot_simulation(recording, plot, spectra)
    report(found, case, history, recording, output, plot, as_json)


def refuse_for_ensembles(output: Path, *, links: bool, duration: bool) -> None:
    """Refuse options that contradict several starts."""
    if output.suffix.lower() == ".csv":
        raise click.UsageError(f"{output}: several starts give spectra, no histories: take .h5 or .npz")
    if links:
        raise click.UsageError("--links: several starts give spectra of the frame only")
    if duration:
        raise click.UsageError("--duration: give either --duration or --converged, not both")


def refuse_for_spectra(output: Path, plot: Path | None, *, several: bool) -> None:
    """Refuse to be asked for spectra that would stand nowhere."""
    if output.suffix.lower() == ".csv" and plot is None:
        raise click.UsageError(f"--quantity, --scaling: {output} holds no spectra: take .h5 or .npz, or add --plot")
    if several:
        raise click.UsageError("--quantity, --scaling: several starts give the density of the acceleration alone")


def run_ensemble(
    machine: Machine, case: Case, asked: Ensemble, settings: Settings, output: Path, plot: Path | None, as_json: bool
) -> None:
    """Average over several starts, write that and say what it is."""
    from jointplay.app.commands.progress import ProgressLine
    from jointplay.app.errors import SimulationFailedError
    from jointplay.app.figures.ensembles import document, plot_ensemble, record_ensemble, report
    from jointplay.app.figures.outputs import writer_for
    from jointplay.solver.cases.case import Status
    from jointplay.solver.simulation.ensemble import simulate_ensemble
    from jointplay.version import __version__

    with ProgressLine("simulating", "revolutions at most") as line:
        found = simulate_ensemble(
            machine, case, asked, settings, lambda done, most: line.show(math.ceil(done), math.ceil(most))
        )
    if found.status != Status.OK:
        failed = next(member for member in found.members if member.status != Status.OK)
        raise SimulationFailedError(f"{machine.name}: {found.message}; {failed.status}: {failed.message}")
    recording = record_ensemble(machine, found, settings, __version__)
    writer_for(output)(output, recording)
    if plot is not None:
        plot_ensemble(recording, plot)
    if as_json:
        print_json(document(found, recording, output, plot))
        return
    click.echo(say_case(machine, case, found.drive_speed))
    click.echo(report(found))
    click.echo(f"written: {output}" + (f", {plot}" if plot is not None else ""))


def say_case(machine: Machine, case: Case, speed: float) -> str:
    """Return what was run, and how fast: "slider-crank, A=0.2mm: O at 600 rpm"."""
    from jointplay.app.figures.machine_account import drive_of

    asked = case.parameters.get("drive.speed")
    if asked is not None and machine.drive is not None:
        machine = machine.model_copy(update={"drive": machine.drive.model_copy(update={"speed": asked})})
    return f"{machine.name}, {case.fault.label}: {drive_of(machine, speed)}"


def report(
    machine: Machine, case: Case, history: History, recording: SimulationFile, output: Path, plot: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Say what was computed and where it is."""
    from jointplay.solver.spectra.spectrum import frame_units

    steady = history.acceleration[history.t >= history.transient]
    rms = (steady**2).mean(axis=0) ** 0.5 if len(steady) else None
    if as_json:
        document = {
            "output": str(output),
            "plot": None if plot is None else str(plot),
            "status": str(history.status),
            "message": history.message,
            "samples": len(history.t),
            "sample_rate_hz": history.sample_rate,
            "transient_s": history.transient,
            "drive_speed_rad_per_s": history.drive_speed,
            "drive_speed_rpm": history.drive_speed * 30.0 / math.pi,
            "limit_cycle": None if history.turning is None else history.turning.is_steady,
            "step_s": history.step,
            "computing_s": history.seconds,
            "frame_acceleration_rms": None if rms is None else [float(value) for value in rms],
            "datasets": sorted(recording.arrays),
            "spectra_missing": recording.missing or None,
        }
        print_json(document)
        return
    click.echo(say_case(machine, case, history.drive_speed))
    click.echo(f"{len(history.t)} samples at {history.sample_rate:g} Hz, step {history.step:.3g} s")
    if rms is None:
        click.echo(f"all of it belongs to the transient of {history.transient:.3g} s: no levels, no spectra")
    else:
        axes = ("x", "y", "theta")
        each = zip(axes, rms, frame_units(axes, "acceleration"), strict=True)
        levels = ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in each)
        click.echo(f"frame acceleration after {history.transient:.3g} s, rms: {levels}")
    if history.message:
        click.echo(f"note: {history.message}")
    if recording.missing and rms is not None:
        click.echo(f"no spectra: {recording.missing}")
    click.echo(f"written: {output}" + (f", {plot}" if plot is not None else ""))
