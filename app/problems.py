"""Problem documents (RFC 9457): the one table from exceptions to answers, for HTTP and for exit statuses.

The packages below raise what is wrong in their own words and know nothing of HTTP. Each class of
their trees has its own row here; a test walks the trees, so that a new class cannot be forgotten. Failures of what the
service stands on, disk and database, are told apart from its own: they pass without a repair.
"""

from __future__ import annotations

import errno
import sqlite3
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

from jointplay.app import errors
from jointplay.app.errors import AppError, DamagedDatabaseError, DatabaseGoneError, StorageFullError
from jointplay.app.fields import say_cure
from jointplay.catalogue import errors as catalogue_errors
from jointplay.solver import errors as solver_errors

MEDIA_TYPE = "application/problem+json"
PLAIN_TYPE = "about:blank"


@dataclass(frozen=True)
class ProblemKind:
    """What a class of exception is called outside.

    Parameters
    ----------
    status : int
        HTTP status.
    slug : str
        Last part of the problem's type.
    title : str
        Short summary, the same for every occurrence.
    exit_status : int, optional
        Of the command line; by default 2 (bad input) for a status below 500 and 1 (a failure) from there on.
    """

    status: int
    slug: str
    title: str
    exit_status: int | None = None


@dataclass(frozen=True)
class Problem:
    """One answer that tells what was wrong; it can be sent between processes."""

    status: int
    type: str
    title: str
    detail: str
    errors: tuple[Mapping[str, Any], ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)

    def document(self, instance: str) -> dict[str, Any]:
        """Return the members of the JSON document.

        Parameters
        ----------
        instance : str
            Path of the request.
        """
        members: dict[str, Any] = {
            "type": self.type,
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            "instance": instance,
        }
        if self.errors:
            members["errors"] = [dict(entry) for entry in self.errors]
        return members


