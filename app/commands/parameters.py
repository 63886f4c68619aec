"""Kinds of option values that several commands share."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from jointplay.app.fields import ALL_OTHERS, FILE_FIELDS

if TYPE_CHECKING:
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.machines.units import Dimension


class QuantityOption(click.ParamType[float]):
    """A number with a unit, such as "600 rpm", as SI; a bare number is SI already, but for a speed, which needs one.

    Parameters
    ----------
    dimension : str
        Name of a dimension in :mod:`jointplay.solver.machines.units`.
    positive : bool
        Whether the value must be greater than 0.
    """

    def __init__(self, dimension: str, *, positive: bool = True) -> None:
        self._dimension = dimension
        self._positive = positive
        self.name = dimension.lower().replace("_", " ")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the SI value."""
        from jointplay.solver.errors import UnitError
        from jointplay.solver.machines import units

        dimension: Dimension = getattr(units, self._dimension)
        read = units.speed_to_si if dimension in (units.ANGULAR_SPEED, units.SPEED) else units.to_si
        try:
            number = read(value, dimension)
        except UnitError as error:
            raise click.BadParameter(f"{value}: {error}", ctx, param) from None
        if self._positive and number <= 0:
            raise click.BadParameter(f"{value}: must be greater than 0", ctx, param)
        return number


def drive_speed(machine: Machine, text: str | None) -> dict[str, float]:
    """Return what ``--speed`` changes in a machine: a speed of rotation or of sliding, as its drive is.

    Parameters
    ----------
    machine : Machine
    text : str or None
        As typed, of either sign.

    Raises
    ------
    click.BadParameter
        A drive without one speed, or a value that does not measure it.
    """
    if text is None:
        return {}
    drive = machine.drive
    if drive is None or drive.kind not in ("rotation", "translation", "position"):
        kind = "no drive" if drive is None else f"a {drive.kind} drive"
        rule = f"{machine.name} has {kind}; only a rotation, translation or position drive has a speed"
        raise click.BadParameter(f"{text}: {rule}", param_hint="--speed")
    if isinstance(getattr(drive, "speed", None), tuple):
        rule = f"the drive of {machine.name} runs up by a table: change that in its file"
        raise click.BadParameter(f"{text}: {rule}", param_hint="--speed")
    quantity = QuantityOption("ANGULAR_SPEED" if drive.kind == "rotation" else "SPEED", positive=False)
    try:
        return {"drive.speed": quantity.convert(text, None, None)}
    except click.BadParameter as error:
        raise click.BadParameter(error.message, param_hint="--speed") from None


