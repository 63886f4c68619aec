"""Files as loggers, phones and spreadsheets write them: each is the same recording again, or refused with its cure.

They are written here character by character (workbooks as XML), by nothing that reads them.
"""

from __future__ import annotations

import gzip
import io
import re
import sys
import zipfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pyarrow
import pyarrow.feather
import pyarrow.parquet
import pytest
from recordings import unpacked
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from jointplay.app.problems import say
from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.measurements.readers import kinds, tables
from jointplay.solver.arrays import FloatArray

RATE = 10_000.0
BEGAN = datetime(2026, 11, 21, 10, 0, tzinfo=UTC)
NAMES = ("s1-x", "s1-y", "s2-x", "s2-y")
HEAD = [f"{name} [m/s2]" for name in NAMES]
RNG = np.random.default_rng


@pytest.fixture(scope="module")
def signal() -> FloatArray:
    """Accelerations of a machine, with its impacts (25000, 4)."""
    lines = unpacked("slider-crank-02.csv").decode().splitlines()
    first = next(index for index, line in enumerate(lines) if re.match(r"[\d.]+,", line))
    return np.array([line.split(",")[1:] for line in lines[first:]], dtype=float)


def csv(head: Sequence[str], times: Sequence[str], values: FloatArray, end: str = "", *, above: str = "") -> bytes:
    rows = [",".join([time, *(f"{each:.6g}" for each in row)]) + end for time, row in zip(times, values, strict=True)]
    return (above + "\n".join([",".join(head), *rows]) + "\n").encode()


def german(data: bytes) -> bytes:
    return data.replace(b",", b";").replace(b".", b",")


def seconds(count: int, form: str = ".4f", factor: float = 1.0, start: float = 0.0) -> list[str]:
    return [format(start + factor * index / RATE, form) for index in range(count)]


def dates(count: int, form: str) -> list[str]:
    return [(BEGAN + timedelta(microseconds=100 * index)).strftime(form) for index in range(count)]


def workbook(rows: Sequence[Sequence[object]], sheets: Sequence[Sequence[Sequence[object]]] = ()) -> bytes:
    """Sheets of numbers, texts and moments, as the standard (ECMA-376) has them."""

    def cell(value: object) -> str:
        if isinstance(value, datetime):
            days = (value.replace(tzinfo=None) - datetime(1899, 12, 30)) / timedelta(days=1)
            return f'<c s="1"><v>{days!r}</v></c>'
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{escape(value)}</t></is></c>'
        return f"<c><v>{value!r}</v></c>"

    space = "http://schemas.openxmlformats.org"
    main, relation = f"{space}/spreadsheetml/2006/main", f"{space}/officeDocument/2006/relationships"
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    all_sheets = [*sheets, rows]
    numbers = range(1, len(all_sheets) + 1)
    files = {
        "[Content_Types].xml": f'<Types xmlns="{space}/package/2006/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{kind}.sheet.main+xml"/>'
        f'<Override PartName="/xl/styles.xml" ContentType="{kind}.styles+xml"/>'
        + "".join(
            f'<Override PartName="/xl/s{n}.xml" ContentType="{kind}.worksheet+xml"/>' for n in numbers
        )
        + "</Types>",
        "_rels/.rels": f'<Relationships xmlns="{space}/package/2006/relationships">'
        f'<Relationship Id="r" Type="{relation}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{relation}"><sheets>'
        + "".join(f'<sheet name="S{n}" sheetId="{n}" r:id="r{n}"/>' for n in numbers)
        + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{space}/package/2006/relationships">'
        + "".join(f'<Relationship Id="r{n}" Type="{relation}/worksheet" Target="s{n}.xml"/>' for n in numbers)
        + f'<Relationship Id="st" Type="{relation}/styles" Target="styles.xml"/></Relationships>',
        "xl/styles.xml": f'<styleSheet xmlns="{main}"><numFmts count="1">'
        '<numFmt numFmtId="164" formatCode="yyyy\\-mm\\-dd hh:mm:ss.000"/></numFmts>'
        '<cellXfs count="2"><xf numFmtId="0"/><xf numFmtId="164" applyNumberFormat="1"/></cellXfs></styleSheet>',
    }  # fmt: skip
    for number, sheet in zip(numbers, all_sheets, strict=True):
        body = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in sheet)
        files[f"xl/s{number}.xml"] = f'<worksheet xmlns="{main}"><sheetData>{body}</sheetData></worksheet>'
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, f'<?xml version="1.0" encoding="UTF-8" standalone="yes"?>{text}')
    return packed.getvalue()


