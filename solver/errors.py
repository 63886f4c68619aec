"""Exceptions of the solver, misuse only. A numerical failure is the status of a result:
:mod:`jointplay.solver.cases.case`.
"""

from __future__ import annotations


class SolverError(Exception):
    """Root of everything the solver raises on purpose; ``str()`` is one plain line."""


class MachineError(SolverError):
    """A machine file, a number in it, or a fault state that breaks a rule.

    Parameters
    ----------
    source : str
        File (or name) the value came from.
    path : str
        Dotted path of the value, ``joints.A.contact.stiffness``; may be empty for the whole file.
    value : object
        The offending value as the user wrote it; ``None`` when something is missing.
    rule : str
        The rule it breaks, as a phrase: "must be greater than 0".

    Attributes
    ----------
    line : int or None
        Line of the file that it is about, where whoever holds its text has looked
        (:func:`jointplay.solver.machines.source_lines.line_of`).
    """

    line: int | None = None

    def __init__(self, source: str, path: str, value: object, rule: str) -> None:
        self.source = source
        self.path = path
        self.value = value
        self.rule = rule
        shown = "" if value is None else str(value).replace("\n", " ")
        if len(shown) > 80:
            shown = shown[:77] + "..."
        line = ": ".join(part for part in (source, path, shown, rule) if part)
        super().__init__(" ".join(line.splitlines()))

    def __reduce__(self) -> tuple[type[MachineError], tuple[str, str, object, str]]:
        """Rebuild from the four parts: a worker process hands its exceptions over pickled."""
        return type(self), (self.source, self.path, self.value, self.rule)


class AssemblyError(MachineError):
    """The machine cannot be assembled, or its constraints contradict each other, at the named drive angle."""

    @property
    def joint(self) -> str:
        """The joint that stays open; empty where it is not one joint that is to blame."""
        head, _, name = self.path.partition(".")
        return name if head == "joints" and "." not in name else ""


class SettingsError(SolverError):
    """Settings of a simulation that cannot be met (a negative duration, a step longer than a sample ...)."""


class UnitError(SolverError):
    """A number with a unit that cannot be read, is not finite, or measures something else than expected."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.splitlines()))
