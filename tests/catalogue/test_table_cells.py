"""Tables with clocks, texts, gaps and footers, as loggers write them: each is the plain recording, or says why not."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from jointplay.app.problems import say
from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.measurements.measurement import Recording, read_measurement

RATE, COUNT = 1000.0, 600
TIMES = np.arange(COUNT) / RATE
SIGNAL = np.round(
    np.column_stack([np.sin(2 * np.pi * 7 * TIMES) + 0.3 * np.sin(2 * np.pi * 31 * TIMES), np.cos(40 * TIMES)]), 6
)
BEGAN = datetime(2026, 9, 23, 14, 5, 6, tzinfo=UTC)
HEADER = "t [s],a [m/s2],b [m/s2]"
CURE = "(option --profile, field profile, in the form 'Profile')"


def moments(form: str, began: datetime = BEGAN) -> Iterator[str]:
    return ((began + timedelta(seconds=float(each))).strftime(form) for each in TIMES)


def table(times: Iterator[str] | Sequence[str], header: str, end: str = "", after: str = "") -> bytes:
    rows = [f"{time},{a},{b}{end}" for time, (a, b) in zip(times, SIGNAL.tolist(), strict=True)]
    return ("\n".join([header, *rows, ""]) + after).encode()


def plain(**changed: str) -> bytes:
    """A table, of which lines are others: ``plain(line_5="...")``."""
    lines = table([f"{each:.3f}" for each in TIMES], HEADER).decode().split("\n")
    for name, line in changed.items():
        lines[int(name.removeprefix("line_")) - 1] = line
    return "\n".join(lines).encode()


def german(data: bytes) -> bytes:
    return data.replace(b",", b";").replace(b".", b",")


def read(data: bytes, **profile: object) -> Recording:
    return read_measurement(data, name="r.csv", profile=ImportProfile.model_validate(profile))


def refusal(data: bytes, **profile: object) -> str:
    with pytest.raises(MeasurementError) as caught:
        read(data, **profile)
    return say(caught.value)


CLOCKS: dict[str, tuple[Callable[[], bytes], datetime | None]] = {
    "two columns": (lambda: table(moments("%Y-%m-%d,%H:%M:%S.%f"), "Date,Time,a [m/s2],b [m/s2]"), BEGAN),
    "two quoted columns": (lambda: table(moments('"%Y-%m-%d","%H:%M:%S.%f"'), "Date,Time,a [m/s2],b [m/s2]"), BEGAN),
    "two German columns": (
        lambda: german(table(moments("%d#%m#%Y,%H:%M:%S.%f"), "Datum,Uhrzeit,a [m/s2],b [m/s2]")).replace(b"#", b"."),
        BEGAN,
    ),
    "time of day": (lambda: table(moments("%H:%M:%S.%f"), "Time,a [m/s2],b [m/s2]"), None),
    "time of day, the date above": (
        lambda: b"Date,2026-09-23\n\n" + table(moments("%H:%M:%S.%f"), "Time,a [m/s2],b [m/s2]"),
        BEGAN,
    ),
    "over midnight": (
        lambda: table(moments("%H:%M:%S.%f", datetime(2026, 9, 23, 23, 59, 59, 800_000)), "Time,a [m/s2],b [m/s2]"),
        None,
    ),
    "over midnight in two columns": (
        lambda: table(
            moments("%m/%d/%y,%H:%M:%S.%f", datetime(2026, 2, 1, 23, 59, 59, 800_000)), "Date,Time,a [m/s2],b [m/s2]"
        ),
        None,
    ),
    "American": (lambda: table(moments("%m/%d/%Y %H:%M:%S.%f"), "Time,a [m/s2],b [m/s2]"), BEGAN),
    "American with halves of a day": (lambda: table(moments("%m/%d/%Y %I:%M:%S.%f %p"), "T,a [m/s2],b [m/s2]"), BEGAN),
    "over noon": (
        lambda: table(
            moments("%m/%d/%Y %I:%M:%S.%f %p", datetime(2026, 9, 23, 11, 59, 59, 800_000)), "T,a [m/s2],b [m/s2]"
        ),
        datetime(2026, 9, 23, 11, 59, 59, 800_000, tzinfo=UTC),
    ),
}


@pytest.mark.parametrize("form", CLOCKS)
def test_clocks_are_times(form: str) -> None:
    make, began = CLOCKS[form]
    found = read(make())
    assert found.sample_rate == RATE and found.channel_names == ("a", "b") and found.measured_at == began
    assert np.array_equal(found.signal, SIGNAL)


def test_a_date_that_may_be_read_in_two_ways_says_no_moment_and_how_to_give_one() -> None:
    data = table(moments("%m/%d/%Y %I:%M:%S.%f %p", datetime(2026, 9, 3, 2, 5)), "Time,a [m/s2],b [m/s2]")
    found = read(data)
    assert found.measured_at is None and np.array_equal(found.signal, SIGNAL)
    assert "may begin with the day or with the month" in found.warnings[0]
    assert found.warnings[0].endswith("give measured_at")
    given = read(data, measured_at="2026-09-03T02:05:00Z")
    assert given.measured_at == datetime(2026, 9, 3, 2, 5, tzinfo=UTC) and not given.warnings


def test_no_time_of_a_day_is_no_time() -> None:
    for cell in ("25:61:00", "13:00:00 PM", "31/31/2026 10:00:00", "vorhin"):
        data = table([cell] * COUNT, "Time,a [m/s2],b [m/s2]")
        assert f"line 2: column 'Time': {cell!r}: is no time that is known" in refusal(data)
        left = read(data, ignore=["Time"], sample_rate_hz=RATE)
        assert np.array_equal(left.signal, SIGNAL)


def test_a_column_of_text_is_left_out_and_reported() -> None:
    times = [f"{each:.3f}" for each in TIMES]
    found = read(table(times, f"{HEADER},Status", end=",OK"))
    assert found.channel_names == ("a", "b") and np.array_equal(found.signal, SIGNAL) and not found.warnings
    assert "column 4 'Status': text, no signal: left out" in found.import_report
    blanks = table(times, f"{HEADER},Status", end=",OK").replace(b",", b"  ")
    assert np.array_equal(read(blanks).signal, SIGNAL)
    sensor = read(table(times, f"{HEADER},c [g]", end=",n.c."))
    assert sensor.warnings == ("column 'c [g]' left out: it holds text, no numbers",)
    late = table(times, f"{HEADER},Status", end=",OK").replace(b"0.500,", b"x,")
    assert "line 502: column 't': 'x': is not a number" in refusal(late)


def test_columns_that_are_ignored_may_hold_anything() -> None:
    times = [f"{each:.3f}" for each in TIMES]
    cells = ["OK", "17", "", "n/a", "late"]
    rows = table(times, f"{HEADER},Remark", end=",@").decode().split("\n")
    mixed = "\n".join(row.replace("@", cells[place % 5]) for place, row in enumerate(rows)).encode()
    found = read(mixed, ignore=["Remark"])
    assert found.channel_names == ("a", "b") and np.array_equal(found.signal, SIGNAL)
    once = plain(line_300="0.298,Fehler,0.5")
    assert "is not a number: correct it, or leave out the column by ignore in a profile" in refusal(once)
    assert read(once, ignore=["a"]).channel_names == ("b",)


@pytest.mark.parametrize("cell", ["", "NaN", "nan", "#N/A", "n/a", "---"])
def test_a_cell_without_a_number_is_filled(cell: str) -> None:
    a, b = SIGNAL[298]
    for line, channel in ((f"0.298,{cell},{b}", "a"), (f"0.298,{a},{cell}", "b")):
        found = read(plain(line_300=line))
        assert np.abs(found.signal - SIGNAL).max() < 1e-4
        assert found.warnings[0].startswith(f"channel {channel!r}: 1 cell has no number: filled from the rows beside")
        assert found.warnings[0] in found.import_report


@pytest.mark.parametrize("cell", ["Overflow", "OVR", "-OL", "over range"])
def test_an_overload_is_no_gap(cell: str) -> None:
    """What a blow was is not what stands beside it."""
    once = plain(line_300=f"0.298,{cell},0.5")
    rule = "is beyond the range that was measured: measure again in a wider one, or leave out the column by ignore"
    assert refusal(once).startswith(f"r.csv: line 300: column 'a': '{cell}': {rule}")
    assert read(once, ignore=["a"]).channel_names == ("b",)


def test_cells_without_a_number_at_the_ends_are_held() -> None:
    found = read(plain(line_2=f"0.000,,{SIGNAL[0, 1]}", line_601=f"0.599,,{SIGNAL[-1, 1]}"))
    assert found.signal.shape == SIGNAL.shape and "2 cells have no number" in found.warnings[0]
    assert found.signal[[0, -1], 0].tolist() == SIGNAL[[1, -2], 0].tolist()


def test_long_gaps_are_dropouts_and_too_many_are_refused() -> None:
    gap = {f"line_{line}": f"{(line - 2) / RATE:.3f},,{SIGNAL[line - 2, 1]}" for line in range(300, 330)}
    found = read(plain(**gap))
    assert [(flaw.channel, flaw.kind, flaw.first, flaw.last) for flaw in found.flaws] == [("a", "dropout", 298, 328)]
    assert "30 cells have no number" in found.warnings[0] and "are dropouts" in found.warnings[0]
    most = {f"line_{line}": f"{(line - 2) / RATE:.3f},,{SIGNAL[line - 2, 1]}" for line in range(200, 560)}
    expected = "column 'a': 360 of 600 cells have no number, more than have one: leave it out by ignore in a profile"
    assert f"{expected} {CURE}" in refusal(plain(**most))
    assert read(plain(**most), ignore=["a"]).channel_names == ("b",)


def test_gaps_that_would_spoil_a_channel_are_refused() -> None:
    noise = np.random.default_rng(0).normal(size=COUNT)
    rows = [
        f"{time:.3f},{'' if n % 5 == 3 else a:},{a:.4f}" for n, (time, a) in enumerate(zip(TIMES, noise, strict=True))
    ]
    said = refusal("\n".join([HEADER, *rows, ""]).encode())
    assert "column 'a': 120 cells have no number: filled, " in said and "more than 10%" in said and CURE in said


def test_times_lines_of_spectra_and_tachos_are_not_filled() -> None:
    said = refusal(plain(line_300=",1.0,0.5"))
    assert "line 300: column 't': has no number: take the row out" in said and CURE in said
    lines = [f"{n},{'' if n == 50 else n % 7 + 1}" for n in range(300)]
    spectrum = "\n".join(["f [Hz],a [g rms]", *lines, ""]).encode()
    with pytest.raises(MeasurementError, match=r"line 52: column 'a': has no number: lines of a spectrum"):
        read_recording(spectrum, name="r.csv")
    gap = plain(line_300="0.298,,0.5")
    assert "column 'a': is to be the tacho, but has no number in 1 of its cells" in refusal(gap, tacho={"column": "a"})


def test_words_after_the_table_are_noted() -> None:
    for after in ("\nEnd of data\n", "Average,0.1,0.2\n", ";;;\n,,\n", "# done\nEnd of data\n", "Mean;0.1\n" * 30):
        found = read(plain() + after.encode())
        assert np.array_equal(found.signal, SIGNAL) and not found.warnings
        assert any("after the table: not used" in line for line in found.import_report)
    assert "line 602: 1 fields, expected 3" in refusal(plain() + b"17\n")
    assert "line 300: column 't': 'Pause'" in refusal(plain(line_300="Pause,1,2"))
    clock = table(moments("%H:%M:%S.%f"), "Time,a [m/s2],b [m/s2]", after="End of data\n")
    assert np.array_equal(read(clock).signal, SIGNAL)


def test_a_channel_that_never_changes_is_refused_with_its_cure() -> None:
    times = [f"{each:.3f}" for each in TIMES]
    data = table(times, f"{HEADER},c [g]", end=",0")
    rule = "column 'c': 0.0: the channel never changes: if it is no sensor, leave it out by ignore: [c] in a profile"
    assert f"{rule} {CURE}" in refusal(data)
    assert np.array_equal(read(data, ignore=["c"]).signal, SIGNAL)


@pytest.mark.parametrize("none", [None, float("nan")])
def test_cells_of_parquet_files_are_filled_too(none: float | None) -> None:
    held = {"t [s]": TIMES, "a [m/s2]": [*SIGNAL[:298, 0], none, *SIGNAL[299:, 0]], "b [m/s2]": SIGNAL[:, 1]}
    file = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(held), file)
    found = read_measurement(file.getvalue(), name="r.parquet")
    assert np.abs(found.signal - SIGNAL).max() < 1e-4
    assert found.warnings[0].startswith("channel 'a': 1 cell has no number: filled from the rows beside")