TABLE: dict[type[Exception], ProblemKind] = {
    errors.AppError: ProblemKind(500, "failure", "The service failed"),
    errors.UnknownMachineError: ProblemKind(404, "unknown-machine", "No such machine"),
    errors.UnknownCatalogueError: ProblemKind(404, "unknown-catalogue", "No such catalogue"),
    errors.UnknownMeasurementError: ProblemKind(404, "unknown-measurement", "No such measurement"),
    errors.RecordingMissingError: ProblemKind(
        409, "recording-missing", "The recording's file is missing", exit_status=1
    ),
    errors.RecordingDamagedError: ProblemKind(
        409, "recording-damaged", "The recording is not what was stored", exit_status=1
    ),
    errors.DamagedRowError: ProblemKind(409, "row-damaged", "A row is not what was stored", exit_status=1),
    errors.DeletedError: ProblemKind(410, "deleted", "It was deleted"),
    errors.InUseError: ProblemKind(409, "in-use", "Something else needs it"),
    errors.QuotaError: ProblemKind(507, "quota", "More than may be stored"),
    errors.UnknownDiagnosisError: ProblemKind(404, "unknown-diagnosis", "No such diagnosis"),
    errors.UnknownBuildError: ProblemKind(404, "unknown-build", "No such build"),
    errors.BuildEndedError: ProblemKind(409, "build-ended", "The build has ended already"),
    errors.BuildOpenError: ProblemKind(409, "build-open", "The build has not ended"),
    errors.UnknownAssetError: ProblemKind(404, "unknown-asset", "No such asset"),
    errors.NothingToFollowError: ProblemKind(404, "nothing-to-follow", "Nothing to follow yet"),
    errors.UnknownFindingError: ProblemKind(404, "unknown-finding", "No such finding"),
    errors.UnknownWebhookError: ProblemKind(404, "unknown-webhook", "No such webhook"),
    errors.UnknownDeliveryError: ProblemKind(404, "unknown-delivery", "No such delivery"),
    errors.WebhookDisabledError: ProblemKind(409, "webhook-disabled", "The webhook is disabled"),
    errors.UnknownPageError: ProblemKind(404, "unknown-page", "No such page"),
    errors.BadRequestError: ProblemKind(400, "unreadable-request", "The request cannot be read"),
    errors.BadFieldError: ProblemKind(422, "invalid-field", "A field breaks a rule"),
    errors.BadCursorError: ProblemKind(400, "invalid-cursor", "The page cursor is not valid"),
    errors.UploadTooLargeError: ProblemKind(413, "too-large", "The upload is too large"),
    errors.ShippedMachineError: ProblemKind(409, "shipped-machine", "The machine ships with the program"),
    errors.PreconditionError: ProblemKind(412, "precondition", "A condition of the request does not hold"),
    errors.KeyReusedError: ProblemKind(422, "idempotency-key-reused", "The key was used for another request"),
    errors.KeyInUseError: ProblemKind(
        409, "idempotency-key-in-use", "The first request with this key is not answered yet"
    ),
    errors.NotAcceptableError: ProblemKind(406, "not-acceptable", "No form that the client takes"),
    errors.UnsupportedMediaError: ProblemKind(415, "unsupported-media", "This type of body is not taken here"),
    errors.BusyError: ProblemKind(503, "busy", "All workers are busy"),
    errors.DatabaseGoneError: ProblemKind(503, "database-gone", "The database does not answer"),
    errors.DamagedDatabaseError: ProblemKind(500, "damaged-database", "The database is damaged"),
    errors.StorageFullError: ProblemKind(507, "storage-full", "There is no space left"),
    errors.TimeLimitError: ProblemKind(504, "time-limit", "The computation took too long"),
    errors.WorkerDiedError: ProblemKind(500, "worker-died", "A worker process ended early"),
    errors.ClientGoneError: ProblemKind(499, "client-gone", "The client has gone"),
    errors.UnauthorizedError: ProblemKind(401, "unauthorized", "A key is needed"),
    errors.ForbiddenError: ProblemKind(403, "forbidden", "This is not allowed"),
    errors.UnknownKeyError: ProblemKind(404, "unknown-key", "No such key"),
    errors.KeyRevokedError: ProblemKind(409, "key-revoked", "The key was revoked"),
    errors.RateLimitedError: ProblemKind(429, "too-many-requests", "Too many requests"),
    errors.WrongHostError: ProblemKind(421, "wrong-host", "This service has another name"),
    errors.SlowRequestError: ProblemKind(408, "slow-request", "The request did not arrive"),
    errors.OverdueError: ProblemKind(503, "overdue", "The answer took too long"),
    errors.NotReadyError: ProblemKind(503, "not-ready", "The service is not ready"),
    errors.OutputError: ProblemKind(422, "output", "The result cannot be written"),
    errors.BackupError: ProblemKind(422, "backup", "The backup cannot be made or brought back"),
    errors.DamagedBackupError: ProblemKind(500, "damaged-backup", "Something in the backup is damaged"),
    errors.AddressError: ProblemKind(500, "address", "The address cannot be used"),
    errors.UnassembledError: ProblemKind(422, "unassembled", "The machine cannot be assembled"),
    errors.SimulationFailedError: ProblemKind(500, "simulation-failed", "The simulation did not succeed"),
    errors.IncompleteBuildError: ProblemKind(500, "incomplete-build", "The catalogue is not complete"),
    errors.RefusedFilesError: ProblemKind(422, "refused-files", "Some files cannot be used", exit_status=1),
    errors.DamageError: ProblemKind(500, "damage", "What is kept is damaged"),
    errors.DamagedCatalogueError: ProblemKind(500, "damaged-catalogue", "The catalogue is damaged"),
    solver_errors.SolverError: ProblemKind(500, "solver", "The solver failed"),
    solver_errors.MachineError: ProblemKind(422, "machine", "The machine or fault breaks a rule"),
    solver_errors.AssemblyError: ProblemKind(422, "assembly", "The machine cannot be assembled"),
    solver_errors.SettingsError: ProblemKind(422, "settings", "The settings cannot be met"),
    solver_errors.UnitError: ProblemKind(422, "unit", "A number or its unit cannot be read"),
    catalogue_errors.CatalogueError: ProblemKind(500, "catalogue", "The catalogue failed"),
    catalogue_errors.PlanError: ProblemKind(422, "plan", "The plan breaks a rule"),
    catalogue_errors.KeyContentError: ProblemKind(422, "key-content", "A value has no canonical form"),
    catalogue_errors.CatalogueFileError: ProblemKind(500, "catalogue-file", "A file of the catalogue cannot be used"),
    catalogue_errors.CatalogueMismatchError: ProblemKind(
        409, "catalogue-mismatch", "The catalogue is of something else"
    ),
    catalogue_errors.CatalogueBusyError: ProblemKind(
        409, "catalogue-busy", "The catalogue is being built", exit_status=1
    ),
    catalogue_errors.BuildError: ProblemKind(500, "build", "The catalogue could not be built"),
    catalogue_errors.SchedulerAddressError: ProblemKind(422, "scheduler-address", "This is no address of a scheduler"),
    catalogue_errors.MeasurementError: ProblemKind(422, "measurement", "The measurement cannot be used"),
    catalogue_errors.EntryNotFoundError: ProblemKind(404, "unknown-entry", "No such entry"),
    catalogue_errors.MatchingError: ProblemKind(422, "matching", "The draws or features cannot be matched"),
    catalogue_errors.DiagnosisError: ProblemKind(422, "diagnosis", "The measurement cannot be diagnosed"),
}


def kind_of(error: BaseException) -> ProblemKind | None:
    """Return the row of an exception's class or of the nearest class it derives from; ``None`` if there is none."""
    for cls in type(error).__mro__:
        if cls in TABLE:
            return TABLE[cls]
    return None


