"""When a recording was made, as files of every kind say it, and what is left out because it may mean something else."""

from __future__ import annotations

import io
import json
import struct
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import pytest
import scipy.io
import soundfile

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile, parse_profile
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.measurements.readers.moments import find_in_lines, find_in_members, read_moment

RATE = 2000.0
SIGNAL = np.random.default_rng(5).normal(size=(300, 2)).round(3)
AT = datetime(2024, 11, 21, 10, 3, 5, tzinfo=UTC)


def table(*head: str, times: np.ndarray | None = None, label: str = "time [s]") -> bytes:
    """A table with lines above it."""
    at = np.arange(len(SIGNAL)) / RATE if times is None else times
    rows = [f"{time:.6f},{a},{b}" for time, (a, b) in zip(at, SIGNAL, strict=True)]
    return "\n".join([*head, f"{label},a [g],b [g]", *rows, ""]).encode()


def of_table(*head: str, **profile: str) -> Recording:
    return read_measurement(table(*head), name="r.csv", profile=ImportProfile.model_validate(profile))


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("21.11.2024 10:03:05", AT),
        ("21.11.2024, 10:03:05 Uhr", AT),
        ("2024-11-21T10:03:05Z", AT),
        ("2024-11-21T11:03:05+01:00", AT),
        ("2024/11/21 05:03:05 -0500", AT),
        ("2024-11-21 11:03:05 MEZ", AT),
        ("11/21/2024 10:03:05 AM", AT),
        ("21/11/2024 10:03:05", AT),
        ("Thu Nov 21 10:03:05 2024", AT),
        ("Do 21.11.2024 10:03:05", AT),
        ("21 November 2024 10:03:05", AT),
        ("21. Nov. 2024, 10:03:05", AT),
        ("November 21, 2024 10:03:05", AT),
        ("2024-11-21 10:03:05,25", AT + timedelta(seconds=0.25)),
        ("2024/11/21 10:03:05.1234567", AT + timedelta(microseconds=123456)),
        ("1732183385", AT),
        ("1732183385250", AT + timedelta(seconds=0.25)),
        ("3/3/2024 12:30 AM", datetime(2024, 3, 3, 0, 30, tzinfo=UTC)),
        ("12. März 2024 12:30 pm", datetime(2024, 3, 12, 12, 30, tzinfo=UTC)),
    ],
)
def test_dates_as_loggers_write_them(text: str, moment: datetime) -> None:
    found, whole = read_moment(text)
    assert whole
    assert (found if found.tzinfo else found.replace(tzinfo=UTC)) == moment


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("03/04/2024 10:03", "may begin with the day or with the month"),
        ("3-4-2024", "may begin with the day or with the month"),
        ("21.11.24 10:03", "year of two digits"),
        ("21-Nov-24", "year of two digits"),
        ("31.02.2024", "no day of the calendar"),
        ("2024-13-01", "no day of the calendar"),
        ("21.11.2024 24:03", "no time of the day"),
        ("21.11.2024 13:03 pm", "no time of the day"),
        ("2024-11-21 10:03:05 EST", "time zone EST"),
        ("2024-11-21 10:03:05+23:10", "no such time zone"),
        ("1904-01-01 00:00:00", "before 1970"),
        ("0001-01-01", "before 1970"),
        ("9999-12-31 23:59 -0100", "outside of the calendar"),
        ("2999-01-01", "more than a day ahead"),
        ("2024-11-21 10.03.00", "has a time of a form that is not known"),
        ("2024-11-21 10h03", "has a time of a form that is not known"),
    ],
)
def test_what_is_not_sure_is_left_out_with_a_way_on(text: str, rule: str) -> None:
    found = of_table(f"Date: {text}")
    assert found.measured_at is None
    (warning,) = found.warnings
    assert warning.startswith("line 1: ") and rule in warning and warning.endswith("give measured_at")
    given = of_table(f"Date: {text}", measured_at="2024-11-21T10:03:05Z")
    assert (given.measured_at, given.warnings) == (AT, ())


