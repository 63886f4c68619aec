"""Texts that are no recordings: refused early, in little memory and time, whatever they would unpack to."""

from __future__ import annotations

import gzip

import pytest

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.measurements.readers import Limits

TABLE = b"t [s],x [m/s2]\n" + b"".join(b"%.4f,%d\n" % (1e-4 * k, k % 7) for k in range(2000))
NO_LINE = "holds a line of more than 1 MB, as no table of numbers does"
TOO_MUCH = "unpacks to more than 100 times its size, as no recording does"


@pytest.mark.parametrize(
    ("unit", "megabytes", "rule"),
    [
        (b"1234567890", 40, NO_LINE),
        (b",", 40, NO_LINE),
        (b" ", 40, NO_LINE),
        (b"1,", 3, NO_LINE),
        (b"\n", 40, TOO_MUCH),
        (b"0,0,0\n", 40, TOO_MUCH),
    ],
)
def test_bombs_are_refused_before_they_go_off(unit: bytes, megabytes: int, rule: str) -> None:
    packed = gzip.compress(unit * (megabytes * 1_000_000 // len(unit)), 1)
    # What goes on to unpack or to read them takes more than this.
    limits = Limits(reader_memory=90_000_000, reader_seconds=5.0)
    with pytest.raises(MeasurementError) as caught:
        read_measurement(packed, name="bomb.csv.gz", limits=limits)
    assert str(caught.value) == f"bomb.csv.gz: {rule}"
    assert len(read_measurement(TABLE, name="a.csv").signal) == 2000


def test_a_line_without_end_in_the_middle_of_a_table_is_refused() -> None:
    with pytest.raises(MeasurementError, match=NO_LINE):
        read_measurement(TABLE + 3_000_000 * b"5", name="a.csv")


@pytest.mark.parametrize("rows", [900_000, 3_300_000])
def test_a_text_that_takes_too_long_is_refused_and_the_next_one_is_read(rows: int) -> None:
    """A small one without a child, and a large one with one."""
    table = TABLE + b"1,2,\n" * rows
    with pytest.raises(MeasurementError, match=r"^a\.csv: text file: takes longer than 0\.0?1 s to be read$"):
        read_measurement(table, name="a.csv", limits=Limits(reader_seconds=0.01))
    assert len(read_measurement(TABLE, name="a.csv").signal) == 2000


def test_lines_are_told_of_tables_with_gaps() -> None:
    """They come from another process: rows below comments and empty lines, too."""
    lines = TABLE.decode().splitlines()
    lines[5:5] = ["# pause", "", ""]
    lines[1000] = lines[1000].replace(",", ",-")
    lines[1500] = "0.0001,3"  # the time goes back
    with pytest.raises(MeasurementError, match=r"line 1502: column 't'"):
        read_measurement("\n".join(lines).encode(), name="a.csv")
