"""Recordings as text: every dialect that is read, and every refusal with its place."""

from __future__ import annotations

import gzip
import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import RECORDINGS, unpacked

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import parse_unit, split_label
from jointplay.catalogue.measurements.measurement import Recording, measurement_of, read_measurement
from jointplay.catalogue.measurements.readers import Limits, RawColumn, RawRecording
from jointplay.catalogue.measurements.readers.kinds import known_ending
from jointplay.solver.machines import units

HEADER = "time [s],s1-x [m/s2],s1-y [g]"


def rows(count: int = 300, fs: float = 1000.0) -> list[str]:
    values = np.random.default_rng(0).normal(size=(count, 2))
    return [f"{n / fs:.4f},{a:.5f},{b:.5f}" for n, (a, b) in enumerate(values)]


def text(*above: str, body: list[str] | None = None) -> bytes:
    return "\n".join([*(above or (HEADER,)), *(body or rows()), ""]).encode()


def read(data: bytes, name: str = "r.csv", **options: object) -> Recording:
    return read_measurement(data, name=name, **options)  # type: ignore[arg-type]


def refusal(data: bytes, name: str = "r.csv", **options: object) -> str:
    with pytest.raises(MeasurementError) as caught:
        read(data, name, **options)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(name)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    return str(caught.value)


# --- what is read -----------------------------------------------------------------------------------------------------


def test_a_plain_recording() -> None:
    recording = read(text())
    assert recording.sample_rate == 1000.0 and recording.signal.shape == (300, 2) and recording.duration == 0.3
    assert recording.channel_names == ("s1-x", "s1-y")
    assert [channel.quantity for channel in recording.channels] == ["acceleration", "acceleration"]
    plain = np.array([row.split(",") for row in rows()], dtype=float)
    assert np.allclose(recording.signal, plain[:, 1:] * [1.0, 9.80665])
    assert not recording.warnings and len(recording.sha256) == 64 and not recording.signal.flags.writeable
    report = "\n".join(recording.import_report)
    for part in ("UTF-8", "commas", "decimal point", "1000 Hz", "column 2 's1-x [m/s2]'", "column 3", "9.80665"):
        assert part in report


def _german(data: bytes) -> bytes:
    return data.replace(b",", b";").replace(b".", b",")


DIALECTS: dict[str, Callable[[bytes], bytes]] = {
    "as is": lambda data: data,
    "crlf": lambda data: data.replace(b"\n", b"\r\n"),
    "cr": lambda data: data.replace(b"\n", b"\r"),
    "byte order mark": lambda data: b"\xef\xbb\xbf" + data,
    "utf-16": lambda data: data.decode().encode("utf-16"),
    "gzip": gzip.compress,
    "semicolons and decimal comma": _german,
    "semicolons and decimal point": lambda data: data.replace(b",", b";"),
    "tabs": lambda data: data.replace(b",", b"\t"),
    "tabs and decimal comma": lambda data: data.replace(b",", b"\t").replace(b".", b","),
    "bars": lambda data: data.replace(b",", b"|"),
    "blanks": lambda data: data.replace(b",", b" "),
    "many blanks": lambda data: data.replace(b",", b"    "),
    "blanks after commas": lambda data: data.replace(b",", b", "),
    "trailing semicolons": lambda data: data.replace(b",", b";").replace(b"\n", b";\n"),
    "quoted labels": lambda data: data.replace(b"s1-x [m/s2]", b'"s1-x [m/s2]"'),
    "quoted numbers": lambda data: data.replace(b"0.0070,", b'"0.0070",'),
    "no newline at the end": lambda data: data.rstrip(b"\n"),
    "blank lines": lambda data: data.replace(b"\n0.010", b"\n\n0.010"),
    "comments": lambda data: b"# made by a logger, 3 channels\n" + data.replace(b"\n0.010", b"\n# pause\n0.010"),
    "header in a comment": lambda data: b"# " + data,
    "a block of facts": lambda data: b"Messung,Test 7\nDatum,12. Mai\n\n" + data,
}


@pytest.mark.parametrize("dress", DIALECTS)
def test_dialects_hold_the_same_numbers(dress: str) -> None:
    plain, dressed = read(text()), read(DIALECTS[dress](text()))
    assert np.array_equal(plain.signal, dressed.signal)
    assert plain.sample_rate == dressed.sample_rate and plain.channels == dressed.channels


