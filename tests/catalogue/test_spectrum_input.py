"""Spectra of analysers: the same levels as the recording gives, and nothing assumed that the file does not say."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import RECORDINGS, unpacked

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile, SpectrumSaid
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum, read_recording
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.spectrum_features import band_power
from jointplay.solver.machines.machine import shipped_machine

STEP = 0.5
FREQUENCY = STEP * np.arange(800)
LEVEL = np.random.default_rng(2).uniform(0.1, 1.0, 800).round(4)


def table(head: str, values: np.ndarray, *above: str) -> bytes:
    rows = [f"{f:g},{v:.9g}" for f, v in zip(FREQUENCY, values, strict=True)]
    return "\n".join([*above, f"frequency [Hz],{head}", *rows, ""]).encode()


def read(data: bytes, **said: object) -> MeasuredSpectrum:
    profile = ImportProfile(spectrum=SpectrumSaid.model_validate(said)) if said else None
    found = read_recording(data, name="s.csv", profile=profile)
    assert isinstance(found, MeasuredSpectrum)
    return found


def test_a_spectrum_says_what_its_recording_says() -> None:
    machine = shipped_machine("four-bar")
    spectrum = read_recording(RECORDINGS / "four-bar-02-spectrum.csv.gz")
    found = prepare(spectrum, machine)
    plain = prepare(read_measurement(RECORDINGS / "four-bar-02.csv.gz"), machine)
    assert found.drive_speed == pytest.approx(plain.drive_speed, rel=5e-4)
    assert found.speed.uncertainty > 0 and found.channels == ("s1-x", "s1-y", "s2-x", "s2-y")
    count = found.cuts[-1]
    levels = [10.0 * np.log10(each.sensor_bands.auto_power[:count]) for each in (found, plain)]
    off = levels[0] - levels[1]
    assert abs(float(np.median(off))) < 0.3 and float(np.quantile(np.abs(off), 0.9)) < 2.0
    assert any("no phases" in line for line in found.warnings)
    given = prepare(spectrum, machine, speed=plain.drive_speed)
    assert given.speed.given and given.drive_speed == plain.drive_speed


def test_a_spectrum_is_no_recording() -> None:
    with pytest.raises(MeasurementError, match="holds a spectrum, not a recording"):
        read_measurement(RECORDINGS / "four-bar-02-spectrum.csv.gz")


def test_all_forms_of_a_spectrum_are_one() -> None:
    # LEVEL is an rms amplitude in m/s2 with a Hann window, whose lines are 1.5 wide.
    density = LEVEL**2 / (1.5 * STEP)
    for data in (
        table("a [m/s2 rms]", LEVEL, "# Hann window"),
        table("a [mm/s2 peak]", 1000.0 * LEVEL * np.sqrt(2.0), "# hanning"),
        table("a [m/s2 pk-pk]", LEVEL * np.sqrt(8.0), "# window: Hann"),
        table("a [(m/s2)^2/Hz]", density),
        table("a [g^2/Hz]", density / 9.80665**2),
        table("a [dB re 1e-6 m/s2 rms]", 20.0 * np.log10(LEVEL / 1e-6), "# Hann"),
    ):
        assert np.allclose(read(data).density[:, 0], density, rtol=1e-5)
    said = read(table("a [m/s2]", LEVEL**2), scaling="power", detector="rms", window="hann")
    assert np.allclose(said.density[:, 0], density)


@pytest.mark.parametrize(
    ("data", "rule"),
    [
        (table("a [m/s2]", LEVEL), "give its scaling"),
        (table("a [m/s2 rms]", LEVEL), "give its window"),
        (table("a [(m/s2)^2]", LEVEL, "# Hann"), "give its detector"),
        (table("a [dB rms]", LEVEL, "# Hann"), "levels without a reference"),
        (table("a [m/s2 rms]", -LEVEL, "# Hann"), "must not be negative"),
        (table("a [V rms]", LEVEL, "# Hann"), "no column is a displacement"),
        (table("a [g rms]", LEVEL, "# Hann").replace(b"\n20,", b"\n20.2,"), "lines are not evenly spaced"),
        (table("a", LEVEL), "has no unit"),
        (table("a [dB re e m/s2 rms]", LEVEL, "# Hann"), "levels without a reference"),
        (table("a [dB re 0 m/s2 rms]", LEVEL, "# Hann"), "its reference must lie between 0 and 1e+30"),
        (table("a [dB re 1e999 m/s2 rms]", LEVEL, "# Hann"), "its reference must lie between 0 and 1e+30"),
    ],
)
def test_what_is_not_said_is_asked_for(data: bytes, rule: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        read(data)
    assert rule in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("head", "said", "rule"),
    [
        ("a [m/s2 rms]", {"detector": "peak", "window": "hann"}, "'m/s2 rms': the profile says peak"),
        ("a [dB re 1e-6 m/s2 rms]", {"reference": 1e-5, "window": "hann"}, "the profile says re 1e-05"),
    ],
)
def test_a_header_and_a_profile_that_contradict_each_other_are_refused(
    head: str, said: dict[str, object], rule: str
) -> None:
    with pytest.raises(MeasurementError, match=rule):
        read(table(head, LEVEL), **said)


def test_bands_split_lines_that_straddle_their_edges() -> None:
    power = band_power(np.ones((800, 1)), FREQUENCY, STEP, np.array([10.0, 20.1, 100.0]))
    assert np.allclose(power[:, 0], [10.1, 79.9])


def test_a_spectrum_without_orders_or_too_coarse_is_refused() -> None:
    machine = shipped_machine("four-bar")
    noise = read(table("s1-x [(m/s2)^2/Hz]", np.ones(800)))
    with pytest.raises(MeasurementError, match="stands out of the spectrum: give the speed"):
        prepare(noise, machine)
    plain = unpacked("four-bar-02-spectrum.csv").decode().splitlines()
    coarse = "\n".join([*plain[:2], *plain[2::3], ""]).encode()
    with pytest.raises(MeasurementError, match=r"lines 3\.66.* Hz apart"):
        prepare(read(coarse), machine)


def test_a_spectrum_that_lacks_low_or_high_orders_is_refused() -> None:
    plain = unpacked("four-bar-02-spectrum.csv").decode().splitlines()

    def beginning(low: float) -> MeasuredSpectrum:
        return read("\n".join([*plain[:2], *(row for row in plain[2:] if float(row.split(",")[0]) > low), ""]).encode())

    machine = shipped_machine("four-bar")  # turns five times a second: its bands begin at 2.5 Hz
    assert prepare(beginning(0.0), machine).cuts[-1] > 20
    with pytest.raises(MeasurementError, match=r"begins at 10\.\d+ Hz: the first band .* begins at 2\.\d+ Hz"):
        prepare(beginning(10.0), machine)
    short = read(b"\n".join(table("s1-x [(m/s2)^2/Hz]", LEVEL).splitlines()[:301]))
    for speed in (None, 60.0):
        with pytest.raises(MeasurementError, match=r"ends at 149\.5 Hz: does not reach order 20 of a drive at"):
            prepare(short, shipped_machine("slider-crank"), speed=speed)