def arrow(times: object, values: FloatArray, name: str = "time") -> pyarrow.Table:
    units = {b"unit": b"m/s2"}
    fields = [pyarrow.field(each, pyarrow.float64(), metadata=units) for each in NAMES]
    column = pyarrow.array(times)
    schema = pyarrow.schema([pyarrow.field(name, column.type), *fields])
    return pyarrow.table([column, *map(pyarrow.array, values.T)], schema=schema)


def parquet(table: pyarrow.Table) -> bytes:
    file = io.BytesIO()
    pyarrow.parquet.write_table(table, file)
    return file.getvalue()


def feather(table: pyarrow.Table) -> bytes:
    file = io.BytesIO()
    pyarrow.feather.write_feather(table, file)
    return file.getvalue()


def moments(count: int) -> np.ndarray:
    return np.datetime64("2026-11-21T10:00:00", "ns") + np.arange(count) * np.timedelta64(100_000, "ns")


LABVIEW = (
    "LabVIEW Measurement,\nSeparator,Comma\n***End_of_Header***,\n\nChannels,4,,\nDate,2026/11/21,2026/11/21\n"
    "Time,10:00:00,10:00:00\nX_Dimension,Time,Time\nX0,0.0,0.0\nDelta_X,0.0001,0.0001\n***End_of_Header***,,,\n"
)

