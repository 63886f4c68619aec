"""Exceptions of the catalogue: misuse and damaged files only. A numerical failure is the status of an entry."""

from __future__ import annotations

from pathlib import Path


def _one_line(*parts: object) -> str:
    """Parts of a message in one line; the last is the rule, which lists what there is and may be longer."""
    shown = [" ".join(str("" if part is None else part).split()) for part in parts]
    most = [160] * (len(parts) - 1) + [480]
    cut = (part if len(part) <= limit else part[: limit - 3] + "..." for part, limit in zip(shown, most, strict=True))
    return ": ".join(part for part in cut if part)


class CatalogueError(Exception):
    """Root of everything the catalogue raises on purpose; ``str()`` is one plain line."""


class PlanError(CatalogueError):
    """A plan, or a number in it, that breaks a rule.

    Parameters
    ----------
    source : str
        File or name of the plan.
    path : str
        Dotted path of the value, ``clearance.low``; empty for the whole plan.
    value : object
        The offending value as the user wrote it; ``None`` when something is missing.
    rule : str
        The rule it breaks, as a phrase: "must be greater than 0".
    """

    def __init__(self, source: str, path: str, value: object, rule: str) -> None:
        self.source, self.path, self.value, self.rule = source, path, value, rule
        super().__init__(source, path, value, rule)

    def __str__(self) -> str:
        return _one_line(self.source, self.path, self.value, self.rule)


class KeyContentError(CatalogueError):
    """Something that is to be part of a key but has no canonical form: a number that is not finite, an object."""

    def __init__(self, path: str, value: object, rule: str) -> None:
        self.path, self.value, self.rule = path, value, rule
        super().__init__(path, value, rule)

    def __str__(self) -> str:
        return _one_line(self.path, repr(self.value), self.rule)


class CatalogueFileError(CatalogueError):
    """A file or folder of a catalogue that is missing, cannot be read or written, or is damaged."""

    def __init__(self, path: Path | str, rule: str) -> None:
        self.path, self.rule = Path(path), rule
        self._shown = str(path)  # an index's URL must keep its slashes
        super().__init__(path, rule)

    def __str__(self) -> str:
        return _one_line(self._shown, self.rule)


class CatalogueMismatchError(CatalogueFileError):
    """A catalogue that is in order, but of another machine, plan, layout or version of numbers than is asked for."""


class CatalogueBusyError(CatalogueFileError):
    """Another process builds or repairs this catalogue."""

    def __init__(self, path: Path | str) -> None:
        super().__init__(path, "another build or verify is running here; wait for its end or stop it")
        self.args = (path,)


class BuildError(CatalogueError):
    """A build in which nothing at all could be computed."""


class SchedulerAddressError(BuildError):
    """An address at which no scheduler of a cluster can be.

    Parameters
    ----------
    address : str
    rule : str
        The rule it breaks, as a phrase.
    """

    def __init__(self, address: str, rule: str) -> None:
        self.address, self.rule = address, rule
        super().__init__(address, rule)

    def __str__(self) -> str:
        return _one_line(self.address, self.rule)


class EntryNotFoundError(CatalogueError):
    """No entry with this key, or with a key that begins so."""

    def __init__(self, key: str) -> None:
        self.key = key
        super().__init__(key)

    def __str__(self) -> str:
        return _one_line(self.key, "no such entry in the catalogue")


class MeasurementError(CatalogueError):
    """A recording that cannot be read, or holds what a diagnosis must not rest on.

    Parameters
    ----------
    source : str
        File (or name) of the recording.
    line : int, optional
        Line of the file, from 1.
    column : str, optional
        Name of the column or channel.
    value : object, optional
        The offending value as the file has it.
    rule : str
        The rule it breaks, as a phrase: "is not a number".
    field : str
        What its sender has to say, or said wrongly: ``sample_rate``, ``units``, ``full_scale``, ``sensitivity``,
        ``tacho``, ``scaling``, ``detector``, ``window``, ``reference``, ``measured_at``, ``profile``, ``speed``; empty
        where the file is at fault.
    """

    def __init__(
        self,
        source: str,
        line: int | None = None,
        column: str | None = None,
        value: object = None,
        rule: str = "",
        *,
        field: str = "",
    ) -> None:
        self.source, self.line, self.column, self.value, self.rule = source, line, column, value, rule
        self.field = field
        super().__init__(source, line, column, value, rule)

    def __str__(self) -> str:
        line = None if self.line is None else f"line {self.line}"
        column = None if self.column is None else f"column {self.column!r}"
        return _one_line(self.source, line, column, None if self.value is None else repr(self.value), self.rule)


class MatchingError(CatalogueError):
    """Draws or a feature vector that a matcher cannot use: wrong lengths, too few draws, not finite."""


class DiagnosisError(CatalogueError):
    """A measurement that cannot be compared with this catalogue, or a setting of a diagnosis that breaks a rule."""
