"""What a watched folder has been through: one line for each file, in the folder itself, whatever ends the watcher."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from filelock import FileLock, Timeout

from jointplay.app.errors import BusyError

JOURNAL, LOCK = ".jointplay-watch.jsonl", ".jointplay-watch.lock"


@dataclass(frozen=True)
class Entry:
    """One line.

    Parameters
    ----------
    to : str
        Where its content goes: other servers, catalogues or assets get everything anew.
    file : str
        Its name.
    size, mtime_ns : int
        Of the file as it was then.
    sha256 : str
        Of its content.
    state : {"sending", "sent", "refused"}
    name : str
        Under which the content was sent, which is the first of several files that have it.
    said : str
        What the server made of it, or why it refused.
    """

    to: str
    file: str
    size: int
    mtime_ns: int
    sha256: str
    state: Literal["sending", "sent", "refused"]
    name: str
    said: str = ""


class Journal:
    """Lines of one folder and one destination.

    Parameters
    ----------
    folder : Path
    to : str
    """

    def __init__(self, folder: Path, to: str) -> None:
        self.path = folder / JOURNAL
        self.to = to
        self._files: dict[str, Entry] = {}
        self._contents: dict[str, Entry] = {}
        text = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        for line in text.splitlines():
            try:
                entry = Entry(**json.loads(line))
            except (ValueError, TypeError):  # the line that was being written when the watcher was killed
                continue
            if entry.to == to:
                self._remember(entry)
        if text and not text.endswith("\n"):
            self._append("")

    def is_settled(self, file: str, size: int, mtime_ns: int) -> bool:
        """Return whether a file was sent or refused as it is now."""
        entry = self._files.get(file)
        if entry is None or entry.state == "sending":
            return False
        return (entry.size, entry.mtime_ns) == (size, mtime_ns)

    def last(self, file: str) -> Entry | None:
        """Return the last line about a file."""
        return self._files.get(file)

    def content(self, sha256: str) -> Entry | None:
        """Return the last line about a content, under whatever name."""
        return self._contents.get(sha256)

    def add(self, entry: Entry) -> None:
        """Write a line; it is on the disk when this returns."""
        self._append(json.dumps(asdict(entry)))
        self._remember(entry)

    def _remember(self, entry: Entry) -> None:
        self._files[entry.file] = entry
        self._contents[entry.sha256] = entry

    def _append(self, line: str) -> None:
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(f"{line}\n")
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def claim(folder: Path) -> Iterator[None]:
    """Have a folder to oneself; the claim ends with the process, however that ends.

    Raises
    ------
    BusyError
        When another process watches it.
    """
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise BusyError(f"{folder}: is being watched by another process already") from None
    try:
        yield
    finally:
        lock.release()
