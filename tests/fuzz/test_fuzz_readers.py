"""A small share of `make fuzz-readers`, always the same; and whatever bytes hypothesis thinks of."""

from __future__ import annotations

import pytest
from fuzz.files import whole_files
from fuzz.readers import campaign, ending
from hypothesis import given, settings
from hypothesis import strategies as st


def test_whole_files_are_read() -> None:
    files = whole_files()
    assert {ending(name, data, "none") for name, data in files.items()} == {"read"}
    assert len(files) == 12


def test_damaged_files_are_refused_or_read_as_what_they_are() -> None:
    found = campaign(96, seed=1)
    assert set(found) == {"read", "refused"} and found["refused"] > found["read"] > 0, found


@pytest.mark.parametrize("name", ["r.wav", "r.tdms", "r.mat", "r.npz", "r.uff", "r.h5", "r.json", "r.csv"])
@settings(max_examples=12, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_any_bytes_are_refused_in_one_line(name: str, data: st.DataObject) -> None:
    heads = (b"", b"RIFF\0\0\0\0WAVEfmt ", b"TDSm", b"MATLAB 5.0".ljust(128, b"\0"), b"PK\x03\x04", b"    -1\n    58\n",
             b"\x89HDF\r\n\x1a\n", b'{"channels": [')  # fmt: skip
    content = data.draw(st.sampled_from(heads)) + data.draw(st.binary(max_size=400))
    assert ending(name, content, "none") == "refused"
