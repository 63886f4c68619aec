"""Files of other kinds than text: the same numbers as the plain file, and every damage named."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import pyuff
import scipy.io
import soundfile
from recordings import RECORDINGS, unpacked

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.measurements.readers import Limits, cell
from jointplay.catalogue.storage.hdf5 import write_arrays

RATE = 2000.0
SIGNAL = np.random.default_rng(3).normal(size=(400, 2))
IN_OTHER_CLOTHES = ("slider-crank-02.wav", "slider-crank-03.uff", "slider-crank-04.mat", "slider-crank-05.tdms")


def content(name: str) -> bytes:
    return unpacked(f"{name}")


def refusal(data: bytes, name: str, **options: Any) -> str:
    with pytest.raises(MeasurementError) as caught:
        read_measurement(data, name=name, **options)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(name)
    return str(caught.value)


def held(found: Recording, exact: float = 1e-12) -> bool:
    return found.sample_rate == RATE and np.allclose(found.signal, SIGNAL, rtol=0.0, atol=exact)


@pytest.mark.parametrize("name", IN_OTHER_CLOTHES)
def test_the_same_data_in_other_clothes(name: str) -> None:
    plain = read_measurement(RECORDINGS / f"{name.partition('.')[0]}.csv.gz")
    other = read_measurement(RECORDINGS / f"{name}.gz")
    assert other.sample_rate == plain.sample_rate and other.channel_names == plain.channel_names
    # The plain file has four digits.
    assert np.abs(other.signal - plain.signal).max() <= 6e-4 * np.abs(plain.signal).max()
    assert not other.warnings


# --- what is written here ---------------------------------------------------------------------------------------------


def mat5(compressed: bool = True, **more: Any) -> bytes:
    file = io.BytesIO()
    names = np.array(["a", "b"], dtype=object)
    scipy.io.savemat(file, {"y": SIGNAL, "fs": RATE, "channels": names, "unit": "g", **more}, do_compression=compressed)
    return file.getvalue()


def mat73(path: Path) -> bytes:
    with h5py.File(path, "w", userblock_size=512) as file:
        file["data/y"] = SIGNAL.T
        file["data/dt"] = [[1.0 / RATE]]
        names = [file.create_dataset(f"#refs#/{name}", data=np.array([[ord(name)]], np.uint16)) for name in "ab"]
        file["data/channels"] = np.array([each.ref for each in names], dtype=h5py.ref_dtype)
        unit = file.create_dataset("data/unit", data=np.array([[ord(c)] for c in "m/s2"], np.uint16))
        unit.attrs["MATLAB_class"] = np.bytes_("char")
    raw = path.read_bytes()
    return b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + raw[128:]


def uff(path: Path, binary: bool, **more: Any) -> bytes:
    opened = pyuff.UFF(str(path))
    for index, name in enumerate("ab"):
        numbers = dict.fromkeys(("orddenom_spec_data_type", "z_axis_spec_data_type"), 0)
        record = {
            "type": 58,
            "binary": int(binary),
            "func_type": 1,
            "id1": name,
            "rsp_node": 1,
            "rsp_dir": 1,
            "ref_node": 1,
            "ref_dir": 1,
            "data": SIGNAL[:, index],
            "x": np.arange(len(SIGNAL)) / RATE,
            "abscissa_spacing": 1,
            "abscissa_inc": 1.0 / RATE,
            "abscissa_spec_data_type": 17,
            "ordinate_spec_data_type": 12,
            "ordinate_axis_units_lab": "m/s^2",
            **numbers,
            **more,
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # the library leaves a file open when it writes
            opened.write_sets(record, "add")
    return path.read_bytes()


def npz(**more: Any) -> bytes:
    file = io.BytesIO()
    units = {"t": "s", "sensor_a": "m/s2", "sensor_b": "m/s2"}
    np.savez_compressed(file, t=np.arange(400) / RATE, sensor_a=SIGNAL[:, 0], sensor_b=SIGNAL[:, 1],
                        frame_acceleration=np.zeros((400, 3)), units=np.array(json.dumps(units)),
                        attributes=np.array(json.dumps({"sample_rate_hz": RATE})), **more)  # fmt: skip
    return file.getvalue()


def wav(coding: str, scale: float = 8.0, channels: int = 2) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, SIGNAL[:, :channels] / scale, int(RATE), format="WAV", subtype=coding)
    return file.getvalue()


def as_json() -> bytes:
    channels = [{"name": "a", "unit": "m/s2", "values": SIGNAL[:, 0].tolist()},
                {"name": "b", "unit": "m/s2", "values": SIGNAL[:, 1].tolist()}]  # fmt: skip
    return json.dumps({"sample_rate_hz": RATE, "channels": channels}).encode()


def test_arrays_of_simulations_and_matlab(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    arrays = {"t": np.arange(400) / RATE, "sensor_a": SIGNAL[:, 0], "sensor_b": SIGNAL[:, 1], "f": np.arange(5.0)}
    write_arrays(path, arrays, units={"t": "s", "sensor_a": "m/s2", "sensor_b": "m/s2"}, attributes={"step_s": 1.0})
    for data, name in ((path.read_bytes(), "s.h5"), (npz(), "s.npz"), (mat73(tmp_path / "s.mat"), "s.mat"),
                       (as_json(), "s.json")):  # fmt: skip
        found = read_measurement(data, name=name)
        assert held(found) and found.channel_names == ("a", "b"), name
    found = read_measurement(mat5(), name="s.mat")
    assert found.channels[1].unit == "g" and np.allclose(found.signal, 9.80665 * SIGNAL)


@pytest.mark.parametrize("binary", [False, True])
def test_universal_files(tmp_path: Path, binary: bool) -> None:
    assert held(read_measurement(uff(tmp_path / "s.uff", binary), name="s.uff"), exact=1e-5)
    uneven = uff(tmp_path / "u.uff", binary, abscissa_spacing=0)
    assert held(read_measurement(uneven, name="u.uff"), exact=1e-5)


@pytest.mark.parametrize("binary", [False, True])
def test_a_universal_file_cut_between_two_records(tmp_path: Path, binary: bool) -> None:
    def without_last(data: bytes) -> bytes:
        """The same, cut exactly behind the end of the last record but one."""
        start = data.rindex(b"    -1", 0, data.rindex(b"    58"))
        assert data[:start].rstrip().endswith(b"-1")
        return data[:start]

    silent = uff(tmp_path / "s.uff", binary)
    found = read_measurement(without_last(silent), name="s.uff")
    assert found.channel_names == ("a",)
    assert "universal file, 1 records 58" in found.import_report
    assert any("does not say how many records there should be" in line for line in found.import_report)
    assert "records by name: a, b" in read_measurement(silent, name="s.uff").import_report
    counted = uff(tmp_path / "c.uff", binary, id3="channel 1 of 2")
    assert read_measurement(counted, name="c.uff").channel_names == ("a", "b")
    (warning,) = read_measurement(without_last(counted), name="c.uff").warnings
    assert warning.startswith("the records say that they are 2, 1 are there: ")
    assert not read_measurement(counted, name="c.uff").warnings
    numbered = uff(tmp_path / "n.uff", binary).replace(b"\n    1         0", b"\n    1         1", 1)
    whole = numbered.replace(b"\n    1         0", b"\n    1         2", 1)
    assert not read_measurement(whole, name="n.uff").warnings
    gap = numbered.replace(b"\n    1         0", b"\n    1         4", 1)
    (warning,) = read_measurement(gap, name="n.uff").warnings
    assert warning == "2 records, but by their function numbers 2, 3 of 4 are not in the file"


def test_a_universal_file_cut_where_a_record_begins(tmp_path: Path) -> None:
    data = uff(tmp_path / "s.uff", False)
    start = data.rindex(b"    -1", 0, data.rindex(b"    58"))
    assert "is truncated" in refusal(data[: start + 5], "s.uff")


def test_floating_wav_has_units_of_its_own_and_pcm_has_a_full_scale() -> None:
    found = read_measurement(wav("DOUBLE", 1.0), name="s.wav", units={"ch1": "m/s2", "ch2": "m/s2"})
    assert held(found)
    assert "column 'full_scale': holds fractions of a full scale" in refusal(wav("PCM_16"), "s.wav")
    for profile in (ImportProfile(full_scale="8 m/s2"), ImportProfile(full_scale_m_s2=(8.0, 8.0))):
        assert held(read_measurement(wav("PCM_24"), name="s.wav", profile=profile), exact=2e-6)
    assert "3 values for 2 channels" in refusal(
        wav("PCM_16"), "s.wav", profile=ImportProfile(full_scale_m_s2=(1.0, 2.0, 3.0))
    )
    both = ImportProfile(full_scale="8 m/s2", full_scale_m_s2=8.0)
    assert "'full_scale': '8 m/s2': is given beside full_scale_m_s2" in refusal(wav("PCM_16"), "s.wav", profile=both)
    assert "'full_scale': '5': must be a number and a unit" in refusal(
        wav("PCM_16"), "s.wav", profile=ImportProfile(full_scale="5")
    )


def test_a_wav_that_reached_full_scale_is_said_to_be_clipped() -> None:
    found = read_measurement(wav("PCM_16", scale=1.0), name="s.wav", profile=ImportProfile(full_scale="1 g"))
    assert any("channel 'ch1' is clipped" in line and "at full scale" in line for line in found.warnings)


# --- damage -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", IN_OTHER_CLOTHES)
@pytest.mark.parametrize("share", [0.1, 0.45, 0.98])
def test_a_truncated_file_is_named_so(name: str, share: float) -> None:
    data = content(name)
    assert "truncated" in refusal(data[: int(share * len(data))], name, profile=ImportProfile())


def test_other_truncated_files_are_refused(tmp_path: Path) -> None:
    for data, name in ((npz(), "s.npz"), (mat73(tmp_path / "s.mat"), "s.mat"), (as_json(), "s.json"),
                       (uff(tmp_path / "s.uff", True), "s.uff"), (mat5(), "s.mat")):  # fmt: skip
        for share in (0.3, 0.7, 0.95):
            refusal(data[: int(share * len(data))], name)


def test_files_that_unpack_to_more_than_is_read(tmp_path: Path) -> None:
    zeros = mat5(z=np.zeros((400, 2000)))
    assert len(zeros) < 50_000
    assert "holds more than 1 MB" in refusal(zeros, "s.mat", limits=Limits(decoded_bytes=1_000_000))
    packed = npz(z=np.zeros(1_000_000))
    assert "holds more than 1 MB" in refusal(packed, "s.npz", limits=Limits(decoded_bytes=1_000_000))
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file.create_dataset("y", (10**9,), "f8", chunks=(10_000,))
    data = (tmp_path / "s.h5").read_bytes()
    assert len(data) < 10_000 and "more than 400 MB" in refusal(data, "s.h5")


def test_samples_that_are_declared_but_not_there(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file.create_dataset("y", (4000,), "f8", chunks=(1000,))[:1000] = SIGNAL.reshape(-1)[0]
        file["fs"] = RATE
    assert "declares 4000 numbers, but not all of them" in refusal((tmp_path / "s.h5").read_bytes(), "s.h5")


@pytest.mark.parametrize("member", ["name", "unit"])
@pytest.mark.parametrize("character", ["\0", "\ud800", "\x1b"])
def test_names_that_are_no_text_are_refused(member: str, character: str) -> None:
    held = json.loads(as_json())
    held["channels"][0][member] = f"m{character}"
    rule = "channel 1: its name or unit holds a character that is no text"
    assert rule in refusal(json.dumps(held).encode(), "s.json")


def test_links_to_other_files_are_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["y"] = SIGNAL
    with h5py.File(tmp_path / "s.h5", "w") as file:
        file["y"] = h5py.ExternalLink(str(secret), "y")
        file["fs"] = RATE
    assert "holds no array that could be a recording" in refusal((tmp_path / "s.h5").read_bytes(), "s.h5")


def test_pickles_are_not_opened() -> None:
    file = io.BytesIO()
    np.savez(file, y=np.array([{}], dtype=object))
    assert "NPZ" in refusal(file.getvalue(), "s.npz")


@pytest.mark.parametrize(("local", "central", "value"), [(6, 8, 1), (8, 10, 99)])
def test_npz_files_that_are_encrypted_or_packed_in_another_way_are_refused(
    local: int, central: int, value: int
) -> None:
    """The flag of encryption, or a method of compression that nobody has, in the headers of every member."""
    packed = bytearray(npz())
    for signature, offset in ((b"PK\x03\x04", local), (b"PK\x01\x02", central)):
        place = packed.find(signature)
        while place >= 0:
            packed[place + offset : place + offset + 2] = value.to_bytes(2, "little")
            place = packed.find(signature, place + 4)
    assert "is a damaged or foreign NPZ file" in refusal(bytes(packed), "s.npz")


@pytest.mark.parametrize(
    ("limits", "rule"),
    [
        # Ended by its processor time, or, where others have the processors, by ten times that of the clock.
        (Limits(reader_seconds=0.01), r"UFF file: takes longer than 0\.0?1 s to be read"),
        (Limits(reader_memory=1_000_000), "needs more than 1 MB to be read"),
    ],
)
def test_a_reader_that_takes_too_much_is_ended_and_the_next_file_is_read(limits: Limits, rule: str) -> None:
    cell.CELL.close()  # a process that has read larger files holds memory that it got for these
    assert re.search(rule, refusal(content("slider-crank-03.uff"), "s.uff", limits=limits))
    assert held(read_measurement(npz(), name="s.npz"))


def test_a_process_that_does_nothing_at_all_is_killed_at_its_cap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell, "_GRACE", 0.1)
    assert held(read_measurement(npz(), name="s.npz"))
    assert cell.CELL._process is not None
    stuck = cell.CELL._process
    os.kill(stuck.pid, signal.SIGSTOP)
    assert "NPZ file: its reader ended early" in refusal(npz(), "s.npz", limits=Limits(reader_seconds=0.1))
    assert stuck.wait(300) == -signal.SIGKILL
    assert held(read_measurement(npz(), name="s.npz"))


def test_content_goes_before_the_ending_and_contradictions_are_refused() -> None:
    assert held(read_measurement(npz(), name="recording"))
    assert "s.csv: ends in .csv, but is a NPZ file" in refusal(npz(), "s.csv")
    assert "s.wav: ends in .wav, but is a NPZ file" in refusal(npz(), "s.wav")
    assert "s.tdms: is not a TDMS file" in refusal(b"abc" * 400, "s.tdms")
    assert "is empty" in refusal(b"\n", "s.csv")


def test_nothing_is_guessed(tmp_path: Path) -> None:
    refusals: list[tuple[Callable[[], bytes], str, str]] = [
        (lambda: mat5(q=np.zeros((300, 2))), "s.mat", "arrays of different length"),
        (lambda: mat5(dt=1.0), "s.mat", "but fs states 2000 Hz"),
        (
            lambda: uff(tmp_path / "a.uff", False, ordinate_axis_units_lab="mm/s"),
            "s.uff",
            "the record says it is accel",
        ),
        (lambda: uff(tmp_path / "b.uff", False, ordinate_axis_units_lab="NONE"), "s.uff", "has no unit"),
        (lambda: as_json().replace(b"2000.0", b"-1"), "s.json", "'sample_rate_hz': -1: must be"),
        (lambda: as_json().replace(b'"values": [', b'"values": [true, ', 1), "s.json", "value 1 is not a number"),
        (lambda: wav("PCM_16")[:20] + struct.pack("<H", 2) + wav("PCM_16")[22:], "s.wav", "WAV"),
    ]
    for make, name, rule in refusals:
        assert rule in refusal(make(), name, profile=ImportProfile())