def test_the_same_recording_in_other_clothes() -> None:
    plain = read_measurement(RECORDINGS / "four-bar-02.csv.gz")
    comma = read_measurement(RECORDINGS / "four-bar-02-decimal-comma.csv.gz")
    assert np.array_equal(plain.signal, comma.signal) and plain.sample_rate == comma.sample_rate == 10_000.0
    assert plain.channel_names == comma.channel_names == ("s1-x", "s1-y", "s2-x", "s2-y")
    assert plain.sha256 != comma.sha256
    assert "line 2: sample rate 10000 Hz" in comma.import_report
    assert any("Drehzahl" in fact and "not used" in fact for fact in comma.import_report)


def test_no_recording_of_the_collection_raises_a_false_alarm() -> None:
    for name in json.loads((RECORDINGS / "truth.json").read_text()):
        recording = read_measurement(RECORDINGS / f"{name}.csv.gz")
        assert recording.warnings == () and recording.sample_rate == 10_000.0 and recording.signal.shape[1] == 4


def test_fifty_thousand_rows_of_four_columns() -> None:
    data = unpacked("quick-return-01.csv")
    assert read(data).signal.shape == (50_000, 4)


@pytest.mark.parametrize(
    ("label", "name", "quantity", "factor"),
    [
        ("s1-x [m/s2]", "s1-x", "acceleration", 1.0),
        ("s1-x (m/s²)", "s1-x", "acceleration", 1.0),
        ("s1-y/(m/s²)", "s1-y", "acceleration", 1.0),
        ("s1-y/m/s2", "s1-y", "acceleration", 1.0),
        ("a [m/s^2]", "a", "acceleration", 1.0),
        ("a [m/s**2]", "a", "acceleration", 1.0),
        ("a [m s-2]", "a", "acceleration", 1.0),
        ("a [m·s⁻²]", "a", "acceleration", 1.0),
        ("a [m/s/s]", "a", "acceleration", 1.0),
        ("a [ m/s2 ]", "a", "acceleration", 1.0),
        ("a [g]", "a", "acceleration", 9.80665),
        ("a in mg", "a", "acceleration", 9.80665e-3),
        ("a[mm/s2]", "a", "acceleration", 1e-3),
        ("base v (mm/s)", "base v", "velocity", 1e-3),
        ("v [in/s]", "v", "velocity", 0.0254),
        ("v, m/s", "v", "velocity", 1.0),
        ("d [µm]", "d", "displacement", 1e-6),
        ("d [um]", "d", "displacement", 1e-6),
        ("d / mm", "d", "displacement", 1e-3),
        ("d [mil]", "d", "displacement", 2.54e-5),
        ("Zeit/s", "Zeit", "time", 1.0),
        ("T [S]", "T", "time", 1.0),
        ("d [M]", "d", "displacement", 1.0),
        ("Time (ms)", "Time", "time", 1e-3),
        ("f [Hz]", "f", "frequency", 1.0),
    ],
)
def test_labels_and_units(label: str, name: str, quantity: str, factor: float) -> None:
    found, unit_text = split_label(label)
    unit = parse_unit(unit_text or "")
    assert found == name and unit is not None
    assert unit.quantity == quantity and unit.factor == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        ("mg", units.ACCELERATION),
        ("ug", units.ACCELERATION),
        ("m/s/s", units.ACCELERATION),
        ("ips", units.SPEED),
        ("km/h", units.SPEED),
        ("mil", units.LENGTH),
        ("micron", units.LENGTH),
        ("h", units.TIME),
        ("sec", units.TIME),
        ("kHz", units.FREQUENCY),
    ],
)
def test_machine_files_and_recordings_have_one_table(text: str, dimension: units.Dimension) -> None:
    found = parse_unit(text)
    assert found is not None
    assert found.factor == units.to_si(f"1 {text}", dimension)


@pytest.mark.parametrize(
    "label",
    [
        "s1-x",
        "in/out",
        "a/b",
        "x g",
        "a [V]",
        "a [g rms]",
        "a [Mm]",
        "a []",
        "a [Mm/s2]",
        "a [km/s2]",
        "a [kN/kg]",
        "x/H",
        "a [GN9/N9*GN9/N9*GN9/N9*m]",
        "a [" + "GN9*" * 20_000 + "m]",
    ],
)
def test_labels_without_a_unit_are_not_guessed(label: str) -> None:
    assert parse_unit(split_label(label)[1] or "") is None


def test_units_can_be_given_and_stand_in_a_line_of_their_own() -> None:
    bare = text("t,a,b")
    given = read(bare, units={"t": "s", "a": "mm/s", "b": "um"})
    assert [channel.quantity for channel in given.channels] == ["velocity", "displacement"]
    lines = read(text("t,a,b", "s,mm/s,um"))
    assert np.array_equal(given.signal, lines.signal) and lines.channels == given.channels


