"""Recordings on their way in: copied below the folder of data, and named by their content when they are stored."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from jointplay.app.errors import AppError
from jointplay.app.storage.stored_files import PARTIAL, RECORDINGS, StoredFiles, recording_path
from jointplay.catalogue.storage.directory import sync_folder


@dataclass(frozen=True)
class Upload:
    """A file on its way in.

    Parameters
    ----------
    path : Path
        Where its bytes lie.
    sha256 : str
        Of the bytes.
    size : int
        Number of bytes.
    """

    path: Path
    sha256: str
    size: int


class Uploads:
    """Where uploads go.

    Parameters
    ----------
    directory : Path
        The folder of data; what it lacks is made.
    files : StoredFiles
        What lies in it.
    """

    def __init__(self, directory: Path, files: StoredFiles) -> None:
        self._directory, self._files = directory, files
        self._folder = directory / RECORDINGS
        self._folder.mkdir(parents=True, exist_ok=True)

    def try_writing(self) -> None:
        """Write a file where uploads go, and delete it.

        Raises
        ------
        OSError
            When that cannot be done.
        """
        with tempfile.NamedTemporaryFile(dir=self._folder, prefix=PARTIAL) as attempt:
            attempt.write(b"?")
            attempt.flush()

    def receive(self, source: BinaryIO) -> Upload:
        """Copy an upload below the directory, to the disk, and return where it is.

        The copy is this upload's own until it becomes a measurement. Each is to be settled once.
        """
        digest = hashlib.sha256()
        size = 0
        with tempfile.NamedTemporaryFile(dir=self._folder, prefix=PARTIAL, delete=False) as partial:
            try:
                while block := source.read(1 << 20):
                    digest.update(block)
                    size += len(block)
                    partial.write(block)
                partial.flush()
                os.fsync(partial.fileno())
            except BaseException:
                Path(partial.name).unlink(missing_ok=True)
                raise
        return Upload(Path(partial.name), digest.hexdigest(), size)

    @contextmanager
    def named(self, upload: Upload) -> Iterator[None]:
        """Give an upload the name of its content for a transaction; it goes again where that is refused."""
        self._name(upload)
        try:
            yield
        except AppError:
            self._files.drop([upload.sha256])
            raise

    def _name(self, upload: Upload) -> None:
        """Give an upload the name of its content, to the disk, before a row says that it is there.

        Bytes whose row cannot be committed stay for a while: another server may be about to store the same.
        """
        target = recording_path(self._directory, upload.sha256)
        target.parent.mkdir(exist_ok=True)
        sync_folder(self._folder)
        try:
            os.replace(upload.path, target)
        except FileNotFoundError:
            if not target.is_file():  # else it has the name already
                raise
        sync_folder(target.parent)

    def hold(self, upload: Upload) -> Upload:
        """Return a copy of an upload, to be settled by itself: for work that goes on after its request."""
        with upload.path.open("rb") as source:
            return self.receive(source)

    def settle(self, upload: Upload) -> None:
        """Delete an upload, unless it became a measurement."""
        upload.path.unlink(missing_ok=True)
