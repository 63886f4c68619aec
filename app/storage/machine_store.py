"""Machines that the service knows: those that ship with the program, and those that were put there."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock

from jointplay.app.errors import AppError, BadFieldError, PreconditionError, ShippedMachineError, UnknownMachineError
from jointplay.app.etags import Conditions
from jointplay.catalogue.storage.directory import publish
from jointplay.solver.machines.machine import (
    Machine,
    load_machine,
    parse_machine,
    shipped_machine,
    shipped_machine_names,
    shipped_machine_text,
)

VERSIONS = "versions"
"""Folder of what machines were, beside what they are."""

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,62}")
RULE = "must be 1 to 63 of a-z, 0-9, - and _, the first a letter or digit, and not the word new or check"
RESERVED = ("new", "check")
"""Names of pages."""


@dataclass(frozen=True)
class MachineVersion:
    """A machine as it was put there once.

    Parameters
    ----------
    number : int
        From 1 on.
    content_key : str
        Of the machine.
    saved_at : datetime or None
        None for what ships with the program.
    text : str
        Its file as it was written, comments and all.
    """

    number: int
    content_key: str
    saved_at: datetime | None
    text: str


class MachineStore:
    """Machines by name; those that were put there are files of one folder, in the form that `GET` gives.

    Parameters
    ----------
    directory : Path
        Made when the first machine is put there. Several servers may share it.
    note : callable, optional
        Called with the name of a machine that is about to be another one, and its content keys before and after.
    missing : callable, optional
        Returns why there is no machine of a name, from the name and the error for one that never was.
    """

    def __init__(
        self,
        directory: Path,
        note: Callable[[str, str | None, str], None] = lambda *_: None,
        missing: Callable[[str, AppError], AppError] = lambda _, never: never,
    ) -> None:
        self._directory = directory
        self._note, self._missing = note, missing
        self._read: dict[Path, tuple[tuple[int, int, int], Machine]] = {}

    def names(self) -> list[str]:
        """Return the names of all machines, sorted."""
        files = self._directory.glob("*.json") if self._directory.is_dir() else ()
        return sorted({*shipped_machine_names(), *(file.stem for file in files if NAME.fullmatch(file.stem))})

    def find(self, name: str) -> Machine:
        """Return a machine; one that was put here before another of its name was shipped stays.

        Raises
        ------
        UnknownMachineError
            When there is none of this name.
        """
        found = self._read_stored(name) if NAME.fullmatch(name) else None
        if found is None and name in shipped_machine_names():
            return shipped_machine(name)
        if found is None:
            unknown = UnknownMachineError(f"machine: {name[:80]}: there is none of this name", field="machine")
            raise self._missing(name, unknown)
        return found

    def ships(self, name: str) -> bool:
        """Return whether a machine is the one that ships with the program."""
        return name in shipped_machine_names() and not self._file(name).is_file()

    def check_own(self, name: str) -> None:
        """Refuse a machine that was not put here.

        Raises
        ------
        UnknownMachineError
            When there is none of this name.
        ShippedMachineError
            When it ships with the program.
        """
        self.find(name)
        if self.ships(name):
            raise ShippedMachineError(f"machine: {name}: ships with the program and cannot be deleted")

    def remove(self, name: str) -> None:
        """Delete a machine that was put here, and what it was before."""
        with FileLock(self._directory / ".lock"):
            # The versions first: without them the machine is one that was put here before versions were kept.
            shutil.rmtree(self._kept(name), ignore_errors=True)
            self._file(name).unlink(missing_ok=True)

    def versions(self, name: str) -> list[int]:
        """Return the numbers of the versions of a machine that was put there, the newest first.

        A machine that ships with the program has one alone, and so has one that was put there before versions were
        kept.

        Raises
        ------
        UnknownMachineError
            When there is no machine of this name.
        """
        self.find(name)
        files = self._kept(name).glob("*.json")
        return sorted((int(file.stem) for file in files if file.stem.isdecimal()), reverse=True) or [1]

    def version(self, name: str, number: int | None = None) -> MachineVersion:
        """Return a version of a machine with the text of its file as it was written; the newest without a number.

        Raises
        ------
        UnknownMachineError
            When there is no machine of this name, or no such version.
        """
        found = self.find(name)
        if self.ships(name) and number in (None, 1):
            return MachineVersion(1, found.content_key, None, shipped_machine_text(name))
        if number is None:
            number = self.versions(name)[0]
        try:
            held = json.loads((self._kept(name) / f"{number}.json").read_text(encoding="utf-8"))
        except FileNotFoundError:
            if number == 1 and self.versions(name) == [1]:
                return MachineVersion(1, found.content_key, None, plain_text(found))
            raise UnknownMachineError(f"version: {number}: machine {name} has none of this number") from None
        return MachineVersion(number, held["content_key"], datetime.fromisoformat(held["saved_at"]), held["text"])

    def put(self, name: str, content: str, conditions: Conditions, text: str | None = None) -> tuple[Machine, bool]:
        """Store a machine under a name, whole or not at all, in the place of an older one, which stays as a version.

        Parameters
        ----------
        name : str
        content : str
            The machine as canonical JSON, checked.
        text : str, optional
            Its file as it was written, which is kept with it.
        conditions : Conditions
            What the client knows of the older one.

        Returns
        -------
        machine : Machine
        created : bool
            Whether there was none of this name.

        Raises
        ------
        PreconditionError
            When the older one is not what the client says, or there is one and there should be none.
        BadFieldError, ShippedMachineError
            As :func:`check_name`.
        CatalogueFileError
            When the file cannot be written.
        """
        check_name(name)
        machine = parse_machine(content, name)
        self._directory.mkdir(parents=True, exist_ok=True)
        with FileLock(self._directory / ".lock"):
            older = self._read_stored(name)
            if not conditions.hold(None if older is None else older.content_key):
                state = "there is none of this name" if older is None else "the machine of this name is another one"
                raise PreconditionError(f"machine: {name}: If-Match or If-None-Match does not hold: {state}")
            self._keep(name, older, machine, text)
            if older is None or older.content_key != machine.content_key:
                self._note(name, None if older is None else older.content_key, machine.content_key)
                publish(self._file(name), content.encode())
        return machine, older is None

    def _keep(self, name: str, older: Machine | None, machine: Machine, text: str | None) -> None:
        """Keep a version, before the machine itself: what is cut short between both is put there once more."""
        folder, last = self._kept(name), 0
        if older is not None:
            newest = self.version(name)
            last = newest.number
            if newest.saved_at is None:  # put there before versions were kept
                self._write(folder, newest)
            same = newest.content_key == machine.content_key == older.content_key
            if same and (text is None or text == newest.text):
                return
        said = plain_text(machine) if text is None else text
        self._write(folder, MachineVersion(last + 1, machine.content_key, datetime.now(UTC), said))

    def _write(self, folder: Path, version: MachineVersion) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        moment = version.saved_at or datetime.fromtimestamp(self._file(folder.name).stat().st_mtime, UTC)
        content = {"content_key": version.content_key, "saved_at": moment.isoformat(), "text": version.text}
        publish(folder / f"{version.number}.json", json.dumps(content, ensure_ascii=False).encode())

    def _kept(self, name: str) -> Path:
        return self._directory / VERSIONS / name

    def _file(self, name: str) -> Path:
        return self._directory / f"{name}.json"

    def _read_stored(self, name: str) -> Machine | None:
        """Return a machine that was put here; read again only when its file is another one."""
        path = self._file(name)
        try:
            found = path.stat()
        except FileNotFoundError:
            return None
        stamp = (found.st_ino, found.st_mtime_ns, found.st_size)
        kept = self._read.get(path)
        if kept is None or kept[0] != stamp:
            kept = self._read[path] = stamp, load_machine(path)
        return kept[1]


def plain_text(machine: Machine) -> str:
    """Return a machine of which no file is kept as the text of one."""
    return json.dumps(machine.model_dump(), indent=2, allow_nan=False) + "\n"


def check_name(name: str) -> None:
    """Refuse a name that no machine can be put under.

    Raises
    ------
    BadFieldError
        When it breaks the rule for names.
    ShippedMachineError
        When it is that of a machine that ships with the program.
    """
    if not NAME.fullmatch(name) or name in RESERVED:
        raise BadFieldError(f"name: {name[:80]}: {RULE}", field="name")
    if name in shipped_machine_names():
        raise ShippedMachineError(f"machine: {name}: ships with the program and cannot be replaced; take another name")