@pytest.mark.parametrize(
    "head",
    [
        ("Datum;21.11.2024 10:03:05",),
        ("# Date: 2024-11-21 10:03:05",),
        ("% Start time = 2024-11-21T10:03:05",),
        ("Time stamp, 2024-11-21 10:03:05",),
        ('"Start","2024-11-21 10:03:05"',),
        ("Date (UTC): 2024-11-21 10:03:05",),
        ("Messung vom 21.11.2024 10:03:05",),
        ("Fecha y hora: 21/11/2024 10:03:05",),
        ("Date\t2024/11/21\t2024/11/21", "Time\t10:03:05\t10:03:05"),
        ("Uhrzeit;10:03:05", "Datum;21.11.2024"),
        ("Startzeit: 10:03:05", "Startdatum: 21.11.2024"),
        ("Date: 2024-12-24 08:00", "Start time: 2024-11-21 10:03:05", "End time: 2024-11-21 10:04"),
        ("Calibration date: 2020-01-01", "Exported: 2024-12-01 00:00", "Recorded at: 2024-11-21 10:03:05"),
    ],
)
def test_lines_above_a_table(head: tuple[str, ...]) -> None:
    found = of_table("logger 7", *head)
    assert found.measured_at == AT
    assert not found.warnings
    (said,) = (line for line in found.import_report if "measured at" in line)
    assert "2024-11-21 10:03:05 UTC" in said
    assert any(line == "line 1: 'logger 7': not used" for line in found.import_report)


@pytest.mark.parametrize(
    "line",
    [
        "Time: 12.5 s",
        "Data: 12 channels",
        "Date:",
        "Start: 3",
        "Calibration date: 2020-01-01",
        "Date: 12-Nov",
        "Serial 12",
    ],
)
def test_lines_that_say_nothing_of_it(line: str) -> None:
    assert find_in_lines([(0, line)]) == (None, set())
    found = of_table(line)
    assert found.measured_at is None and not found.warnings


def test_a_zone_that_is_missing_is_utc_unless_given_and_said() -> None:
    head = "Datum;21.07.2024 10:03:05"
    plain, berlin, offset = (
        of_table(head),
        of_table(head, time_zone="Europe/Berlin"),
        of_table(head, time_zone="-02:00"),
    )
    assert plain.measured_at == datetime(2024, 7, 21, 10, 3, 5, tzinfo=UTC)
    assert plain.import_report[1] != berlin.import_report[1]
    assert any("no time zone: taken as UTC, unless time_zone is given" in line for line in plain.import_report)
    assert berlin.measured_at == datetime(2024, 7, 21, 8, 3, 5, tzinfo=UTC)
    assert any("no time zone: taken as Europe/Berlin" in line for line in berlin.import_report)
    assert offset.measured_at == datetime(2024, 7, 21, 12, 3, 5, tzinfo=UTC)
    stated = of_table("Datum;21.07.2024 10:03:05 UTC", time_zone="Europe/Berlin")
    assert stated.measured_at == plain.measured_at
    day = of_table("Datum;21.07.2024")
    assert day.measured_at == datetime(2024, 7, 21, tzinfo=UTC)
    assert any("a day alone" in line for line in day.import_report)


def test_members_of_a_zone() -> None:
    for members in ({"start_time_utc": "1732183385", "time": "10:03"}, {"start_time_utc": "1732183385"}):
        found, used = find_in_members(members)
        assert found is not None and used == {"start_time_utc"}
        assert read_moment(found.text) == (AT, True)
    found, used = find_in_members({"date_utc": "2024-11-21", "time": "10:03:05", "operator": "N.N."})
    assert found is not None and used == {"date_utc", "time"}
    assert read_moment(found.text) == (AT, True)


def test_times_that_count_from_1970() -> None:
    times = AT.timestamp() + np.arange(len(SIGNAL)) / 50.0
    found = read_measurement(table(times=times), name="r.csv")
    assert found.measured_at == AT and found.sample_rate == pytest.approx(50.0)
    since_start = read_measurement(table(times=times - times[0] + 5e4), name="r.csv")
    assert since_start.measured_at is None
    header_first = read_measurement(table("Start: 2024-11-20 10:00", times=times), name="r.csv")
    assert header_first.measured_at == datetime(2024, 11, 20, 10, tzinfo=UTC)


