"""Verifying a diagnosis: whether what it was made of is still the same, and whether it comes out the same again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from jointplay.app.errors import (
    DamagedCatalogueError,
    DeletedError,
    RecordingDamagedError,
    RecordingMissingError,
    UnknownCatalogueError,
    UnknownMeasurementError,
)
from jointplay.app.jobs import tasks
from jointplay.app.speeds import speeds_of
from jointplay.app.storage.recording_files import check_file
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.storage.store import Store
from jointplay.app.storage.told import Told

ROUNDING = 1e-6
"""Numbers that differ by less than this, relative to the larger, are the same by another processor's arithmetic."""

SMALLEST = 1e-9
"""Below this a number is taken for zero by another processor's arithmetic."""

MOST_SHOWN = 20

VERSIONED = frozenset({"id", "hash", "provenance.solver_version", "provenance.matcher.version"})
"""Members that tell versions of the program; they are told by themselves."""

Outcome = Literal["equal", "rounding", "differs", "not_repeated"]
RecordingState = Literal["sound", "damaged", "missing", "deleted"]
CatalogueState = Literal["same", "other", "damaged", "missing", "deleted"]
"""Missing is what nobody has deleted, and is not there all the same."""

Recorded = tuple[tuple[str, str, Told], ...]
"""Path, name and what is told of recordings."""


@dataclass(frozen=True)
class Evidence:
    """A recording that a diagnosis was made of.

    Parameters
    ----------
    measurement, sha256 : str
    state : RecordingState
    said : str
        What is wrong; empty where nothing is.
    """

    measurement: str
    sha256: str
    state: RecordingState
    said: str = ""


@dataclass(frozen=True)
class Difference:
    """A member that is another one now.

    Parameters
    ----------
    member : str
        Its path: "joints.B.clearance_um".
    then, now : JSON values
    """

    member: str
    then: Any
    now: Any


@dataclass(frozen=True)
class Repetition:
    """An answer that was made again.

    Parameters
    ----------
    outcome : Outcome
    differences : tuple of Difference
        The first of those that are not rounding.
    said : str
        Why it was not repeated.
    solver, matcher : str, optional
        Versions that it was made again with.
    """

    outcome: Outcome
    differences: tuple[Difference, ...] = ()
    said: str = ""
    solver: str | None = None
    matcher: str | None = None


@dataclass(frozen=True)
class Again:
    """What is needed to make an answer again, beside what it was; it can be sent to a worker."""

    then: Mapping[str, Any]
    recordings: Recorded
    question: tasks.DiagnosisTask


def evidence_of(store: Store, keys: tuple[str, ...]) -> tuple[list[MeasurementRow], list[Evidence]]:
    """Return measurements that are sound, and how all of them are.

    Raises
    ------
    DamagedRowError
        A row of one of them is not what was written.
    """
    rows, found = [], []
    for key in keys:
        try:
            row = store.measurement(key)
        except DeletedError as error:
            found.append(Evidence(key, "", "deleted", str(error)))
            continue
        except UnknownMeasurementError as error:
            found.append(Evidence(key, "", "missing", str(error)))
            continue
        try:
            for _ in check_file(store.path_of(row.sha256)):
                pass
        except RecordingMissingError as error:
            found.append(Evidence(key, row.sha256, "missing", str(error)))
        except RecordingDamagedError as error:
            found.append(Evidence(key, row.sha256, "damaged", str(error)))
        else:
            rows.append(row)
            found.append(Evidence(key, row.sha256, "sound"))
    return rows, found


def baselines_of(store: Store, row: DiagnosisRow) -> tuple[str, ...]:
    """Return the ids of the baselines that a diagnosis was made with.

    Of one that was made before they were noted with it, those of its asset with the same bytes.
    """
    if "baselines" in row.request:
        return tuple(row.request["baselines"])
    shown = row.answer.baseline
    if shown is None or not row.request.get("asset"):
        return ()
    from jointplay.app.storage.assets import measurements_of

    known = {each.sha256: each.id for each in store.measurements(None, 100_000, measurements_of(row.request["asset"]))}
    wanted = [shown.measurement_sha256, *(each.measurement_sha256 for each in shown.further)]
    return tuple(known.get(sha256, sha256[:32]) for sha256 in wanted)


@dataclass(frozen=True)
class Checked:
    """What a diagnosis was made of, and what is needed to make it again.

    Parameters
    ----------
    recordings, baselines : list of Evidence
    catalogue : CatalogueState
        Whether the catalogue of its name is the one that it was made with.
    again : Again or None
    said : str
        Why it cannot be made again; empty where it can.
    """

    recordings: list[Evidence]
    baselines: list[Evidence]
    catalogue: CatalogueState
    again: Again | None
    said: str = ""

    @property
    def is_damaged(self) -> bool:
        """Whether something is damaged, or gone without anybody having deleted it."""
        states = {self.catalogue, *(each.state for each in (*self.recordings, *self.baselines))}
        return not states.isdisjoint({"damaged", "missing"})