def type_of(slug: str) -> str:
    """Return the problem type (a URI) of a slug."""
    return f"urn:jointplay:problem:{slug}"


def problem_of(error: Exception) -> Problem:
    """Return the answer to an exception of any of the three trees; any other becomes a plain 500 without its text."""
    kind = kind_of(error)
    if kind is None or kind.status == HTTPStatus.INTERNAL_SERVER_ERROR:
        named_so = foreseen(error)
        if named_so is not None:
            error, kind = named_so, kind_of(named_so)
    if kind is None:
        return of_status(500, "The service failed in a way it did not foresee; the log has the details.")
    headers = {"Retry-After": "5"} if kind.status == HTTPStatus.SERVICE_UNAVAILABLE else {}
    headers |= getattr(error, "headers", {})
    named = error.path if isinstance(error, solver_errors.MachineError) else getattr(error, "field", "")
    line = getattr(error, "line", None)
    said, place = one_line(say(error)), {"field": named} | ({} if line is None else {"line": line})
    entries = ({**place, "message": said},) if named or line else ()
    return Problem(kind.status, type_of(kind.slug), kind.title, said, entries, headers)


def say(error: Exception) -> str:
    """Return what an exception says; of a recording, with the option and the entry of a form that puts it right."""
    return str(error) + (say_cure(error.field) if isinstance(error, catalogue_errors.MeasurementError) else "")


def of_status(status: int, detail: str = "", headers: Mapping[str, str] | None = None) -> Problem:
    """Return the answer for a bare HTTP status (no such route, method not allowed ...)."""
    title = HTTPStatus(status).phrase
    return Problem(status, PLAIN_TYPE, title, detail or f"{title}.", headers=dict(headers or {}))


def of_validation(entries: list[dict[str, Any]]) -> Problem:
    """Return the 422 for pydantic's list of errors.

    Parameters
    ----------
    entries : list of dict
        With ``loc`` and ``msg``, as pydantic gives them.
    """
    listed = tuple(
        {
            "field": ".".join(str(part) for part in entry["loc"] if part != "body") or ".".join(entry["loc"]),
            "message": str(entry["msg"]).removeprefix("Value error, "),  # of our own validators: no words of theirs
        }
        for entry in entries
    )
    detail = "; ".join(
        f"{entry['field']}: {entry['message']}" if entry["field"] else entry["message"] for entry in listed
    )
    return Problem(422, type_of("invalid-field"), "A field breaks a rule", one_line(detail), listed)


def exit_status(error: Exception) -> int:
    """Return the exit status of the command line: 2 for bad input, 1 for a failure."""
    kind = kind_of(error)
    if kind is None:
        return 1
    if kind.exit_status is not None:
        return kind.exit_status
    return 2 if kind.status < HTTPStatus.INTERNAL_SERVER_ERROR else 1


def one_line(text: str) -> str:
    """Return a message as one line of characters that can be sent, whatever a library or a request put into it."""
    return " ".join(text.encode("utf-8", "backslashreplace").decode().split())


FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
POSTGRES_FULL = "53100"


def foreseen(error: BaseException) -> AppError | None:
    """Return what is wrong with disk or database, where that is why an exception was raised; else ``None``."""
    chain = list(causes(error))
    if any(is_full(each) for each in chain):
        return StorageFullError("there is no space left on a disk of the service; nothing of this was stored")
    if any(is_damaged(each) for each in chain):
        return DamagedDatabaseError("the database of the service is damaged; bring a backup of it back")
    if any(is_gone(each) for each in chain):
        return DatabaseGoneError("the database of the service does not answer; try again in a few seconds")
    return None


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """Give an exception and those it was raised from, a driver's among them."""
    while error is not None:
        yield error
        driver = getattr(error, "orig", None)
        if isinstance(driver, BaseException):
            yield driver
        error = error.__cause__


def is_full(error: BaseException) -> bool:
    """Return whether a disk or a quota is full, this computer's or the database's."""
    if isinstance(error, OSError):
        return error.errno in FULL
    if isinstance(error, sqlite3.Error):
        return getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return getattr(error, "sqlstate", None) == POSTGRES_FULL


def is_damaged(error: BaseException) -> bool:
    """Return whether a file of SQLite says of itself that it is none, or not whole."""
    code = getattr(error, "sqlite_errorcode", 0) if isinstance(error, sqlite3.Error) else 0
    return code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def is_gone(error: BaseException) -> bool:
    """Return whether a database cannot be reached, or is held by others for too long."""
    if "sqlalchemy" not in sys.modules:  # the command line does without it
        return False
    from sqlalchemy import exc

    return isinstance(error, exc.OperationalError | exc.InterfaceError | exc.TimeoutError | exc.DisconnectionError)
