"""Failures of what the service stands on, disk and database, told apart from its own: they pass without a repair."""

from __future__ import annotations

import errno
import sqlite3
import sys
from collections.abc import Iterator

from jointplay.app.errors import AppError, DatabaseGoneError, StorageFullError

FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
POSTGRES_FULL = "53100"


def foreseen(error: BaseException) -> AppError | None:
    """Return what is wrong with disk or database, where that is why an exception was raised; else ``None``."""
    chain = list(causes(error))
    if any(is_full(each) for each in chain):
        return StorageFullError("there is no space left on a disk of the service; nothing of this was stored")
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


def is_gone(error: BaseException) -> bool:
    """Return whether a database cannot be reached, or is held by others for too long."""
    if "sqlalchemy" not in sys.modules:  # the command line does without it
        return False
    from sqlalchemy import exc

    return isinstance(error, exc.OperationalError | exc.InterfaceError | exc.TimeoutError | exc.DisconnectionError)