def check(store: Store, row: DiagnosisRow, find: Callable[[str], tuple[str, tuple[str, str]]]) -> Checked:
    """Check what a diagnosis was made of.

    Parameters
    ----------
    store : Store
    row : DiagnosisRow
    find : callable
        Gives id, and folder and stamp, of the catalogue that has a name now, or raises why there is none.

    Raises
    ------
    DamagedRowError
        A row of one of its recordings is not what was written.
    """
    measured, recordings = evidence_of(store, row.measurements)
    compared, baselines = evidence_of(store, baselines_of(store, row))
    bad = [each for each in (*recordings, *baselines) if each.state != "sound"]
    try:
        identity, place = find(row.answer.catalogue)
    except UnknownCatalogueError:
        return Checked(recordings, baselines, "missing", None, f"catalogue {row.answer.catalogue}: is not here")
    except DeletedError as error:
        return Checked(recordings, baselines, "deleted", None, str(error))
    except DamagedCatalogueError as error:
        return Checked(recordings, baselines, "damaged", None, str(error))
    if identity != row.catalogue:
        said = f"catalogue {row.answer.catalogue}: has another content now"
        return Checked(recordings, baselines, "other", None, said)
    if bad:
        return Checked(recordings, baselines, "same", None, bad[0].said)
    return Checked(recordings, baselines, "same", again(store, row, measured, compared, place))


def again(
    store: Store,
    row: DiagnosisRow,
    recordings: list[MeasurementRow],
    baselines: list[MeasurementRow],
    place: tuple[str, str],
) -> Again:
    """Return what is needed to make an answer again.

    Parameters
    ----------
    store : Store
    row : DiagnosisRow
    recordings, baselines : list of MeasurementRow
        All of them.
    place : (str, str)
        Folder and stamp of the catalogue.
    """
    asked = row.request

    def files(rows: list[MeasurementRow]) -> Recorded:
        return tuple((str(store.path_of(each.sha256)), each.name, each.told) for each in rows)

    # Limits are those of then: the asset may have others by now, and something else be said of its baselines.
    read = asked.get("baselines_read") or [{"mapping": None, "speed": None}] * len(baselines)
    question = tasks.DiagnosisTask(
        *(*place, speeds_of(asked), asked["effort"], asked["mode"], asked["mapping"], asked["prior"]),
        tuple((*file, own["mapping"], own["speed"]) for file, own in zip(files(baselines), read, strict=True)),
        limits_um=asked.get("limits_um", {}),
    )
    return Again(row.answer.model_dump(mode="json"), files(recordings), question)


def repeat(
    then: Mapping[str, Any], recordings: Recorded, question: tasks.DiagnosisTask, progress: tasks.Progress | None = None
) -> Repetition:
    """Make an answer again, and compare.

    Parameters
    ----------
    then, recordings, question
        Of :class:`Again`.
    progress : callable, optional
        As for :func:`~jointplay.app.jobs.tasks.diagnose`.
    """
    if len(recordings) == 1 and not then["recordings"]:
        found = tasks.diagnose(*recordings[0], question, progress)
    else:
        found = tasks.diagnose_together(recordings, question, progress)
    return compare(then, found.model_dump(mode="json"))


def compare(then: Mapping[str, Any], now: Mapping[str, Any]) -> Repetition:
    """Return how an answer differs from one that was given before; versions of the program are left out."""
    found = [each for each in differences("", then, now) if each.member not in VERSIONED]
    real = [each for each in found if not is_rounding(each.then, each.now)]
    outcome: Outcome = "differs" if real else "rounding" if found else "equal"
    made = now["provenance"]
    return Repetition(
        outcome, tuple(real[:MOST_SHOWN]), solver=made["solver_version"], matcher=made["matcher"]["version"]
    )


def differences(path: str, then: Any, now: Any) -> Iterator[Difference]:
    """Give the members that are not the same bit for bit."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for name in sorted(then.keys() | now.keys()):
            below = f"{path}.{name}" if path else str(name)
            yield from differences(below, then.get(name), now.get(name))
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for place, pair in enumerate(zip(then, now, strict=True)):
            yield from differences(f"{path}[{place}]", *pair)
    elif then != now:
        yield Difference(path, then, now)


def is_rounding(then: Any, now: Any) -> bool:
    """Return whether two values are numbers that another processor's arithmetic may have made of each other."""
    if not all(isinstance(each, int | float) and not isinstance(each, bool) for each in (then, now)):
        return False
    return bool(abs(then - now) <= max(ROUNDING * max(abs(then), abs(now)), SMALLEST))
