"""Who may change a catalogue at the same time: many builders together, or one process alone."""

from __future__ import annotations

import os
import sys
import time
from types import TracebackType
from typing import Self

from filelock import FileLock, Timeout

from jointplay.catalogue.errors import CatalogueBusyError, CatalogueFileError
from jointplay.catalogue.storage.directory import CatalogueDirectory

WAIT = 60.0
"""Longest wait for another process that prepares, verifies or repairs [s]."""

_POLL = 0.05


class BuilderLock:
    """A builder's part of the lock of a catalogue: alone at first if nobody else is there, later shared.

    It is the lock that :meth:`CatalogueDirectory.locked` holds alone, and it ends with the process, however that ends.
    Where files cannot be locked in common (Windows), a builder stays alone, and a second one is refused.

    Parameters
    ----------
    directory : CatalogueDirectory
    wait : float, optional
        Longest wait for a process that is alone there [s]; :data:`WAIT` by default.

    Attributes
    ----------
    alone : bool
        Whether no other process builds or verifies.

    Raises
    ------
    CatalogueBusyError
        Another process was alone there all the time.
    CatalogueFileError
        The lock file cannot be made.
    """

    def __init__(self, directory: CatalogueDirectory, wait: float | None = None) -> None:
        self._root, self._path = directory.root, directory.lock
        self._descriptor = -1
        self._exclusive: FileLock | None = None
        self.alone = False
        try:
            self._acquire(WAIT if wait is None else wait)
        except OSError as error:
            self.release()
            raise CatalogueFileError(self._path, f"cannot be locked ({error.strerror or error})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def share(self) -> None:
        """Let other builders in.

        Systems may give the lock up before they share it: a process that waits to be alone can have it in between, and
        what was read of the catalogue until now may hold no more.
        """
        if sys.platform != "win32" and self._descriptor >= 0:
            self.alone = False
            _flock(self._descriptor, alone=False, wait=True)

    def release(self) -> None:
        """End it."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
        if self._exclusive is not None:
            self._exclusive.release()
            self._exclusive = None
        self.alone = False

    def _acquire(self, wait: float) -> None:
        if sys.platform == "win32":
            self._exclusive = FileLock(self._path)
            try:
                self._exclusive.acquire(timeout=0)
            except Timeout as error:
                raise CatalogueBusyError(self._root) from error
            self.alone = True
            return
        self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        end = time.monotonic() + wait
        while True:
            if _flock(self._descriptor, alone=True, wait=False):
                self.alone = True
                return
            if _flock(self._descriptor, alone=False, wait=False):
                return
            if time.monotonic() >= end:
                self.release()
                raise CatalogueBusyError(self._root)
            time.sleep(_POLL)


def _flock(descriptor: int, *, alone: bool, wait: bool) -> bool:
    """Whether the lock was given; asking for the other kind gives the present one up."""
    if sys.platform == "win32":
        return False
    import fcntl

    kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
    try:
        fcntl.flock(descriptor, kind if wait else kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
