"""Heads of tables as loggers write them: endings, counters, lines of units, brackets that hold no unit."""

from __future__ import annotations

import numpy as np
import pytest
from fuzz.files import whole_files

from jointplay.app.problems import say
from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.channel_units import is_counter_name, split_label
from jointplay.catalogue.measurements.drivespeed import track_speed
from jointplay.catalogue.measurements.measurement import Recording, read_measurement

COUNT, RATE = 300, 500.0
SIGNAL = np.random.default_rng(5).normal(size=(COUNT, 2)).round(6)
PLAIN = [f"{n / RATE:.3f},{a},{b}" for n, (a, b) in enumerate(SIGNAL.tolist())]


def text(*lines: str) -> bytes:
    return "\n".join([*lines, ""]).encode()


def read(data: bytes, name: str = "r.csv", **options: object) -> Recording:
    return read_measurement(data, name=name, **options)  # type: ignore[arg-type]


def refusal(data: bytes, name: str = "r.csv", **options: object) -> str:
    with pytest.raises(MeasurementError) as caught:
        read(data, name, **options)
    return say(caught.value)


LABVIEW = text(
    "LabVIEW Measurement\t", "Separator\tTab", "Date\t2026/09/03", "Time\t14:05:06,1234", "***End_of_Header***\t", "\t",
    "Channels\t2\t\t", f"Samples\t{COUNT}\t{COUNT}", "Y_Unit_Label\tm/s^2\tg", "X0\t0,0\t0,0",
    "***End_of_Header***\t\t\t", "X_Value\ta\tb\tComment", *(row.replace(",", "\t").replace(".", ",") for row in PLAIN),
)  # fmt: skip


@pytest.mark.parametrize("name", ["r.lvm", "r.LVM", "r.asc", "r.dat", "r.txt"])
def test_tables_of_other_endings(name: str) -> None:
    found = read(LABVIEW, name)
    assert found.channel_names == ("a", "b") and found.sample_rate == RATE
    assert [channel.unit for channel in found.channels] == ["m/s^2", "g"]
    assert np.array_equal(found.signal, SIGNAL * [1.0, 9.80665])
    assert found.measured_at is not None and found.measured_at.isoformat().startswith("2026-09-03T14:05:06.1234")


def test_files_of_other_kinds_keep_their_loose_endings() -> None:
    files = whole_files()
    for name in ("r.npz", "r.h5", "0.uff"):
        assert read(files[name], "r.dat").signal.shape == (300, 2)
    assert "is not a text file" in refusal(b"\x00\x01\x02" * 99, "r.dat")


def test_all_kinds_that_are_read_are_listed() -> None:
    said = refusal(LABVIEW, "r.xyz")
    assert said.endswith(".wave, .xlsm, .xlsx") and ".lvm" in said and "..." not in said


@pytest.mark.parametrize("name", ["Sample", "Index", "No.", "Nr", "Sample No", "", "Unnamed: 0", "Messwert-Nr."])
def test_a_counter_of_rows_is_left_out_and_reported(name: str) -> None:
    label = f"{name},t [s],a [g],b [g]"
    found = read(text(label, *(f"{n},{row}" for n, row in enumerate(PLAIN))))
    assert found.channel_names == ("a", "b") and found.sample_rate == RATE and not found.warnings
    assert f"column 1 {name!r}: counts the rows, no signal: left out" in found.import_report
    jumps = [f"{n + (n > 200)},{row}" for n, row in enumerate(PLAIN)]
    assert "has no unit" in refusal(text(label, *jumps))


def test_names_of_signals_are_no_counters() -> None:
    assert not any(map(is_counter_name, ("a", "s1-x", "speed", "piston", "Kanal 1 x", "t")))
    ramp = text("t [s],ramp,b [g]", *(f"{n / RATE},{n},{n % 7}" for n in range(COUNT)))
    said = refusal(ramp)
    assert "column 'ramp': has no unit" in said and "leave it out by ignore in a profile" in said
    assert "(option --unit, field units, in the form 'Unit')" in said
    assert read(ramp, units={"ramp": "mm"}).channel_names == ("ramp", "b")


@pytest.mark.parametrize("word", ["Einheit", "Unit:", "Units"])
def test_a_line_of_units_may_be_called_so(word: str) -> None:
    rows = [f"{n};{a};{b}".replace(".", ",") for n, (a, b) in enumerate(SIGNAL.tolist())]
    found = read(text("Abtastfrequenz [Hz];500", "Kanalname;a;b", f"{word};m/s²;g", *rows))
    assert found.sample_rate == RATE and found.channel_names == ("a", "b")
    assert np.array_equal(found.signal, SIGNAL * [1.0, 9.80665])
    assert "column 1 'Kanalname': counts the rows, no signal: left out" in found.import_report


@pytest.mark.parametrize(
    ("label", "name", "unit"),
    [
        ("Untitled (Filtered)", "Untitled (Filtered)", None),
        ("s1-x (raw)", "s1-x (raw)", None),
        ("a (geglättet)", "a (geglättet)", None),
        ("oil (degC)", "oil", "degC"),
        ("oil (°C)", "oil", "°C"),
        ("force (N)", "force", "N"),
        ("level (dB re 1e-6 m/s2)", "level", "dB re 1e-6 m/s2"),
        ("a (g rms)", "a", "g rms"),
        ("a (1/min)", "a", "1/min"),
        ("a [Filtered]", "a", "Filtered"),
    ],
)
def test_a_bracket_that_holds_no_unit_is_part_of_the_name(label: str, name: str, unit: str | None) -> None:
    assert split_label(label) == (name, unit)


def test_names_with_brackets_are_given_units() -> None:
    data = text("t [s],Untitled (Filtered),Untitled 1", *PLAIN)
    assert "column 'Untitled (Filtered)': has no unit" in refusal(data)
    assert read(data, units={"*": "g"}).channel_names == ("Untitled (Filtered)", "Untitled 1")


def test_a_speed_that_is_not_found_says_how_to_give_it_and_what_else_it_may_be() -> None:
    noise = np.random.default_rng(1).normal(size=(20_000, 1))
    with pytest.raises(MeasurementError) as caught:
        track_speed(noise, 1000.0, 62.8)
    said = say(caught.value)
    assert "stand out: give the speed, unless this is a recording of another machine or of one at rest" in said
    assert said.endswith("(option --speed, field speed, in the form 'Drive speed')")
