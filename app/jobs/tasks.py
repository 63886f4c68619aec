"""What worker processes do: read recordings and diagnose them. What goes in and comes out can be pickled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointplay.app.jobs.samples import StoredRecording, keep, read
from jointplay.app.jobs.summaries import summary_of
from jointplay.app.problems import Problem, problem_of
from jointplay.app.storage.recording_files import read_bytes
from jointplay.app.storage.remembered import columns_key
from jointplay.app.storage.told import Told

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.diagnosing.past_recordings import InOrder
    from jointplay.catalogue.matching.modes import Effort, ModeAsked
    from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
    from jointplay.catalogue.measurements.measurement import Recording
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.simulation.account import Account


Progress = Callable[[int, int], None]
"""Is told the number of cases done and their total."""

BaselineFile = tuple[str, str, Told, Mapping[str, str] | None, float | None]
"""Path, name and what is told of a recording of a machine in order; sensors of its columns and its drive speed [rad/s]
where these were said of it."""

MOST = {"links": 64, "joints": 128, "sensors": 100}
"""Of what a machine may have how much: its check and its account then take some 15 s of a processor."""


@dataclass(frozen=True)
class DiagnosisTask:
    """What a recording is compared with, and how.

    Parameters
    ----------
    catalogue : str
        Folder of the catalogue.
    stamp : str
        Changes when the catalogue does, so that an open one is not used for longer than it is true.
    speeds : tuple of float or None
        Drive speed [rad/s] of each recording, None where it is not given; empty for those of a window of time.
    effort : str
        fast, standard or thorough.
    mode : str
        auto, trusted or robust.
    mapping : Mapping
        Column to sensor.
    prior : Mapping
        Numbers of :class:`~jointplay.catalogue.matching.prior.Prior`.
    baselines : tuple of BaselineFile
    limits_um : Mapping
        Its own limits by joint, in place of the machine's.
    """

    catalogue: str
    stamp: str
    speeds: tuple[float | None, ...]
    effort: Effort
    mode: ModeAsked
    mapping: Mapping[str, str]
    prior: Mapping[str, Any]
    baselines: tuple[BaselineFile, ...] = ()
    limits_um: Mapping[str, float] = field(default_factory=dict)


def summarise(path: str, name: str, told: Told, kept: StoredRecording | None = None) -> dict[str, Any]:
    """Read a recording, or a spectrum, and return what there is to say about it.

    Parameters
    ----------
    path : str
        Where its bytes lie.
    name : str
        What its sender calls it; its ending says how to read it.
    told : Told
        What its sender says of it.
    kept : StoredRecording, optional
        As what its samples are kept, to be looked at.
    """
    from jointplay.catalogue.measurements.measurement import Recording

    measured = read(path, name, told)
    if kept is not None and isinstance(measured, Recording):
        with suppress(OSError):  # then it is read again when somebody looks at it
            keep(kept, measured)
    return summary_of(measured, told)


def recall(path: str, name: str, told: Told, known: Sequence[tuple[str, Mapping[str, Any]]]) -> Mapping[str, Any]:
    """Return what was said of an earlier file with the same columns, where this one cannot be read without it.

    Parameters
    ----------
    path, name, told
        As for :func:`summarise`.
    known : sequence of (str, Mapping)
        What was said, by columns.
    """
    from jointplay.catalogue.errors import CatalogueError

    with suppress(CatalogueError):
        read(path, name, told)
        return {}
    for columns, said in known:
        with suppress(CatalogueError):
            found = read(path, name, Told(**said, measured_at=told.measured_at))
            if columns_key(channel.name for channel in found.channels) == columns:
                return said
    return {}


def diagnose(
    path: str,
    name: str,
    told: Told,
    question: DiagnosisTask,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose a recording.

    Parameters
    ----------
    path, name, told
        As for :func:`summarise`.
    question : DiagnosisTask
        What to compare it with, and how.
    progress : callable, optional
        Called with the number of cases done and their total, while some are simulated.
    """
    return diagnose_measured(read(path, name, told), question, progress)


def diagnose_together(
    recordings: Sequence[tuple[str, str, Told]], question: DiagnosisTask, progress: Progress | None = None
) -> Diagnosis:
    """Diagnose several recordings of one machine, each given by path, name and what is told of it."""
    from jointplay.catalogue.diagnosing.together import diagnose_together as ranked

    return ranked(
        [read(*each) for each in recordings],
        open_catalogue(question.catalogue, question.stamp),
        speeds=question.speeds or None,
        progress=progress,
        **_asked(question),
    )


def summarise_and_diagnose(
    path: str, name: str, told: Told, question: DiagnosisTask, progress: Progress | None = None
) -> tuple[dict[str, Any], Diagnosis]:
    """Do what :func:`summarise` and then :func:`diagnose` do, and read the recording once."""
    measurement = read(path, name, told)
    return summary_of(measurement, told), diagnose_measured(measurement, question, progress)


def diagnose_measured(
    measurement: Recording | MeasuredSpectrum, question: DiagnosisTask, progress: Progress | None = None
) -> Diagnosis:
    """Diagnose what was read."""
    from jointplay.catalogue.diagnosing.diagnosis import diagnose as ranked

    opened = open_catalogue(question.catalogue, question.stamp)
    (speed,) = question.speeds
    return ranked(measurement, opened, speed=speed, progress=progress, **_asked(question))


