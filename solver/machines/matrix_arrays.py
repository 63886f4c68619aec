"""What the paper derives from the mechanism matrix: factors of the joints, counts and neighbour lists of the links.

The solver does not need them, its equations come from the machine itself; they are what a user of the paper's method
would write down, and a check of the matrix by hand.

Source: Mostafa, Shabara, El-Bahloul, Fanny, Mansoura Engineering Journal 14 (2), items 1 to 12 of the nomenclature.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from jointplay.solver.machines.matrix import MechanismMatrix

__all__ = ["SELECTIONS", "MatrixArrays", "matrix_arrays"]

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
