"""Machines that the service knows: those that ship with the program, and those that were put there."""

from __future__ import annotations

import re
from pathlib import Path

from filelock import FileLock

from jointplay.app.errors import BadFieldError, PreconditionError, ShippedMachineError, UnknownMachineError
from jointplay.app.etags import Conditions
from jointplay.catalogue.storage.directory import publish
from jointplay.solver.machines.machine import (
    Machine,
    load_machine,
    parse_machine,
    shipped_machine,
    shipped_machine_names,
)

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,62}")
RULE = "must be 1 to 63 of a-z, 0-9, - and _, the first a letter or digit"


class MachineStore:
    """Machines by name; those that were put there are files of one folder, in the form that `GET` gives.

    Parameters
    ----------
    directory : Path
        Made when the first machine is put there. Several servers may share it.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
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
            raise UnknownMachineError(f"machine: {name[:80]}: there is none of this name", field="machine")
        return found

    def put(self, name: str, content: str, conditions: Conditions) -> tuple[Machine, bool]:
        """Store a machine under a name, whole or not at all, in the place of an older one.

        Parameters
        ----------
        name : str
        content : str
            The machine as canonical JSON, checked.
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
            if older is None or older.content_key != machine.content_key:
                publish(self._file(name), content.encode())
        return machine, older is None

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


def check_name(name: str) -> None:
    """Refuse a name that no machine can be put under.

    Raises
    ------
    BadFieldError
        When it breaks the rule for names.
    ShippedMachineError
        When it is that of a machine that ships with the program.
    """
    if not NAME.fullmatch(name):
        raise BadFieldError(f"name: {name[:80]}: {RULE}", field="name")
    if name in shipped_machine_names():
        raise ShippedMachineError(f"machine: {name}: ships with the program and cannot be replaced; take another name")