def _asked(question: DiagnosisTask) -> dict[str, Any]:
    """How one recording, or several, are to be diagnosed."""
    from jointplay.catalogue.matching.prior import Prior

    return {
        "effort": question.effort,
        "mode": question.mode,
        "mapping": question.mapping or None,
        "prior": Prior(**question.prior),
        "limits_um": question.limits_um,
        "baseline": list(map(in_order, question.baselines)),
    }


def check_machine(text: str, name: str) -> str:
    """Read a machine file and return it as canonical JSON; it is checked as ``jointplay check`` does.

    Parameters
    ----------
    text : str
        YAML or JSON.
    name : str
        What messages call it.

    Raises
    ------
    MachineError
        With the line of the file that it is about.
    """
    machine = parse_lines(text, name)
    account_for(machine, text)
    return machine.canonical_json()


@dataclass(frozen=True)
class MachineLook:
    """What a machine file looks like, right or wrong.

    Parameters
    ----------
    drawing : str
        SVG; empty where the file is not even a machine. Of one that cannot be assembled with its gap.
    account : dict or None
        As ``jointplay check --json`` prints it; None for a file that would be refused.
    refusal : Problem or None
        Why it would be.
    drive : str
        In a few words, with its speed.
    """

    drawing: str
    account: dict[str, Any] | None
    refusal: Problem | None
    drive: str = ""


def look_at_machine(text: str, name: str) -> MachineLook:
    """Read a machine file as :func:`check_machine` does, draw it, and tell what the program makes of it."""
    from jointplay.app.figures.machine_account import drive_of
    from jointplay.solver.errors import AssemblyError, SolverError
    from jointplay.solver.machines.drawing import machine_svg

    try:
        machine = parse_lines(text, name)
    except SolverError as error:
        return MachineLook("", None, problem_of(error))
    try:
        return MachineLook(machine_svg(machine), account_for(machine, text), None, drive_of(machine))
    except SolverError as error:
        gap = error.joint if isinstance(error, AssemblyError) else None
        return MachineLook(machine_svg(machine, open_joint=gap), None, problem_of(error))


def account_for(machine: Machine, text: str) -> dict[str, Any]:
    """Return what the program makes of a machine, if it can be assembled."""
    from jointplay.app.figures.machine_account import account_of
    from jointplay.solver.machines.fault import Fault

    sizes = sizes_of(machine, text)
    with lines_of(text):
        return account_of(machine, Fault({}), sizes, text=text)


def parse_lines(text: str, name: str) -> Machine:
    """Read a machine file; a refusal has its line. What is done with it next takes the longer the more it has."""
    from jointplay.solver.errors import MachineError
    from jointplay.solver.machines.machine import parse_machine

    with lines_of(text):
        machine = parse_machine(text, name)
        for field, most in MOST.items():
            count = len(getattr(machine, field))
            if count > most:
                raise MachineError(name, field, str(count), f"must be at most {most} in a machine sent to a service")
    return machine


def sizes_of(machine: Machine, text: str) -> Account:
    """Return the size of a machine that can be assembled; a refusal has its line."""
    from jointplay.solver.machines.fault import Fault
    from jointplay.solver.simulation.account import account
    from jointplay.solver.simulation.simulate import check_assembly

    with lines_of(text):
        sizes = account(machine, Fault({}))
        check_assembly(machine)
    return sizes


@contextmanager
def lines_of(text: str) -> Iterator[None]:
    """Add to refusals of a machine file in which line they are."""
    from jointplay.solver.errors import MachineError
    from jointplay.solver.machines.source_lines import line_of

    try:
        yield
    except MachineError as error:
        error.line = line_of(text, error.path)
        raise


def warm(catalogues: Sequence[tuple[str, str]]) -> int:
    """Load what diagnosing needs, and the models last fitted to some catalogues; return how many models those are.

    Parameters
    ----------
    catalogues : sequence of (str, str)
        Folders and stamps, as in :class:`DiagnosisTask`.
    """
    import jointplay.app.schemas.signals
    import jointplay.catalogue.diagnosing.diagnosis
    import jointplay.catalogue.measurements.measured_spectrum
    import jointplay.catalogue.signals.shown_views  # noqa: F401, loaded to be there when it is needed
    from jointplay.catalogue.errors import CatalogueError
    from jointplay.catalogue.matching.model_library import CATALOGUES, library_of

    loaded = 0
    for directory, stamp in catalogues[:CATALOGUES]:
        with suppress(CatalogueError):  # whoever asks for it is told
            loaded += library_of(open_catalogue(directory, stamp)).load()
    return loaded


def in_order(baseline: BaselineFile) -> InOrder:
    """Read a baseline, which has to be a recording over time."""
    from jointplay.catalogue.diagnosing.past_recordings import InOrder
    from jointplay.catalogue.measurements.measurement import read_measurement

    path, name, told, mapping, speed = baseline
    recording = read_measurement(
        read_bytes(path),
        name=name,
        sample_rate=told.sample_rate_hz,
        units=told.units or None,
        profile=told.import_profile,
    )
    return InOrder(recording, mapping, speed)


@lru_cache(maxsize=4)
def open_catalogue(directory: str, stamp: str) -> Catalogue:
    """Return an open catalogue; a worker keeps the last few it used."""
    from jointplay.catalogue.storage.store import Catalogue

    return Catalogue.open(Path(directory))
