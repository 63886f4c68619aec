"""The mechanism matrix: who is paired with whom, and how, as an N x N table of symbols.

The entry (i, j) is ``0`` (not connected), ``A``/``-A`` (sliding; plus when i > j), ``B`` (turning) or ``C``/``-C``
(turning with clearance; plus when link i carries the pin). Link 1 is the frame. The corner (1, 1) holds the number of
springs that support the frame on the ground, (N, N) the number of dampers; a mount counts for each direction in which
it acts. The one entry of a single link is both corners: ``4``, or ``4/2`` for 4 springs and 2 dampers. What the paper
derives from the matrix (factors of the joints, counts and neighbour lists of the links) is a check of it by hand: the
solver does not need it, its equations come from the machine itself.

Source: Mostafa, Shabara, El-Bahloul, Fanny, Mansoura Engineering Journal 14 (2), items 1 to 12 of the nomenclature.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.content import MachineContent
from jointplay.solver.machines.refusals import show_value

_OPPOSITE = {"0": "0", "A": "-A", "-A": "A", "B": "B", "C": "-C", "-C": "C"}


@dataclass(frozen=True)
class MechanismMatrix:
    """Topology of a machine with a set of clearance joints.

    Attributes
    ----------
    links : tuple of str
        Names of the links in the order of the rows; the frame is the first.
    rows : tuple of tuple of str
        The symbols.
    """

    links: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @classmethod
    def from_machine(cls, machine: MachineContent, clearance_joints: Iterable[str] = ()) -> MechanismMatrix:
        """Write a machine's topology as a matrix.

        Parameters
        ----------
        machine : MachineContent
        clearance_joints : iterable of str
            Joints that have clearance. The paper has none in guides: they stay A.

        Raises
        ------
        MachineError
            When a matrix cannot say it: two joints between the same links, a joint that is none.
        """
        names = sorted(machine.links, key=lambda name: name != machine.frame)
        open_joints = set(clearance_joints)
        for name in sorted(open_joints - set(machine.wearing_joints)):
            raise MachineError(machine.name, f"joints.{name}", None, "is no joint that can have clearance")
        table = [["0"] * len(names) for _ in names]
        for name, joint in machine.joints.items():
            i, j = (names.index(link) for link in joint.links)
            if table[i][j] != "0":
                rule = "is a second joint between the same links, which a mechanism matrix cannot hold"
                raise MachineError(machine.name, f"joints.{name}", None, rule)
            if joint.kind == "sliding":
                symbol = "A" if i > j else "-A"
            elif name in open_joints:
                symbol = "C" if joint.pin == names[i] else "-C"
            else:
                symbol = "B"
            table[i][j], table[j][i] = symbol, _OPPOSITE[symbol]
        springs, dampers = map(str, _support_counts(machine))
        table[0][0], table[-1][-1] = springs, dampers
        if len(names) == 1 and springs != dampers:
            table[0][0] = f"{springs}/{dampers}"
        return cls(tuple(names), tuple(tuple(row) for row in table))

    @classmethod
    def parse(cls, rows: object, links: Sequence[str], source: str) -> MechanismMatrix:
        """Read rows of symbols: lists, or text with blanks between the symbols (one text a row, or one of many lines).

        Raises
        ------
        MachineError
            When the table is not square, a symbol is unknown, or an entry and its mirror contradict each other.
        """
        count = len(links)
        rows = rows.splitlines() if isinstance(rows, str) else rows
        if not count or not isinstance(rows, (list, tuple)) or len(rows) != count:
            raise MachineError(source, "matrix", None, f"must have one row for each of the {count} links, at least one")
        table = [_symbols(row, count, f"matrix.{index}", source) for index, row in enumerate(rows)]
        for i in range(count):
            for j in range(count):
                path, symbol = f"matrix.{i}.{j}", table[i][j]
                if count == 1:
                    if not re.fullmatch(r"\d+(/\d+)?", symbol, re.ASCII):
                        raise MachineError(source, path, symbol, "must count springs and dampers: 4, or 4/2")
                elif i == j:
                    if not symbol.isdecimal() or (0 < i < count - 1 and symbol != "0"):
                        raise MachineError(source, path, symbol, "must be a count in the two corners, 0 between them")
                elif symbol not in _OPPOSITE:
                    raise MachineError(source, path, symbol, "must be 0, A, -A, B, C or -C")
                elif table[j][i] != _OPPOSITE[symbol]:
                    raise MachineError(source, path, symbol, f"must face {_OPPOSITE[symbol]}, not {table[j][i]}")
                elif symbol == ("-A" if i > j else "A"):
                    raise MachineError(source, path, symbol, "a sliding joint is A below the diagonal, -A above it")
        return cls(tuple(links), tuple(table))

    @property
    def springs(self) -> int:
        """Number of springs that support the frame (the paper's NSP)."""
        return int(self.rows[0][0].partition("/")[0])

    @property
    def dampers(self) -> int:
        """Number of dampers that support the frame (the paper's NDP)."""
        return int(self.rows[-1][-1].rpartition("/")[2])

    def pairs(self) -> Iterator[tuple[int, int, str]]:
        """Yield (i, j, symbol) of every joint, i < j, counted from 0."""
        for i, row in enumerate(self.rows):
            for j in range(i + 1, len(row)):
                if row[j] != "0":
                    yield i, j, row[j]

    def text(self) -> str:
        """Return the rows as aligned text, one line a row, as :meth:`parse` reads it again."""
        width = max(len(symbol) for row in self.rows for symbol in row) + 1
        return "\n".join("".join(symbol.rjust(width) for symbol in row) for row in self.rows)


def _symbols(row: object, count: int, path: str, source: str) -> tuple[str, ...]:
    items = row.split() if isinstance(row, str) else row
    if not isinstance(items, (list, tuple)) or len(items) != count:
        raise MachineError(source, path, None, f"must have {count} symbols")
    return tuple(str(item).removeprefix("+") for item in items)


def _support_counts(machine: MachineContent) -> tuple[int, int]:
    springs = dampers = 0
    for support in machine.supports:
        if support.link == machine.frame and support.to_link is None:
            springs += sum(map(bool, support.stiffness)) if support.kind == "mount" else support.kind == "spring"
            dampers += sum(map(bool, support.damping)) if support.kind == "mount" else support.kind == "damper"
    return springs, dampers


@dataclass(frozen=True)
class MatrixForm:
    """What a file in matrix form says.

    Attributes
    ----------
    tree : dict
        The same machine in the ordinary form.
    matrix : MechanismMatrix
    """

    tree: dict[str, Any]
    matrix: MechanismMatrix

    def check_supports(self, machine: MachineContent, source: str) -> None:
        """Refuse a matrix whose corners do not count the supports that the file lists.

        Raises
        ------
        MachineError
        """
        said = (self.matrix.springs, self.matrix.dampers)
        corners = (0, len(self.matrix.rows) - 1)
        found = _support_counts(machine)
        for corner, noun, wrong, right in zip(corners, ("springs", "dampers"), said, found, strict=True):
            if wrong != right:
                rule = f"must be the number of {noun} between frame and ground in supports, {right}"
                raise MachineError(source, f"matrix.{corner}.{corner}", wrong, rule)


def read_matrix_form(tree: Mapping[str, Any], source: str) -> MatrixForm:
    """Turn the matrix form of a machine file into the ordinary form.

    Parameters
    ----------
    tree : mapping
        ``matrix`` with ``links`` in the order of its rows (a mapping by name, or a list whose items may have a
        ``name``) and ``joints`` keyed ``"i-j"`` (the order of i and j is the order of the joint's links; an item may
        have a ``name``); everything else as in the ordinary form.
    source : str
        Name of the file.

    Returns
    -------
    MatrixForm

    Raises
    ------
    MachineError
        When matrix, links and joints do not fit together; a C without the amount of its clearance, or the reverse.
    """
    links = _check_links(tree.get("links"), source)
    names = list(links)
    matrix = MechanismMatrix.parse(tree.get("matrix"), names, source)
    if tree.get("frame", names[0]) != names[0]:
        raise MachineError(source, "frame", tree["frame"], f"must be the link of the first row, {names[0]}")
    given = tree.get("joints", {})
    if not isinstance(given, Mapping):
        raise MachineError(source, "joints", None, 'must be a mapping of keys "i-j" to the data of the joints')
    joints: dict[str, Any] = {}
    called: dict[str, str] = {}
    symbols = {(i, j): symbol for i, j, symbol in matrix.pairs()}
    for key, data in given.items():
        i, j = _corner(key, len(names), source)
        symbol = symbols.pop((min(i, j), max(i, j)), None)
        if symbol is None:
            raise MachineError(source, f"joints.{key}", None, "is no joint of the matrix, or stands here twice")
        joint = _joint(key, data, (names[i], names[j]), symbol if i < j else _OPPOSITE[symbol], source)
        if symbol.endswith("C") and joint.get("clearance") is None:
            cell, rule = f"matrix.{min(i, j)}.{max(i, j)}", f'needs its amount, joints.{key}.clearance, as in "0.2 mm"'
            raise MachineError(source, cell, symbol, rule)
        name = called[key] = str(joint.pop("name", key))
        if name in joints:
            raise MachineError(source, f"joints.{key}.name", name, "is the name of another joint")
        joints[name] = joint
    for i, j in symbols:
        raise MachineError(source, f"joints.{i + 1}-{j + 1}", None, "is missing: the matrix has this joint")
    plain = {key: value for key, value in tree.items() if key != "matrix"} | {"links": links, "joints": joints}
    drive = tree.get("drive")
    if isinstance(drive, Mapping) and drive.get("joint") in called:
        plain["drive"] = {**drive, "joint": called[drive["joint"]]}
    return MatrixForm(plain, matrix)


def _check_links(links: object, source: str) -> dict[str, Any]:
    if isinstance(links, Mapping):
        return dict(links)
    if not isinstance(links, list) or not all(isinstance(link, Mapping) for link in links):
        raise MachineError(source, "links", None, "must be a list or a mapping of links in the order of the rows")
    named: dict[str, Any] = {}
    for index, link in enumerate(links):
        name = str(link.get("name", index + 1))
        if name in named:
            raise MachineError(source, f"links.{index}.name", name, "is the name of another link")
        named[name] = {key: value for key, value in link.items() if key != "name"}
    return named


def _corner(key: str, count: int, source: str) -> tuple[int, int]:
    i, _, j = key.partition("-")
    numbers = [int(part) for part in (i, j) if part.isdecimal() and 1 <= int(part) <= count]
    if len(numbers) != 2 or i == j:
        raise MachineError(source, f"joints.{key}", None, f'must be keyed "i-j" by two link numbers from 1 to {count}')
    return numbers[0] - 1, numbers[1] - 1


def _joint(key: str, data: object, links: tuple[str, str], symbol: str, source: str) -> dict[str, Any]:
    if not isinstance(data, Mapping):
        raise MachineError(source, f"joints.{key}", None, "must be a mapping of keys to values")
    derived: dict[str, Any] = {"kind": "sliding" if symbol.endswith("A") else "turning", "links": list(links)}
    if symbol.endswith("C"):
        derived["pin"] = links[0] if symbol == "C" else links[1]
    if symbol == "B" and "clearance" in data:
        raise MachineError(
            source, f"joints.{key}.clearance", show_value(data["clearance"]), "contradicts the matrix: B"
        )
    for name, value in derived.items():
        if name in data and data[name] != value:
            raise MachineError(source, f"joints.{key}.{name}", data[name], f"contradicts the matrix: {value}")
    return {**data, **derived}


def matrix_tree(machine: MachineContent) -> dict[str, Any]:
    """Return a machine as a file's content in matrix form, as :func:`~jointplay.solver.machines.machine.parse_machine`
    reads; the joints to which its file gives a clearance are C.

    Raises
    ------
    MachineError
        As :meth:`MechanismMatrix.from_machine`.
    """
    matrix = MechanismMatrix.from_machine(machine, machine.clearances)
    tree: dict[str, Any] = machine.model_dump(mode="json", exclude_none=True)
    joints = {}
    for name, joint in tree["joints"].items():
        i, j = (matrix.links.index(link) + 1 for link in joint["links"])
        kept = {key: value for key, value in joint.items() if key not in {"kind", "links"}}
        joints[f"{i}-{j}"] = {"name": name, **kept}
    links = [{"name": name, **tree["links"][name]} for name in matrix.links]
    head = {"name": tree.pop("name"), "matrix": matrix.text().splitlines()}
    return {**head, **tree, "links": links, "joints": joints}


#: Which joints the array N... counts and the array J... lists: their kinds, and whether only above the diagonal.
SELECTIONS: Mapping[str, tuple[str, bool]] = MappingProxyType({
    "T": ("BC", False), "S": ("A", False), "L": ("ABC", False),
    "TR": ("B", True), "TC": ("C", True), "S'": ("A", True), "L'": ("ABC", True),
})  # fmt: skip
_XI = {"B": 0, "C": 1, "-C": 1}
_N = {"C": 1, "-C": 2}
_S = {"A": 1, "-A": 0}

Table = tuple[tuple[int | None, ...], ...]


@dataclass(frozen=True)
class MatrixArrays:
    """The paper's quantities and arrays; links are counted from 1, in the order of the matrix' rows.

    Attributes
    ----------
    links : tuple of str
        The N links.
    springs, dampers : int
        NSP and NDP.
    xi : tuple of tuple of int or None
        (N, N): 0 for a turning joint without clearance, 1 for one with; ``None`` where there is none.
    n : tuple of tuple of int or None
        (N, N), of clearance joints: 1 where the row's link carries the pin, 2 where it carries the socket. The paper's
        sign of a moment arm is (-1)^n.
    s : tuple of tuple of int or None
        (N, N), of sliding joints: 1 for A (below the diagonal), 0 for -A.
    counts : mapping of str to tuple of int
        ``NT`` (turning), ``NS`` (sliding), ``NL`` (all joints of each link), and above the diagonal ``NTR`` (turning
        without clearance), ``NTC`` (with), ``NS'``, ``NL'``: N numbers each, as :data:`SELECTIONS` says.
    neighbours : mapping of str to tuple of tuple of int
        ``JT``, ``JS``, ``JL``, ``JTR``, ``JTC``, ``JS'``, ``JL'``: (N, N), row i the links that those joints pair with
        link i, packed to the left and filled up with 0.
    """

    links: tuple[str, ...]
    springs: int
    dampers: int
    xi: Table
    n: Table
    s: Table
    counts: Mapping[str, tuple[int, ...]]
    neighbours: Mapping[str, tuple[tuple[int, ...], ...]]


def matrix_arrays(matrix: MechanismMatrix) -> MatrixArrays:
    """Derive the paper's arrays.

    Parameters
    ----------
    matrix : MechanismMatrix

    Returns
    -------
    MatrixArrays
    """
    size = len(matrix.rows)
    found = {name: _neighbours(matrix, *selection) for name, selection in SELECTIONS.items()}
    return MatrixArrays(
        matrix.links, matrix.springs, matrix.dampers, _factor(matrix, _XI), _factor(matrix, _N), _factor(matrix, _S),
        MappingProxyType({f"N{name}": tuple(map(len, rows)) for name, rows in found.items()}),
        MappingProxyType({
            f"J{name}": tuple(row + (0,) * (size - len(row)) for row in rows) for name, rows in found.items()
        }),
    )  # fmt: skip


def _factor(matrix: MechanismMatrix, values: Mapping[str, int]) -> Table:
    return tuple(tuple(values.get(symbol) for symbol in row) for row in matrix.rows)


def _neighbours(matrix: MechanismMatrix, kinds: str, above: bool) -> list[tuple[int, ...]]:
    return [
        tuple(j + 1 for j, symbol in enumerate(row) if symbol[-1] in kinds and (j > i or not above))
        for i, row in enumerate(matrix.rows)
    ]
