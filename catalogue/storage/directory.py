"""The folder of a catalogue: which file is what, and how a file gets there whole or not at all."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from jointplay.catalogue.errors import CatalogueBusyError, CatalogueFileError

_TEMPORARY = ".tmp-"

STALE = 3600.0
"""Age from which a temporary file of a model or network counts as left behind [s]; they are written without a lock."""


def sha256_of(content: bytes) -> str:
    """SHA-256 of `content`, 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def sync_folder(folder: Path) -> None:
    """Make renames in `folder` durable, where the system can do that for a folder."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _temporary_beside(path: Path) -> Path:
    return path.with_name(f"{_TEMPORARY}{os.getpid()}-{secrets.token_hex(4)}")


def publish(path: Path, content: bytes) -> None:
    """Write a file so that under its name there is always either nothing, the old content or the whole new one.

    The content goes to a temporary file beside it and to the disk, then takes the name; a crash at any moment leaves at
    most the temporary file.

    Parameters
    ----------
    path : Path
        The file; an old one is replaced.
    content : bytes
        All of it.

    Raises
    ------
    CatalogueFileError
        The folder cannot be written to, or the disk is full.
    """
    temporary = _temporary_beside(path)
    try:
        try:
            with open(temporary, "xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)
    except OSError as error:
        raise CatalogueFileError(path, f"cannot be written ({error.strerror or error})") from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file to be written, which takes the name `path` when the block ends well, and goes if it does not.

    Raises
    ------
    CatalogueFileError
        It cannot be written.
    """
    temporary = _temporary_beside(path)
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise CatalogueFileError(path, f"cannot be written ({error.strerror or error})") from error
    finally:
        temporary.unlink(missing_ok=True)


@dataclass(frozen=True)
class CatalogueDirectory:
    """Paths inside one catalogue.

    Parameters
    ----------
    root : Path
        The folder; it need not exist yet.
    """

    root: Path

    @property
    def manifest(self) -> Path:
        """What the catalogue is: layout, machine, settings, plan, versions."""
        return self.root / "manifest.json"

    @property
    def index(self) -> Path:
        """SQLite database of entries, shards and chunks; made from the shards, so it can be lost."""
        return self.root / "index.sqlite"

    @property
    def shards(self) -> Path:
        """Folder of the immutable HDF5 files, each named by the SHA-256 of its content."""
        return self.root / "shards"

    @property
    def quarantine(self) -> Path:
        """Folder to which damaged files are moved."""
        return self.root / "quarantine"

    @property
    def lock(self) -> Path:
        """Locked while somebody builds or repairs here."""
        return self.root / "build.lock"

    def shard(self, name: str) -> Path:
        """Path of the shard called `name` (its SHA-256)."""
        return self.shards / f"{name}.h5"

    @property
    def matrices(self) -> Path:
        """Folder of the feature matrices; made from the shards, so it can be lost."""
        return self.root / "matrix"

    def matrix(self, catalogue_id: str) -> Path:
        """Folder of the matrix of one state of the catalogue."""
        return self.matrices / catalogue_id[:16]

    @property
    def models(self) -> Path:
        """Folder of models fitted to it; made from the matrix, so it can be lost."""
        return self.root / "models"

    @property
    def networks(self) -> Path:
        """Folder of networks trained on it; made from the matrix, so it can be lost."""
        return self.root / "networks"

    @property
    def machines(self) -> Path:
        """Folder of what was simulated, and learned, for single machines; can be simulated again, so it can be lost."""
        return self.root / "machines"

    @property
    def quality(self) -> Path:
        """Quality card of its present state; made from the matrix, so it can be lost."""
        return self.root / "quality.json"

    def other_matrices(self, catalogue_id: str) -> tuple[Path, ...]:
        """Folders of complete matrices of other states."""
        if not self.matrices.is_dir():
            return ()
        mine = self.matrix(catalogue_id)
        return tuple(path for path in self.matrices.iterdir() if path != mine and not path.name.startswith(_TEMPORARY))

    def remove_matrices(self, paths: Iterable[Path], *, keep: str | None = None) -> None:
        """Delete matrices but that of the state `keep`; whoever has one mapped keeps it."""
        for path in paths:
            if keep is None or path != self.matrix(keep):
                self.remove_folder(path)

    def remove_folder(self, path: Path) -> None:
        """Delete a folder, if it is there, under its name at once, then its files."""
        aside = _temporary_beside(path)
        with suppress(FileNotFoundError):  # another builder deletes them, too
            os.replace(path, aside)
            shutil.rmtree(aside, ignore_errors=True)

    @contextmanager
    def temporary_folder(self, parent: Path) -> Iterator[Path]:
        """A new folder that is deleted at the end, unless it has got another name by then."""
        parent.mkdir(exist_ok=True)
        path = _temporary_beside(parent / "x")
        path.mkdir()
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)

    def shard_names(self) -> tuple[str, ...]:
        """Names of all shards on the disk, sorted."""
        return tuple(sorted(path.stem for path in self.shards.glob("*.h5"))) if self.shards.is_dir() else ()

    def create(self) -> None:
        """Make the folders.

        Raises
        ------
        CatalogueFileError
            They cannot be made, or the folder holds something that is not a catalogue.
        """
        try:
            foreign = self.root.is_dir() and not self.manifest.exists() and not self.shards.exists()
            if foreign and any(path.name != self.lock.name for path in self.root.iterdir()):
                raise CatalogueFileError(self.root, "holds files but no catalogue: name an empty or new folder")
            self.shards.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CatalogueFileError(self.root, f"cannot be created ({error.strerror or error})") from error

    def remove_temporaries(self) -> int:
        """Delete what interrupted writing left, and count it; only the holder of the lock may do this."""
        folders = (self.root, self.shards, self.matrices)
        leftovers = [path for folder in folders for path in folder.glob(f"{_TEMPORARY}*")]
        stale = time.time() - STALE
        for folder in (self.models, self.networks, self.machines):
            with suppress(FileNotFoundError):  # whoever writes one has just renamed it
                leftovers += [path for path in folder.glob(f"{_TEMPORARY}*") if path.stat().st_mtime < stale]
        for path in leftovers:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        return len(leftovers)

    def move_to_quarantine(self, path: Path) -> Path:
        """Take a damaged file out of the catalogue without destroying it; returns where it is now."""
        self.quarantine.mkdir(exist_ok=True)
        target = self.quarantine / path.name
        number = 1
        while target.exists():
            target = self.quarantine / f"{path.stem}-{number}{path.suffix}"
            number += 1
        os.replace(path, target)
        sync_folder(self.quarantine)
        sync_folder(path.parent)
        return target

    @contextmanager
    def hold_alone(self) -> Iterator[None]:
        """Hold the only right to change this catalogue; it ends with the process, however that ends.

        Raises
        ------
        CatalogueBusyError
            Another process builds or repairs here.
        """
        lock = FileLock(self.lock)
        try:
            lock.acquire(timeout=0)
        except Timeout as error:
            raise CatalogueBusyError(self.root) from error
        except OSError as error:
            raise CatalogueFileError(self.lock, f"cannot be locked ({error.strerror or error})") from error
        try:
            yield
        finally:
            lock.release()
