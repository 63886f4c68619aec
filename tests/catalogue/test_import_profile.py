"""Profiles: what a file does not say, said once for all files of an origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile, load_profile, parse_profile
from jointplay.catalogue.measurements.measurement import read_measurement

SIGNAL = np.random.default_rng(4).normal(size=(300, 2)).round(4)
ROWS = [f"{n / 1000:.3f};{a:.4f};{b:.4f};20,5".replace(".", ",") for n, (a, b) in enumerate(SIGNAL)]
ANALYSER = "\n".join(["1;2;3;4", "5;6;7;8", "9;9;9;9", "Laufzeit;Kanal 1;Kanal 2;Temp", *ROWS, ""]).encode()
PROFILE = """
delimiter: ";"
decimal: ","
skip_lines: 3
time_column: Laufzeit
units: {Laufzeit: s, Kanal 1: g, Kanal 2: m/s2}
sensors: {Kanal 1: s1-x, Kanal 2: s1-y}
ignore: [Temp]
"""


def refusal(profile: str, data: bytes = ANALYSER) -> str:
    with pytest.raises(MeasurementError) as caught:
        read_measurement(data, name="r.csv", profile=parse_profile(profile, "p.yaml"))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_profile_makes_a_recording_of_an_analysers_table() -> None:
    found = read_measurement(ANALYSER, name="r.csv", profile=parse_profile(PROFILE, "p.yaml"))
    assert found.channel_names == ("s1-x", "s1-y") and found.sample_rate == 1000.0
    assert np.allclose(found.signal, SIGNAL * [9.80665, 1.0])
    assert any("'Kanal 1': s1-x in g, as the profile says" in line for line in found.import_report)
    with pytest.raises(MeasurementError):
        read_measurement(ANALYSER, name="r.csv")


def test_names_may_come_from_the_profile_alone() -> None:
    table = "\n".join(f"{a} {b}" for a, b in SIGNAL).encode()
    profile = ImportProfile(channels=("a [g]", "b [mm/s2]"), sample_rate_hz=500.0)
    found = read_measurement(table, name="r.txt", profile=profile)
    assert found.sample_rate == 500.0 and np.allclose(found.signal, SIGNAL * [9.80665, 1e-3])
    with pytest.raises(MeasurementError, match="the profile names 1 channels, the file has 2"):
        read_measurement(table, name="r.txt", profile=ImportProfile(channels=("a",)))


def test_a_profile_beside_the_file_is_found(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(ANALYSER)
    (tmp_path / "r.csv.yaml").write_text(PROFILE)
    assert read_measurement(tmp_path / "r.csv").channel_names == ("s1-x", "s1-y")
    with pytest.raises(MeasurementError, match=r"none\.yaml: cannot be read"):
        load_profile(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("profile", "rule"),
    [
        ("delimitr: x", "p.yaml: column 'delimitr': 'x': extra inputs are not permitted"),
        ("skip_lines: -1", "column 'skip_lines': '-1': input should be greater than or equal to 0"),
        ("units: {a: g", "p.yaml: column 'line 1': is not YAML"),
        ("[1]", "must be a mapping"),
        (PROFILE.replace("Temp]", "Tempo]"), "column 'Tempo': the profile's ignore names it; columns are Laufzeit"),
        (PROFILE.replace("time_column: Laufzeit", "time_column: Zeit"), "is the profile's time_column"),
        (PROFILE + "full_scale: 5 g", "'full_scale': is given, but the file does not hold fractions of one"),
        (PROFILE.replace('";"', '"|"'), "no table"),
    ],
)
def test_refusals_name_field_value_and_rule(profile: str, rule: str) -> None:
    assert rule in refusal(profile)
