"""Dialects of tables: what is ruled out at a glance, and where tables begin."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from jointplay.catalogue.measurements.readers.dialect import DIALECTS, Dialect, TableLayout, find_layout

LINES = st.text('0123456789.,;|\t eE+-"infa#x', max_size=20)


@given(LINES)
@example("1.#INF;2")
@example('"1;5";"2,5"')
@example("1,5 2,5\t3")
def test_no_row_of_numbers_is_ruled_out(line: str) -> None:
    for dialect in DIALECTS:
        if all(map(dialect.is_cell, dialect.split(line))):
            assert not dialect.rules_out(line)


@pytest.mark.parametrize("dialect", [each for each in DIALECTS if each != Dialect(",", ".")])
def test_a_plain_row_of_numbers_is_ruled_out_in_all_other_dialects(dialect: Dialect) -> None:
    assert dialect.rules_out("0.0001,-0.25,1e-3")
    assert not Dialect(",", ".").rules_out("0.0001,-0.25,1e-3")


def test_rows_that_are_ruled_out_end_a_table() -> None:
    rows = ["1;2", "3;4", "1.5,2.5;3", "# 5;6", "", "5;6", "7;8", "9;10"]
    assert find_layout(rows, [Dialect(";", ",")]) == TableLayout(Dialect(";", ","), 5, 2)
    assert find_layout(rows, [Dialect(";", ",")], skipped=6) is None
