"""The paper's arrays: its quick-return mechanism written down by hand, and what holds for any matrix."""

from __future__ import annotations

import hypothesis.strategies as st
import pytest
from hypothesis import given

from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.machines.matrix import SELECTIONS, MechanismMatrix, matrix_arrays

#: Frame, crank, block, rocker, coupler, ram; the pins of block on crank and of rocker on frame are worn. By hand from
#:    4  B  0 -C  0 -A
#:    B  0 -C  0  0  0
#:    0  C  0 -A  0  0
#:    C  0  A  0  B  0
#:    0  0  0  B  0  B
#:    A  0  0  0  B  4
COUNTS = {
    "NT": [2, 2, 1, 2, 2, 1],
    "NS": [1, 0, 1, 1, 0, 1],
    "NL": [3, 2, 2, 3, 2, 2],
    "NTR": [1, 0, 0, 1, 1, 0],
    "NTC": [1, 1, 0, 0, 0, 0],
    "NS'": [1, 0, 1, 0, 0, 0],
    "NL'": [3, 1, 1, 1, 1, 0],
}
LISTS = {
    "JT": [[2, 4], [1, 3], [2], [1, 5], [4, 6], [5]],
    "JS": [[6], [], [4], [3], [], [1]],
    "JL": [[2, 4, 6], [1, 3], [2, 4], [1, 3, 5], [4, 6], [1, 5]],
    "JTR": [[2], [], [], [5], [6], []],
    "JTC": [[4], [3], [], [], [], []],
    "JS'": [[6], [], [4], [], [], []],
    "JL'": [[2, 4, 6], [3], [4], [5], [6], []],
}


@pytest.fixture(scope="module")
def quick_return() -> MechanismMatrix:
    return MechanismMatrix.from_machine(shipped_machine("quick-return"), ["A", "C"])


def test_counts_and_lists_of_the_quick_return(quick_return: MechanismMatrix) -> None:
    arrays = matrix_arrays(quick_return)
    assert (len(arrays.links), arrays.springs, arrays.dampers) == (6, 4, 4)
    assert {name: list(counts) for name, counts in arrays.counts.items()} == COUNTS
    padded = {name: [row + [0] * (6 - len(row)) for row in rows] for name, rows in LISTS.items()}
    assert {name: [list(row) for row in rows] for name, rows in arrays.neighbours.items()} == padded


def test_factors_of_the_quick_return(quick_return: MechanismMatrix) -> None:
    arrays = matrix_arrays(quick_return)

    def entries(table: tuple[tuple[int | None, ...], ...]) -> dict[tuple[int, int], int]:
        return {(i + 1, j + 1): x for i, row in enumerate(table) for j, x in enumerate(row) if x is not None}

    worn = {(1, 4): 1, (4, 1): 1, (2, 3): 1, (3, 2): 1}
    ideal = dict.fromkeys([(1, 2), (2, 1), (4, 5), (5, 4), (5, 6), (6, 5)], 0)
    assert entries(arrays.xi) == worn | ideal
    assert entries(arrays.n) == {(1, 4): 2, (4, 1): 1, (2, 3): 2, (3, 2): 1}  # the block and the rocker carry the pins
    assert entries(arrays.s) == {(1, 6): 0, (6, 1): 1, (3, 4): 0, (4, 3): 1}


def test_arrays_cannot_be_changed(quick_return: MechanismMatrix) -> None:
    arrays = matrix_arrays(quick_return)
    with pytest.raises(TypeError):
        arrays.counts["NT"] = ()  # type: ignore[index]
    with pytest.raises(AttributeError):
        arrays.springs = 3  # type: ignore[misc]


@st.composite
def matrices(draw: st.DrawFn) -> MechanismMatrix:
    size = draw(st.integers(2, 9))
    rows = [["0"] * size for _ in range(size)]
    for i in range(size):
        for j in range(i):
            rows[i][j] = draw(st.sampled_from(("0", "A", "B", "C", "-C")))
            rows[j][i] = {"0": "0", "A": "-A", "B": "B", "C": "-C", "-C": "C"}[rows[i][j]]
    rows[0][0], rows[-1][-1] = (str(draw(st.integers(0, 9))) for _ in range(2))
    return MechanismMatrix.parse(rows, [f"L{i}" for i in range(size)], "drawn")


@given(matrices())
def test_any_matrix(matrix: MechanismMatrix) -> None:
    arrays = matrix_arrays(matrix)
    size, pairs = len(matrix.links), list(matrix.pairs())
    links = range(size)
    packed: dict[str, list[list[int]]] = {}
    for name in SELECTIONS:
        rows = arrays.neighbours[f"J{name}"]
        packed[name] = [list(row[:count]) for row, count in zip(rows, arrays.counts[f"N{name}"], strict=True)]
        for row, listed in zip(rows, packed[name], strict=True):
            assert all(listed)  # no gap: as many neighbours as the count says, then zeros
            assert not any(row[len(listed) :])
            assert listed == sorted(set(listed))
    for name in ("T", "S", "L"):
        assert all((j + 1 in packed[name][i]) == (i + 1 in packed[name][j]) for i in links for j in links)
    assert [sorted(packed["T"][i] + packed["S"][i]) for i in links] == packed["L"]
    assert [sorted(packed["TR"][i] + packed["TC"][i] + packed["S'"][i]) for i in links] == packed["L'"]
    assert packed["L'"] == [[j for j in packed["L"][i] if j > i + 1] for i in links]
    # Every joint once above the diagonal, twice in the whole matrix; the paper's J is their number.
    assert sum(arrays.counts["NL'"]) == len(pairs) == sum(arrays.counts["NL"]) / 2
    for i in links:
        for j in links:
            assert arrays.xi[i][j] == arrays.xi[j][i]
            assert (arrays.xi[i][j] is not None) == (j + 1 in packed["T"][i])
            assert (arrays.n[i][j], arrays.n[j][i]) in ([(1, 2), (2, 1)] if arrays.xi[i][j] else [(None, None)])
            assert arrays.s[i][j] == ((i > j) if j + 1 in packed["S"][i] else None)