def test_sample_rate_from_a_header_line_or_given() -> None:
    body = [row.split(",", 1)[1] for row in rows()]
    for line in (
        "# sample rate: 1000 Hz",
        "# Sampling frequency = 1 kHz",
        "# fs=1000",
        "# dt: 1 ms",
        "# sample rate 1,000 Hz",
    ):
        recording = read(text(line, "a [g],b [g]", body=body))
        assert recording.sample_rate == pytest.approx(1000.0), line
        assert any("line 1: sample rate 1000 Hz" in fact for fact in recording.import_report)
    assert read(text("a [g],b [g]", body=body), sample_rate=2500.0).sample_rate == 2500.0


def test_rounded_times_are_not_jitter() -> None:
    body = [f"{n / 25_600:.6f},{n % 7},{n % 5}" for n in range(600)]
    assert read(text(body=body)).sample_rate == pytest.approx(25_600, rel=1e-4)


def test_columns_of_other_quantities_are_left_out_and_said() -> None:
    body = [f"{row},{20 + n % 3}" for n, row in enumerate(rows())]
    recording = read(text(HEADER + ",oil [degC]", body=body))
    assert recording.channel_names == ("s1-x", "s1-y")
    assert any("oil" in warning and "left out" in warning for warning in recording.warnings)


def test_clipping_offset_and_standstill_are_warned_of() -> None:
    t = np.arange(2000) / 1000.0
    wave = np.sin(2 * np.pi * 7 * t) + 0.3 * np.sin(2 * np.pi * 31 * t)

    def warnings(signal: np.ndarray) -> tuple[str, ...]:
        return read(text("time [s],a [g]", body=[f"{a:.3f},{b:.6f}" for a, b in zip(t, signal, strict=True)])).warnings

    assert warnings(wave) == () and warnings(np.sin(2 * np.pi * 7 * t)) == ()
    assert len(warnings(np.clip(wave, -0.9, 0.9))) == 2 and "clipped" in warnings(np.clip(wave, -9, 0.9))[0]
    assert "offset" in warnings(wave + 10.0)[0]
    assert "stands still for 301 samples from 0.5 s" in warnings(np.where((t >= 0.5) & (t <= 0.8), 0.1, wave))[0]


def test_a_recording_from_arrays() -> None:
    columns = (RawColumn("a", "a", "g", "column 1"),)
    raw = RawRecording("sent", columns, np.random.default_rng(0).normal(size=(300, 1)))
    recording = measurement_of(raw, sample_rate=100.0)
    assert recording.signal == pytest.approx(raw.values * 9.80665) and recording.sha256
    raw.values[5, 0] = np.nan
    with pytest.raises(MeasurementError, match=r"sent: column 'a': .*nan.*: is not finite"):
        measurement_of(raw, sample_rate=100.0)


@given(st.lists(st.floats(-1e6, 1e6), min_size=300, max_size=300), st.sampled_from([",", ";", "\t", "|"]))
def test_what_is_written_is_read(values: list[float], delimiter: str) -> None:
    values[:2] = [1.0, 2.0]
    body = [f"{n}{delimiter}{value!r}" for n, value in enumerate(values)]
    recording = read(text(f"time [s]{delimiter}a [m/s2]", body=body))
    assert np.array_equal(recording.signal[:, 0], values)


# --- what is refused --------------------------------------------------------------------------------------------------