def test_what_a_profile_says_goes_before_the_file(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(table("Date: 2023-01-01 00:00"))
    (tmp_path / "r.csv.yaml").write_text("measured_at: 2024-11-21T12:03:05\ntime_zone: +02:00\n")
    found = read_measurement(tmp_path / "r.csv")
    assert found.measured_at == AT
    assert any(line == "line 1: not used: its sender says when it was measured" for line in found.import_report)


@pytest.mark.parametrize(
    ("member", "rule"),
    [
        ("measured_at: 2024-11-21", "must be a date with a time"),
        ("measured_at: 21.11.2024 10:03", "must be a date with a time"),
        ('measured_at: "2024-02-30T10:03:00Z"', "no day of the calendar"),
        ("measured_at: 2024-02-30T10:03:00Z", "day is out of range"),
        ("measured_at: 1969-12-31T23:59:59Z", "lies before 1970"),
        ("measured_at: 2999-01-01T00:00:00Z", "lies more than a day ahead"),
        ("measured_at: 0001-01-01T00:00:00+14:00", "outside of the calendar"),
        ("measured_at: 1732183385", "must be a date with a time"),
        ("time_zone: Berlin", "must be a time zone"),
        ("time_zone: +25:00", "must be a time zone"),
        ("time_zone: ../UTC", "must be a time zone"),
        ("time_zone: Europe", "must be a time zone"),
    ],
)
def test_profiles_that_say_it_wrongly(member: str, rule: str) -> None:
    with pytest.raises(MeasurementError, match=rule) as caught:
        parse_profile(member, "p.yaml")
    assert "\n" not in str(caught.value) and str(caught.value).startswith("p.yaml: ")


def test_a_recording_of_arrays() -> None:
    def made(moment: datetime) -> Recording:
        return Recording.from_arrays(SIGNAL, RATE, ["a", "b"], measured_at=moment)

    assert made(AT).measured_at == made(AT.replace(tzinfo=None)).measured_at == AT
    with pytest.raises(MeasurementError, match="before 1970"):
        made(datetime(1960, 1, 1))


# --- other kinds of files ---------------------------------------------------------------------------------------------


def wav(*chunks: tuple[bytes, bytes]) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, SIGNAL / 8.0, int(RATE), format="WAV", subtype="PCM_16")
    whole = file.getvalue()
    more = b"".join(name + struct.pack("<I", len(held)) + held + b"\0" * (len(held) % 2) for name, held in chunks)
    return whole[:4] + struct.pack("<I", len(whole) - 8 + len(more)) + whole[8:12] + more + whole[12:]


def bext(date: str, time: str) -> tuple[bytes, bytes]:
    return b"bext", b"\0" * 320 + f"{date:<10}{time:<8}".encode() + b"\0" * 264


def info(date: str) -> tuple[bytes, bytes]:
    held = date.encode() + b"\0"
    return b"LIST", b"INFO" + b"ICRD" + struct.pack("<I", len(held)) + held + b"\0" * (len(held) % 2)


def of_wav(*chunks: tuple[bytes, bytes]) -> Recording:
    return read_measurement(wav(*chunks), name="r.wav", profile=ImportProfile(full_scale="5 g"))


def test_wav_files() -> None:
    assert of_wav().measured_at is None
    assert of_wav(bext("2024-11-21", "10:03:05")).measured_at == AT
    assert of_wav(bext("2024:11:21", "10-03-05")).measured_at == AT
    assert of_wav(info("2024-11-21 10:03:05")).measured_at == AT
    assert of_wav(info("2020-01-01"), bext("2024-11-21", "10:03:05")).measured_at == AT
    assert of_wav(info("2024-11-21")).measured_at == datetime(2024, 11, 21, tzinfo=UTC)
    empty = of_wav(bext("\0" * 10, "\0" * 8))
    assert empty.measured_at is None and not empty.warnings
    year = of_wav(info("2024"))
    assert year.measured_at is None and "'2024' is no date" in year.warnings[0]
    short = of_wav((b"bext", b"2024-11-21"))
    assert short.measured_at is None and not short.warnings


def uff(third: str) -> bytes:
    axis = "         0    0    0    0                NONE                 g"
    head = ["    -1", "    58", "a", "NONE", third, "NONE", "NONE",
            "    1         0    0         0       NONE         1   1       NONE         0   0",
            f"         4{len(SIGNAL):10d}         1  0.00000e+00  {1 / RATE:.5e}  0.00000e+00",
            *(axis.replace("         0", f"{kind:10d}", 1) for kind in (17, 12, 0, 0))]  # fmt: skip
    numbers = [" ".join(f"{value:20.11e}" for value in SIGNAL[k : k + 4, 0]) for k in range(0, len(SIGNAL), 4)]
    return "\n".join([*head, *numbers, "    -1", ""]).encode()