class Decibels(click.ParamType[float]):
    """A difference of levels greater than 0, such as "0.1 dB"; a bare number is dB already."""

    name = "decibels"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number of dB."""
        try:
            number = float(str(value).strip().removesuffix("dB"))
        except ValueError:
            raise click.BadParameter(f"{value}: must be a number of dB, such as 0.1dB", ctx, param) from None
        if not 0 < number < math.inf:
            raise click.BadParameter(f"{value}: must be finite and greater than 0", ctx, param)
        return number


class Pairs(click.ParamType[tuple[str, str]]):
    """A pair LEFT=RIGHT; the last equals sign separates, as a column's name may hold one.

    Parameters
    ----------
    form : str
        What both sides are called in messages.
    alone : str
        The left side of a text without an equals sign; such a text is refused where it is empty.
    """

    def __init__(self, form: str, alone: str = "") -> None:
        self.name = form
        self._alone = alone

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """Return both sides."""
        if isinstance(value, tuple):
            return value
        left, sign, right = str(value).rpartition("=")
        left = left if sign else self._alone
        if not left.strip() or not right.strip():
            raise click.BadParameter(f"{value}: must be {self.name}", ctx, param)
        return left.strip(), right.strip()


class Names(click.ParamType[list[Any]]):
    """Names, or whole numbers, with commas between them; each once.

    Parameters
    ----------
    known : sequence of str
        The names that are possible; any, if none are given.
    number : bool
        Whether they are whole numbers greater than 0.
    """

    name = "list"

    def __init__(self, known: Sequence[str] = (), *, number: bool = False) -> None:
        self._known = tuple(known)
        self._number = number

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[Any]:
        """Return the names in order."""
        if isinstance(value, list):
            return value
        found: list[Any] = []
        for name in filter(None, (part.strip() for part in str(value).split(","))):
            if self._known and name not in self._known:
                raise click.BadParameter(f"{name}: must be one of {', '.join(self._known)}", ctx, param)
            if self._number and not (name.isdigit() and int(name) > 0):
                raise click.BadParameter(f"{name}: must be a whole number greater than 0", ctx, param)
            found.append(int(name) if self._number else name)
        if not found:
            raise click.BadParameter(f"{value!r}: must name at least one", ctx, param)
        return list(dict.fromkeys(found))


def each_once(pairs: Sequence[tuple[str, str]], option: str) -> dict[str, str]:
    """Return pairs as a mapping; a left side given twice is refused, as one of the two would be lost."""
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = next(left for left, count in Counter(left for left, _ in pairs).items() if count > 1)
        raise click.BadParameter(f"{twice}: is given twice", param_hint=f"'{option}'")
    return found


def refuse_given(options: Sequence[str], rule: str) -> None:
    """Refuse options of the running command that were given although they would change nothing.

    Raises
    ------
    UsageError
        One of them was given.
    """
    context = click.get_current_context()
    for option in options:
        if context.get_parameter_source(option) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"--{option}: {rule}")


def existing_catalogue(path: Path) -> Path:
    """Return the folder of a catalogue that is there; a wrong name is bad input, not a damaged catalogue.

    Raises
    ------
    UnknownCatalogueError
        When there is no catalogue.
    """
    from jointplay.app.errors import UnknownCatalogueError
    from jointplay.catalogue.storage.directory import CatalogueDirectory

    layout = CatalogueDirectory(path)
    if not layout.manifest.exists() and not layout.shards.is_dir():
        raise UnknownCatalogueError(f"{path}: is not a catalogue; `jointplay build` makes one")
    return path


def file_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command an option for each thing that can be said of a file, called as the field."""
    for each in reversed(FILE_FIELDS):
        kind: click.ParamType[Any] = click.STRING
        if each.by_column:
            kind = Pairs(f"COLUMN={each.by_column}", ALL_OTHERS)
        elif each.choices:
            kind = click.Choice(list(each.choices))
        elif each.name == "sample_rate":
            kind = QuantityOption("FREQUENCY")
        more = " Without COLUMN= of all columns; may be repeated." if each.by_column else ""
        more = " One for each measurement in turn." if each.by_file else more
        several = bool(each.by_column) or each.by_file
        command = click.option(f"--{each.option}", each.name, type=kind, multiple=several, help=f"{each.says}{more}")(
            command
        )
    return command


catalogue_option = click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)

fault_option = click.option(
    "--fault",
    metavar="A=0.2mm,F=50um|healthy",
    help="Radial clearance of all worn joints; by default what the machine's file gives, mostly none.",
)

speeds_option = click.option(
    "--speed",
    "speeds",
    type=QuantityOption("ANGULAR_SPEED"),
    multiple=True,
    help='Drive speed, such as "600 rpm", of each measurement in turn; estimated when not given.',
)

baseline_option = click.option(
    "--baseline",
    "baselines",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="FILE",
    help="Recording of the machine in order by the same sensors: fits frame, supports and sensor gains, and shows what"
    " has changed since; may be repeated.",
)

json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


def print_json(document: object) -> None:
    """Print a value as JSON; a number that is not finite is a mistake of ours and must not pass as one."""
    click.echo(json.dumps(document, indent=2, ensure_ascii=not utf8(), allow_nan=False))


def utf8() -> bool:
    """Return whether the terminal or file takes any character."""
    return (getattr(sys.stdout, "encoding", None) or "").lower().replace("-", "") == "utf8"