#: Name, file of (n, 4) values, and when it says that it was measured.
FILES: dict[str, tuple[str, Callable[[FloatArray], bytes], datetime | None]] = {
    "iso": ("r.csv", lambda v: csv(["timestamp", *HEAD], dates(len(v), "%Y-%m-%dT%H:%M:%S.%f"), v), BEGAN),
    "iso with a zone": (
        "r.csv",
        lambda v: csv(["Time", *HEAD], dates(len(v), "%Y-%m-%dT%H:%M:%S.%f+02:00"), v),
        BEGAN - timedelta(hours=2),
    ),
    "german dates": (
        "r.csv",
        lambda v: german(csv(["Zeit", *HEAD], dates(len(v), "%d-%m-%Y %H:%M:%S.%f"), v)).replace(b"21-11-", b"21.11."),
        BEGAN,
    ),
    "dates in quotes": ("r.csv", lambda v: csv(["t", *HEAD], dates(len(v), '"%Y-%m-%d %H:%M:%S.%f"'), v), BEGAN),
    "epoch s": ("r.csv", lambda v: csv(["timestamp", *HEAD], seconds(len(v), start=BEGAN.timestamp()), v), BEGAN),
    "epoch ms": (
        "r.csv",
        lambda v: csv(["timestamp_ms", *HEAD], seconds(len(v), ".1f", 1e3, 1e3 * BEGAN.timestamp()), v),
        BEGAN,
    ),
    "epoch us": ("r.csv", lambda v: csv(["t", *HEAD], seconds(len(v), ".0f", 1e6, 1e6 * BEGAN.timestamp()), v), BEGAN),
    "epoch ns": (
        "r.csv",
        lambda v: csv(["time", *HEAD], [str(round(BEGAN.timestamp()) * 10**9 + 100_000 * i) for i in range(len(v))], v),
        BEGAN,
    ),
    "t without a unit": ("r.csv", lambda v: csv(["t", *HEAD], seconds(len(v)), v), None),
    "a header behind %": (
        "r.csv",
        lambda v: csv(["% Time", *HEAD], seconds(len(v)), v, above="% LabVIEW Measurement\n% Operator: X\n"),
        None,
    ),
    "surplus cells": ("r.csv", lambda v: csv(["time [s]", *HEAD], seconds(len(v)), v, ",,"), None),
    "surplus cells with a label": ("r.csv", lambda v: csv(["t", *HEAD, "Status"], seconds(len(v)), v, ","), None),
    "LabVIEW": (
        "r.csv",
        lambda v: csv(["X_Value", *HEAD, "Comment"], seconds(len(v)), v, above=LABVIEW).replace(b",", b"\t"),
        BEGAN,
    ),
    "LabVIEW with decimal commas": (
        "r.txt",
        lambda v: german(csv(["X_Value", *HEAD, "Comment"], seconds(len(v)), v)).replace(b";", b"\t"),
        None,
    ),
    "workbook": ("r.xlsx", lambda v: workbook([["t", *HEAD], *np.column_stack([np.arange(len(v)) / RATE, v]).tolist()]),
                 None),
    "workbook with a cover": (
        "r.xlsx",
        lambda v: workbook(
            [["Datum", BEGAN], [], ["Zeit [ms]", *HEAD], *np.column_stack([np.arange(len(v)) / 10.0, v]).tolist()],
            [[["Report"], ["by", "X"]]],
        ),
        BEGAN,
    ),
    "parquet": ("r.parquet", lambda v: parquet(arrow(np.arange(len(v)) / RATE, v, "time [s]")), None),
    "parquet with moments": ("r.parquet", lambda v: parquet(arrow(moments(len(v)), v)), BEGAN),
    "parquet with durations": ("r.pq", lambda v: parquet(arrow(moments(len(v)) - moments(1)[0], v)), None),
    "feather": ("r.feather", lambda v: feather(arrow(moments(len(v)), v, "index")), BEGAN),
    "parquet in gzip": ("r.parquet.gz", lambda v: gzip.compress(parquet(arrow(moments(len(v)), v))), BEGAN),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_the_same_recording_in_files_of_loggers(name: str, signal: FloatArray) -> None:
    file, write, began = FILES[name]
    recording = read_measurement(write(signal[:2000]), name=file)
    assert (recording.sample_rate, recording.channel_names, recording.measured_at) == (RATE, NAMES, began)
    assert recording.signal.shape == (2000, 4) and recording.warnings == ()
    assert np.abs(recording.signal - signal[:2000]).max() < 2e-5 * np.abs(signal).max()


def timed(times: FloatArray, values: FloatArray, head: str = "time [s]", form: str = ".9g") -> bytes:
    return csv([head, *HEAD[: values.shape[1]]], [format(time, form) for time in times], values)


def error_of(recording: Recording, wanted: FloatArray) -> float:
    """Largest error of a channel, in parts of its rms."""
    count = min(len(recording.signal), len(wanted))
    off = recording.signal[:count] - wanted[:count]
    return float((off.std(axis=0) / wanted.std(axis=0)).max())


def test_times_that_are_noise_about_an_even_clock(signal: FloatArray) -> None:
    times = np.arange(len(signal)) / RATE
    for spread, form in ((20e-6, ".9g"), (8e-6, ".9g"), (0.0, ".3f")):  # the last are printed to ten intervals
        found = read_measurement(timed(times + RNG(1).normal(0.0, spread, len(times)), signal, form=form), name="r.csv")
        assert found.sample_rate == RATE and found.signal.shape == signal.shape
        assert error_of(found, signal) < 1e-5
        assert any("taken as even" in each for each in found.warnings) == (spread > 0.0)


def test_times_that_are_uneven_are_resampled(signal: FloatArray) -> None:
    places = np.arange(len(signal)) + np.r_[0.0, RNG(2).normal(0.0, 0.08, len(signal) - 1)]
    at_times = CubicSpline(np.arange(len(signal)), signal)(places)
    found = read_measurement(timed(places / RATE, at_times), name="r.csv")
    as_even = read_measurement(timed(np.arange(len(signal)) / RATE, at_times), name="r.csv")
    assert found.sample_rate == RATE and error_of(found, signal) < 0.2 * error_of(as_even, signal)
    assert any("resampled to 10000 Hz" in each for each in found.warnings)
    assert any("spline of degree 5" in each for each in found.import_report)


def test_a_phone(signal: FloatArray) -> None:
    """400 Hz with 8 % jitter of the intervals, behind the filter of its sensor."""
    filtered = CubicSpline(np.arange(len(signal)) / RATE, sosfiltfilt(butter(8, 160, fs=RATE, output="sos"), signal, 0))
    steps = np.r_[0.0, RNG(3).normal(1.0, 0.08, 950).cumsum()] / 400.0
    found = read_measurement(timed(steps, filtered(steps), "Time (s)"), name="phyphox.csv")
    assert found.sample_rate == pytest.approx(400.0, rel=0.02)
    even = filtered(np.arange(len(found.signal)) / found.sample_rate)
    assert error_of(found, even) < 0.02 and any("uneven" in each for each in found.warnings)


def test_missing_rows_are_filled_or_dropouts(signal: FloatArray) -> None:
    times = np.arange(len(signal)) / RATE
    kept = np.ones(len(signal), dtype=bool)
    kept[RNG(4).choice(len(signal) - 2, 300, replace=False) + 1] = False
    found = read_measurement(timed(times[kept], signal[kept]), name="r.csv")
    assert found.sample_rate == RATE and found.signal.shape == signal.shape and error_of(found, signal) < 0.02
    assert any("300 rows are missing" in each for each in found.warnings) and found.flaws == ()
    kept[:] = True
    kept[9000:9300] = False
    found = read_measurement(timed(times[kept], signal[kept]), name="r.csv")
    assert found.signal.shape == signal.shape
    assert {(flaw.channel, flaw.kind, flaw.first, flaw.last) for flaw in found.flaws} == {
        (name, "dropout", 9000, 9300) for name in NAMES
    }
    whole = np.r_[0:9000, 9300 : len(signal)]
    assert np.abs(found.signal[whole] - signal[whole]).max() < 1e-5 * np.abs(signal).max()


def test_what_uneven_rows_would_alias_is_refused() -> None:
    white = RNG(5).normal(size=(4000, 2))
    kept = RNG(6).random(4000) > 0.03
    missing = refusal(timed(np.arange(4000)[kept] / RATE, white[kept]))
    assert re.search(r"column 's\d-\w': \d+ rows are missing: even samples would have \d\d% of its rms wrong", missing)
    uneven = np.sort(RNG(7).uniform(0.0, 0.4, 4000))
    told = refusal(timed(uneven - uneven[0], white))
    assert "times are uneven: even samples would have" in told
    assert "(option --sample-rate, field sample_rate, in the form 'Sample rate')" in told
    assert read_measurement(timed(uneven - uneven[0], white), name="r.csv", sample_rate=RATE).sample_rate == RATE
    told = read_measurement(timed(np.arange(4000)[kept] / RATE, white[kept]), name="r.csv", sample_rate=RATE).warnings
    assert any("rows seem to be missing" in each for each in told)
    back = np.r_[np.arange(2000), np.arange(2000)] / RATE
    ends = np.r_[np.arange(3999), 1e12] / RATE
    assert "line 4001: column 'time': 100000000.0: 999999996001 rows are missing, more than are there" in refusal(
        timed(ends, white, form=".17g")
    )
    assert "line 2002: column 'time': 0.0: time does not rise" in refusal(timed(back, white))


def refusal(data: bytes, name: str = "r.csv") -> str:
    with pytest.raises(MeasurementError) as caught:
        read_recording(data, name=name)
    assert "\n" not in say(caught.value)
    return say(caught.value)


UNITS = "(option --unit, field units, in the form 'Unit')"


@pytest.mark.parametrize(
    ("data", "expected", "cure"),
    [
        (csv(["t", "ax"], seconds(400), np.ones((400, 1))), "column 'ax': has no unit", UNITS),
        # 100 Hz for 120 s, or 100 kHz for 0.12 s.
        (timed(np.arange(12_000) / 100.0, RNG(0).normal(size=(12_000, 1)), "t"), "unit, and s as well as ms", UNITS),
        (timed(np.arange(3000.0), RNG(0).normal(size=(3000, 1)), "t"), "'t': has no unit, and ms would do", UNITS),
        (timed(np.arange(400.0), RNG(0).normal(size=(400, 1)), "f [Hz]"), "'m/s2': does not say what it is",
         "(option --scaling, field scaling, in the form 'Scaling')"),
        (b"1,2\n" * 400, "no header line", "(option --profile, field profile, in the form 'Profile')"),
        (csv(["a [g]", "b [g]"], seconds(400), np.ones((400, 1))), "states no sample rate",
         "(option --sample-rate, field sample_rate, in the form 'Sample rate')"),
    ],
)  # fmt: skip
def test_refusals_name_field_option_and_entry(data: bytes, expected: str, cure: str) -> None:
    assert expected in refusal(data) and refusal(data).endswith(cure)


@pytest.mark.parametrize("ending", ["xlsx", "parquet", "feather"])
def test_damaged_tables_are_refused(ending: str, signal: FloatArray) -> None:
    write = next(write for name, write, _ in FILES.values() if name.endswith(ending))
    data = write(signal[:300])
    assert re.match(
        rf"r\.{ending}: .*is damaged|r\.{ending}: is a damaged", refusal(data[: len(data) // 2], f"r.{ending}")
    )
    assert "ends in .csv, but is" in refusal(data, "r.csv")
    assert "holds no column of numbers" in refusal(parquet(pyarrow.table({"a": ["x"]})), "r.parquet")
    assert refusal(workbook([["nothing"]]), "r.xlsx") == "r.xlsx: is empty"


def test_an_extra_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, library in (("r.xlsx", "python_calamine"), ("r.parquet", "pyarrow")):
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(MeasurementError, match=rf"{library.replace('_', '-')}.*pip install 'jointplay\[tables\]'"):
            tables.import_extra(library, name)


def test_endings_for_content_without_a_name(signal: FloatArray, tmp_path: Path) -> None:
    for name, write, _ in FILES.values():
        if not name.endswith(".gz"):
            ending = kinds.ending_for(write(signal[:300]))
            assert read_measurement(write(signal[:300]), name=f"-{ending}").sample_rate == RATE