@pytest.mark.parametrize(
    ("third", "moment"),
    [
        ("21-Nov-24 10:03:05", AT),
        ("21-NOV-2024 10:03:05", AT),
        ("21-Nov-85 10:03:05", AT.replace(year=1985)),
        ("NONE", None),
        ("21-11-24", None),
    ],
)
def test_universal_files(third: str, moment: datetime | None) -> None:
    found = read_measurement(uff(third), name="r.uff")
    assert found.measured_at == moment and not [line for line in found.warnings if "measured" in line]


def tdms(root: dict[str, Any], **properties: Any) -> bytes:
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        own = {"wf_increment": 1.0 / RATE, "unit_string": "g", **properties}
        channels = [nptdms.ChannelObject("g", name, SIGNAL[:, i], own) for i, name in enumerate("ab")]
        writer.write_segment([nptdms.RootObject(root), *channels])
    return file.getvalue()


def test_tdms_files() -> None:
    start = np.datetime64("2024-11-21T10:03:05")
    for content in (
        tdms({}, wf_start_time=start),
        tdms({"DateTime": np.datetime64("2024-11-25T00:00:00")}, wf_start_time=start),
        tdms({"Date": "21.11.2024", "Time": "10:03:05"}, wf_start_time=np.datetime64("1904-01-01T00:00:00")),
    ):
        assert read_measurement(content, name="r.tdms").measured_at == AT
    unset = read_measurement(tdms({}, wf_start_time=np.datetime64("1904-01-01T00:00:00")), name="r.tdms")
    assert unset.measured_at is None and not unset.warnings


def mat(**more: Any) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, {"y": SIGNAL, "fs": RATE, "unit": "g", **more})
    return file.getvalue()


def test_files_of_named_arrays(tmp_path: Path) -> None:
    plain = read_measurement(mat(), name="r.mat")
    assert plain.measured_at is None  # the header says when it was written
    assert any("not taken for the time of measurement" in line for line in plain.import_report)
    assert read_measurement(mat(start_time="2024-11-21 10:03:05"), name="r.mat").measured_at == AT
    assert read_measurement(mat(info={"Date": "21.11.2024", "Time": "10:03:05"}), name="r.mat").measured_at == AT
    assert read_measurement(mat(start_time=AT.timestamp()), name="r.mat").measured_at == AT
    assert read_measurement(mat(start_time=0.5), name="r.mat").measured_at is None
    for name, value in (("measured_at", "2024-11-21T10:03:05Z"), ("timestamp", AT.timestamp())):
        with h5py.File(tmp_path / "r.h5", "w") as held:
            held.create_dataset("y", data=SIGNAL).attrs["unit"] = "g,g"
            held["fs"] = RATE
            held.attrs[name] = value
            held.attrs["units"] = "SI"  # of no array
        assert read_measurement(tmp_path / "r.h5").measured_at == AT
    file = io.BytesIO()
    attributes = json.dumps({"measured_at": "2024-11-21T10:03:05Z", "fs": RATE})
    np.savez(file, y=SIGNAL, unit=np.array("g"), attributes=np.array(attributes))
    assert read_measurement(file.getvalue(), name="r.npz").measured_at == AT


def test_json_and_a_spectrum() -> None:
    channels = [{"name": "a", "unit": "g", "values": SIGNAL[:, 0].tolist()}]
    held = {"sample_rate_hz": RATE, "channels": channels, "measured_at": "2024-11-21T11:03:05+01:00"}
    assert read_measurement(json.dumps(held).encode(), name="r.json").measured_at == AT
    with pytest.raises(MeasurementError, match="measured_at"):
        read_measurement(json.dumps({**held, "measured_at": 5}).encode(), name="r.json")
    rows = "\n".join(f"{k},{abs(value) + 1}" for k, value in enumerate(SIGNAL[:, 0]))
    spectrum = f"Date: 2024-11-21 10:03:05\nfrequency [Hz],a [(m/s2)^2/Hz]\n{rows}\n".encode()
    assert read_recording(spectrum, name="s.csv").measured_at == AT
