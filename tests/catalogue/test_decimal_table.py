"""The quick reader of plain tables agrees to the last bit with a reader of everything, or leaves it to that."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from jointplay.catalogue.measurements.readers.decimal_table import plain_table

FORMS = ("{:.4f}", "{:.6g}", "{:.3e}", "{:+.2E}", " {:.5f} ", "{:.0f}", "{:.17g}", "{!r}")


@given(
    rows=st.lists(st.lists(st.floats(-1e12, 1e12), min_size=3, max_size=3), min_size=1, max_size=5),
    form=st.sampled_from(FORMS),
    delimiter=st.sampled_from(",;\t|"),
)
def test_numbers_are_those_of_a_careful_reader(rows: list[list[float]], form: str, delimiter: str) -> None:
    text = "".join(delimiter.join(form.format(value) for value in row) + "\n" for row in rows)
    found = plain_table(text, delimiter, 3)
    assume(found is not None)  # more than fifteen digits are left to others
    assert found is not None
    expected = np.loadtxt(io.StringIO(text), delimiter=delimiter, ndmin=2)
    assert np.array_equal(found, expected)
    assert np.array_equal(np.signbit(found), np.signbit(expected))


@given(mantissa=st.integers(-(10**15), 10**15), places=st.integers(0, 22))
def test_numbers_of_fifteen_digits_are_read_here(mantissa: int, places: int) -> None:
    text = f"{mantissa}e-{places}"
    found = plain_table(text, ",", 1)
    assert found is not None
    assert found[0, 0] == float(text)


def test_a_recording_is_plain() -> None:
    found = plain_table("0.0000,-0.3888,.5\n0.0001,1.,-2e-3\n0.0002,+7,3E2", ",", 3)
    assert found is not None
    assert found.tolist() == [[0.0, -0.3888, 0.5], [0.0001, 1.0, -0.002], [0.0002, 7.0, 300.0]]


@pytest.mark.parametrize(
    "text",
    [
        "1,2\n1,2,3\n",
        "1,2\n1\n",
        "1,2\n1,\n",
        "1,2,\n",
        "1,2\n\n3,4\n",
        "1,2\n# 3,4\n",
        '1,"2"\n',
        "1,nan\n",
        "1,inf\n",
        "1,1e400\n",
        "1,1e\n",
        "1,1e+\n",
        "1,0x10\n",
        "1,1_000\n",
        "1,1.2.3\n",
        "1,--2\n",
        "1,12345678901234567890\n",
        "1,.\n",
        "1,-\n",
        "1,²\n",
        "1,2\x00\n",
        "1 2,3\n",
        "\n",
    ],
)
def test_what_is_not_plain_is_left_to_another(text: str) -> None:
    assert plain_table(text, ",", 2) is None
