"""``jointplay simulate``: time histories and spectra of the frame."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from app.commands.parameters import Quantity, json_option, print_json

if TYPE_CHECKING:
    from app.recording import Recording
    from solver.history import History
    from solver.steps import Accuracy


@click.command("simulate")
@click.argument("machine")
@click.option("--fault", default="", metavar="A=0.2mm,F=50um", help="Radial clearance of worn joints; none by default.")
@click.option(
    "--speed", type=Quantity("ANGULAR_SPEED", positive=False), help='Drive speed instead of the file\'s: "600 rpm".'
)
@click.option("--duration", type=Quantity("TIME"), help="Length of the histories; by rule from transient and speed.")
@click.option(
    "--sample-rate", type=Quantity("FREQUENCY"), default="20 kHz", show_default=True, help="Of the histories."
)
@click.option(
    "--accuracy",
    type=click.Choice(["draft", "standard", "reference"]),
    help="How finely to integrate [default: standard].",
)
@click.option("--rtol", type=click.FloatRange(1e-12, 1e-2), help="Scaled error of a step, in place of --accuracy.")
@click.option(
    "--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True, help="Where to integrate."
)
@click.option("--links", is_flag=True, help="Also every link's motion and every reaction (.h5 and .npz).")
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
    fault: str,
    speed: float | None,
    duration: float | None,
    sample_rate: float,
    accuracy: Accuracy | None,
    rtol: float | None,
    device: Literal["cpu", "cuda"],
    links: bool,
    output: Path,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Simulate MACHINE (a shipped machine's name, or a file) and write what its frame does."""
    from app.outputs import writer_for

    if accuracy is not None and rtol is not None:
        raise click.UsageError("--rtol: give either --accuracy or --rtol, not both")
    write = writer_for(output)
    if plot is not None:
        from app.plots import check_ending

        check_ending(plot)
    from app.errors import SimulationFailedError, UnassembledError
    from app.recording import record
    from solver import __version__
    from solver.fault import parse_fault
    from solver.machine import resolve_machine
    from solver.simulate import Case, Settings, Status, simulate

    found = resolve_machine(machine)
    parameters = {} if speed is None else {"drive.speed": speed}
    case = Case(fault=parse_fault(fault, found), parameters=parameters)
    settings = Settings(
        duration=duration,
        sample_rate=sample_rate,
        accuracy=accuracy or "standard",
        rtol=rtol,
        links=links,
        device=device,
    )
    history = simulate(found, case, settings)
    if history.status == Status.CANNOT_ASSEMBLE:
        raise UnassembledError(history.message)
    if history.status != Status.OK:
        raise SimulationFailedError(f"{found.name}: {history.status}: {history.message}")
    recording = record(found, history, settings, __version__)
    write(output, recording)
    if plot is not None:
        from app.plots import plot_simulation

        plot_simulation(recording, plot)
    report(history, recording, output, plot, as_json)


def report(history: History, recording: Recording, output: Path, plot: Path | None, as_json: bool) -> None:
    """Say what was computed and where it is."""
    from solver.spectrum import frame_units

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
            "step_s": history.step,
            "computing_s": history.seconds,
            "frame_acceleration_rms": None if rms is None else [float(value) for value in rms],
            "datasets": sorted(recording.arrays),
            "spectra_missing": recording.missing or None,
        }
        print_json(document)
        return
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
