"""Cursors come back as they were made, and nothing else is taken for one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointplay.app.errors import BadCursorError
from jointplay.app.http import paging


@given(st.text())
def test_round_trip(position: str) -> None:
    assert paging.decode(paging.encode(position)) == position


@given(st.integers(min_value=0, max_value=10**17))
def test_numbers(number: int) -> None:
    assert paging.decode_number(paging.encode(str(number))) == number


@pytest.mark.parametrize(
    "cursor", ["!", "ä", "YQ=", paging.encode("abc"), paging.encode("-1"), paging.encode("9" * 30)]
)
def test_foreign_cursors_are_refused(cursor: str) -> None:
    with pytest.raises(BadCursorError, match="is not a cursor"):
        paging.decode_number(cursor)