def edited(line: int, new: str) -> bytes:
    body = rows()
    body[line - 2] = new  # the header is line 1
    return text(body=body)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (edited(120, "0.118,abc,1"), "r.csv: line 120: column 's1-x': 'abc': is not a number"),
        (edited(120, "0.118,1"), "r.csv: line 120: 2 fields, expected 3"),
        (edited(120, ",1,1"), "r.csv: line 120: column 'time': has no number: take the row out"),
        (edited(120, "0.118,1,2,3"), "r.csv: line 120: 4 fields, expected 3"),
        (edited(120, "nan,1,1"), "r.csv: line 120: column 'time': has no number: take the row out"),
        (edited(120, "0.118,1,-Inf"), "r.csv: line 120: column 's1-y': '-Inf': is not finite"),
        (edited(120, "0.118,1e999,1"), "r.csv: line 120: column 's1-x': '1e999': is not finite"),
        (edited(120, "0.118,1_0,1"), "r.csv: line 120: column 's1-x': '1_0': is not a number"),
        (edited(2, "0.000,x,1"), "r.csv: line 2: column 's1-x': 'x': is not a number"),
        (edited(3, "0.001,x,1"), "r.csv: line 3: column 's1-x': 'x': is not a number"),
        (edited(120, "0.017,1,1"), "r.csv: line 120: column 'time': 0.017: time does not rise"),
        (text(body=rows()[:20]), "r.csv: 20 samples; at least 256 are needed"),
        (text("time [s],s1-x,s1-y [g]"), "r.csv: column 's1-x': has no unit"),
        (text("time [g],s1-x [g],s1-y [g]"), "r.csv: column 'time': 'g': is not a unit of time"),
        (text("time [s],s1-x [V],s1-y [V]"), "no column is a displacement, velocity or acceleration"),
        (text("time [s],a [g],a [g]"), "r.csv: line 1: column 'a': name stands over 2 columns"),
        (text("time [s],a [g]"), "r.csv: line 1: the line above the numbers has 2 fields, the numbers 3"),
        (text(rows()[0], body=rows()[1:]), "the numbers have no header line"),
        (text("frequency [Hz],a [g],b [g]"), "r.csv: column 'frequency [Hz]': the file holds a spectrum"),
        (text("t [s],t2 [s],a [g]"), "r.csv: column 't2': a second time column"),
        (text("# fs = 2000 Hz", HEADER), "the time column has 1000 Hz, but the sample rate stated in the file is 2000"),
        (text("# fs = 2000 Hz", "# dt = 1 ms", HEADER), "r.csv: line 2: sample rate 1000 Hz, but 2000 Hz in line 1"),
        (text(body=[f"{row.rsplit(',', 1)[0]},7" for row in rows()]), "column 's1-y': 68.6"),
        (b"", "r.csv: is empty"),
        (b"\n\n", "r.csv: is empty"),
        (b"\x00\x01\x02" * 99, "r.csv: is not a text file"),
        (b"no numbers\nat all\n", "r.csv: holds no table of numbers"),
        (b"\xef\xbb\xbf\xff\xff", "r.csv: says it is UTF-8 but is not"),
        (gzip.compress(text())[:-20], "r.csv: is a damaged gzip file"),
    ],
)
def test_refusals_name_the_place(data: bytes, expected: str) -> None:
    assert expected in refusal(data)


def test_no_time_and_no_rate_is_refused() -> None:
    body = [row.split(",", 1)[1] for row in rows()]
    assert "give the sample rate" in refusal(text("a [g],b [g]", body=body))
    assert "must be positive" in refusal(text("a [g],b [g]", body=body), sample_rate=-1.0)
    assert "100 Hz, the one stated in the file 1000 Hz" in refusal(
        text("# fs = 1000", "a [g],b [g]", body=body), sample_rate=100.0
    )


@pytest.mark.parametrize("count", [2_000, 20_000, 40_000])
def test_decimals_of_the_times_are_found_at_every_length(count: int) -> None:
    # Every tenth or twentieth of these times has a decimal less.
    measurement = read(text(body=rows(count, fs=10_000.0)))
    assert (measurement.sample_rate, len(measurement.signal)) == (10_000.0, count)


def test_times_of_so_many_digits_have_fewer_decimals_in_the_end() -> None:
    body = [f"{n / 2048:.6g},{n % 7},{n % 5}" for n in range(25_000)]
    assert read(text(body=body)).sample_rate == pytest.approx(2048.0, rel=1e-5)


def test_times_too_coarse_are_refused() -> None:
    body = [f"{n / 10_000:.3f},{n % 7},{n % 5}" for n in range(600)]
    assert "printed to 0.001 s only" in refusal(text(body=body))


def test_units_given_for_no_column_or_of_no_kind_are_refused() -> None:
    assert "column 'q': a unit is given for it, but the columns are time, s1-x, s1-y" in refusal(
        text(), units={"q": "g"}
    )
    assert "column 's1-x': 'V'" in refusal(text(), units={"s1-x": "V"})


def test_limits_hold() -> None:
    assert "is larger than 0.0001 MB" in refusal(text(), limits=Limits(file_bytes=100))
    bomb = gzip.compress(b"0" * 1_000_000)
    assert "holds more than 0.01 MB" in refusal(bomb, limits=Limits(decoded_bytes=10_000))
    assert "3 columns; at most 2 are read" in refusal(text(), limits=Limits(columns=2))


def test_files_that_cannot_be_opened_or_are_of_another_kind(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"missing\.csv: cannot be read: No such file"):
        read_measurement(tmp_path / "missing.csv")
    assert "kind of file .xyz is not read; known: .58b, .arrow, .asc, .csv" in refusal(text(), "r.xyz")
    assert "is an MDF file, which is not read: export it as CSV, TDMS or MAT" in refusal(b"MDF     4.10", "r.mf4")
    assert "export it as CSV" in refusal(text(), "r.MF4.gz") and "export it as CSV" in refusal(b"UnFinMF 4.11", "r.dat")
    assert "without suffix" in refusal(text(), "r")
    assert "is not a gzip file" in refusal(text(), "r.csv.gz")
    assert known_ending("A.CSV.GZ") == ".csv"
