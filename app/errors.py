"""Exceptions of the outside layer: requests and command lines that cannot be met."""

from __future__ import annotations

from typing import ClassVar


class AppError(Exception):
    """Root of everything this layer raises on purpose; ``str()`` is one plain line.

    Parameters
    ----------
    message : str
        The line shown to the user.
    field : str, optional
        Name of the option or form field at fault, where there is one.
    """

    def __init__(self, message: str, *, field: str = "") -> None:
        super().__init__(message)
        self.field = field


class UnknownMachineError(AppError):
    """No machine has this name."""


class UnknownCatalogueError(AppError):
    """No catalogue has this id or name."""


class UnknownMeasurementError(AppError):
    """No stored measurement has this id."""


class RecordingMissingError(AppError):
    """A stored recording whose file is not there."""


class RecordingDamagedError(AppError):
    """A stored recording whose file is not what was stored."""


class DamagedRowError(AppError):
    """A row of the database that is not what was stored.

    Parameters
    ----------
    message : str
    number : int
        Its place in the table.
    """

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.number = number

    def __reduce__(self) -> tuple[type[DamagedRowError], tuple[str, int]]:
        return DamagedRowError, (str(self), self.number)


class DeletedError(AppError):
    """Something that was here once and was deleted."""


class InUseError(AppError):
    """Something that may not be deleted as long as something else needs it."""


class QuotaError(AppError):
    """A recording that is more than a key, or all of them together, may store."""


class UnknownDiagnosisError(AppError):
    """No stored diagnosis has this id."""


class UnknownBuildError(AppError):
    """No build has this id."""


class BuildEndedError(AppError):
    """A build that has ended already, and cannot be cancelled."""


class BuildOpenError(AppError):
    """A build that has not ended, and cannot be begun again."""


class UnknownAssetError(AppError):
    """No asset has this external id."""


class NothingToFollowError(AppError):
    """An asset none of whose recordings was diagnosed."""


class UnknownFindingError(AppError):
    """No stored finding has this id."""


class UnknownWebhookError(AppError):
    """No webhook has this id."""


class UnknownDeliveryError(AppError):
    """A webhook has no delivery of this id."""


class WebhookDisabledError(AppError):
    """A webhook that was given up, and is told nothing."""


class UnknownPageError(AppError):
    """No page of the web form has this address."""


class BadRequestError(AppError):
    """A request whose body or query cannot be read at all."""


class BadFieldError(AppError):
    """A readable request with a field that breaks a rule."""


class BadCursorError(AppError):
    """A page cursor that this service did not hand out."""


class UploadTooLargeError(AppError):
    """A request body over the size limit."""


class ShippedMachineError(AppError):
    """A machine under the name of one that ships with the program."""


class PreconditionError(AppError):
    """A condition of the request (``If-Match``, ``If-None-Match``) that does not hold."""


class KeyReusedError(AppError):
    """An ``Idempotency-Key`` that was used for another request."""


class KeyInUseError(AppError):
    """An ``Idempotency-Key`` whose first request is not answered yet."""

    headers: ClassVar = {"Retry-After": "2"}


class NotAcceptableError(AppError):
    """A client that takes none of the forms there are."""


class UnsupportedMediaError(AppError):
    """A request body of a type that this address does not take."""


class BusyError(AppError):
    """Too many requests wait for a worker already."""


class DatabaseGoneError(AppError):
    """The service's database does not answer."""


class DamagedDatabaseError(AppError):
    """The service's database, or a row of it, cannot be read."""


class StorageFullError(AppError):
    """A disk of the service, or of its database, is full."""


class TimeLimitError(AppError):
    """A computation took longer than the time limit.

    Parameters
    ----------
    message : str
    seconds : int, optional
        Time until it may be done, where it goes on.
    """

    def __init__(self, message: str, seconds: int | None = None) -> None:
        super().__init__(message)
        self.headers = {} if seconds is None else {"Retry-After": str(seconds)}


class WorkerDiedError(AppError):
    """A worker process ended before it answered, for instance for want of memory."""


class ClientGoneError(AppError):
    """A client that went before its answer was made."""


class UnauthorizedError(AppError):
    """A request without a key that holds."""

    headers: ClassVar = {"WWW-Authenticate": 'Bearer realm="jointplay"'}


class ForbiddenError(AppError):
    """A request that its key does not allow, or that a page of another site made a browser send.

    Parameters
    ----------
    message : str
    scope : str, optional
        The scope that would be needed.
    """

    def __init__(self, message: str, scope: str = "") -> None:
        super().__init__(message)
        wanted = f'Bearer realm="jointplay", error="insufficient_scope", scope="{scope}"'
        self.headers = {"WWW-Authenticate": wanted} if scope else {}


class UnknownKeyError(AppError):
    """No API key has this id."""


class KeyRevokedError(AppError):
    """An API key that was taken back, and gets no new secret."""


class RateLimitedError(AppError):
    """A client that asks too often.

    Parameters
    ----------
    message : str
    seconds : int
        Time until it may ask again.
    """

    def __init__(self, message: str, seconds: int) -> None:
        super().__init__(message)
        self.headers = {"Retry-After": str(seconds)}


class WrongHostError(AppError):
    """A request that names a host which this service is not."""


class SlowRequestError(AppError):
    """A request whose body does not arrive."""


class OverdueError(AppError):
    """A request that was not answered in time."""


class NotReadyError(AppError):
    """Something that this service needs does not answer."""


class OutputError(AppError):
    """A result that cannot be written to the named file in the named format."""


class BackupError(AppError):
    """A backup that cannot be made or brought back; nothing that was there before has been changed."""


class DamagedBackupError(AppError):
    """A backup that lacks something, because that is damaged where it was copied from, or in the backup itself."""


class AddressError(AppError):
    """An address that the service cannot listen at."""


class UnassembledError(AppError):
    """A simulation of a machine, or of a fault, that cannot be assembled."""


class SimulationFailedError(AppError):
    """A simulation that ended with another status than ok."""


class IncompleteBuildError(AppError):
    """A build that had to leave cases out."""


class RefusedFilesError(AppError):
    """Some of many files could not be used; the others were."""


class DamageError(AppError):
    """A check of what a service keeps that found damage."""


class DamagedCatalogueError(AppError):
    """A catalogue check that found damage it could not repair."""
