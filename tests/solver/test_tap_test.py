"""Frequency responses from universal files: of another writer, and by hand from the layout of data sets 58 and 58b."""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff
from frame_responses import LINES, accelerances, harmonics, transform_of

from jointplay.solver.cases.case import Settings
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import Machine, load_machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

MACHINE = shipped_machine("slider-crank")
#: The first two carry the sensors; the bed is hit at one of them, and at its feet.
NODES = {"1": [0.2, -0.1], "2": [-0.2, 0.1], "31": [-0.25, -0.1], "40": [0.25, -0.1]}
BLOWS = ((31, 1), (31, -2), (40, 2), (2, 1))
KINDS = {8: ("m", 2), 11: ("m/s", 1), 12: ("m/s^2", 0)}

Records = list[dict[str, Any]]


@lru_cache
def own_answers(frequency: tuple[float, ...]) -> Any:
    return accelerances(MACHINE, frequency)


def records(frequency: Any = LINES, kind: int = 12, **more: Any) -> Records:
    """One a blow and sensor, its direction in the sign: every force is a row of fx, fy and moment."""
    answers = own_answers(tuple(frequency)) / (2j * np.pi * frequency[:, None, None]) ** KINDS[kind][1]
    found = []
    for index, (node, way) in enumerate(((1, 1), (1, 2), (2, -1), (2, 2))):
        for other, back in BLOWS:
            x, y = NODES[str(other)]
            blow = {1: (1.0, 0.0, -y), 2: (0.0, 1.0, x)}[abs(back)]
            found.append({
                "type": 58, "func_type": 4, "rsp_node": node, "rsp_dir": way, "ref_node": other, "ref_dir": back,
                "data": np.sign(way * back) * answers[:, index] @ np.array(blow), "x": frequency, "id1": "bed",
                "abscissa_spacing": 1, "abscissa_inc": frequency[1] - frequency[0], "abscissa_spec_data_type": 18,
                "ordinate_spec_data_type": kind, "orddenom_spec_data_type": 13, "z_axis_spec_data_type": 0,
                "ordinate_axis_units_lab": KINDS[kind][0], "orddenom_axis_units_lab": "N", **more,
            })  # fmt: skip
    return found


def write(path: Path, found: Records) -> Path:
    opened = pyuff.UFF(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # the library leaves a file open when it writes
        for each in found:
            opened.write_sets(dict(each), "add", force_double="ord_data_type" not in each)
    return path


def by_hand(path: Path, found: Records, numbers: Callable[[Any, Any], bytes], form: int, head: str = "    58") -> Path:
    """As the layout has them; `numbers` of frequencies and values, `form` is the ordinate's data type."""
    text = b""
    for each in found:
        payload = numbers(each["x"], each["data"])
        lines = ["    -1", head.format(len(payload)), "bed", "NONE", "25-Nov-26 10:00:00", "NONE", "NONE"]
        lines += [
            f"{4:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{each['rsp_node']:10d}{each['rsp_dir']:4d}"
            f" {'NONE':10s}{each['ref_node']:10d}{each['ref_dir']:4d}",
            f"{form:10d}{len(each['x']):10d}{0:10d}{0:13.5e}{0:13.5e}{0:13.5e}",
        ]
        for kind, unit in ((18, "Hz"), (each["ordinate_spec_data_type"], "m/s^2"), (13, "N"), (0, "NONE")):
            lines.append(f"{kind:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {unit:20s}")
        text += "\n".join(lines).encode() + b"\n" + payload + b"    -1\n"
    path.write_bytes(text)
    return path


def as_single(x: Any, values: Any) -> bytes:
    """6E13.5, its last line filled up with zeros, as some write it."""
    rows = np.column_stack([x, values.real, values.imag]).ravel()
    rows = np.append(rows, np.zeros(-len(rows) % 6)).reshape(-1, 6)
    return "".join("".join(f"{number:13.5E}" for number in row) + "\n" for row in rows).encode()


def as_packed(form: str) -> Callable[[Any, Any], bytes]:
    def pack(x: Any, values: Any) -> bytes:
        return b"".join(struct.pack(form, f, v.real, v.imag) for f, v in zip(x, values, strict=True))

    return pack


def load(folder: Path, file: Path, **more: Any) -> Machine:
    tree = json.loads(MACHINE.canonical_json()) | {"response": {"file": file.name, "nodes": NODES, **more}}
    (folder / "machine.json").write_text(json.dumps(tree))
    return load_machine(folder / "machine.json")


def error_of(machine: Machine, lines: Any = LINES) -> float:
    """Largest difference from the closed form, in parts of the largest answer to that force."""
    assert machine.response is not None and machine.response.quantity == "accelerance"
    expected = own_answers(tuple(lines))
    found = machine.response.accelerances(tuple(sensor.name for sensor in MACHINE.sensors), np.asarray(lines))
    return float((np.abs(found - expected).max(axis=(0, 1)) / np.abs(expected).max(axis=(0, 1))).max())


UNEVEN = np.concatenate([np.arange(2.0, 100.0, 1.0), np.arange(100.0, 2001.0, 5.0)])


@pytest.mark.parametrize("kind", [8, 11, 12])
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
def test_files_of_another_writer(kind: int, binary: int, even: int, tmp_path: Path) -> None:
    """Double precision: 12 digits as text; measured 3e-11 of what the frame answers at most."""
    lines = LINES if even else UNEVEN
    found = load(tmp_path, write(tmp_path / "bed.uff", records(lines, kind, binary=binary, abscissa_spacing=even)))
    assert error_of(found, lines) < 1e-10
    assert parse_machine(found.canonical_json()).content_key == found.content_key


@pytest.mark.parametrize(
    ("numbers", "form", "head", "most"),
    [
        (as_single, 5, "    58", 2e-5),
        (as_packed("<fff"), 5, "    58b     1     2          11{:12d}     0     0           0           0", 2e-6),
        (as_packed(">fff"), 5, "    58b     2     2          11{:12d}     0     0           0           0", 2e-6),
        (as_packed("<fdd"), 6, "    58b     1     2          11{:12d}     0     0           0           0", 1e-10),
    ],
)
def test_single_precision(numbers: Any, form: int, head: str, most: float, tmp_path: Path) -> None:
    """Six digits as text, measured 8e-6; seven in binary; a single abscissa beside doubles, as the layout has it."""
    file = by_hand(tmp_path / "bed.unv", records(UNEVEN[:-1]), numbers, form, head)
    assert error_of(load(tmp_path, file), UNEVEN[:-1]) < most


def test_single_precision_of_another_writer(tmp_path: Path) -> None:
    assert error_of(load(tmp_path, write(tmp_path / "bed.uff", records(ord_data_type=5)))) < 2e-5


def test_spectra_are_those_of_the_supports(tmp_path: Path) -> None:
    """As of a response in the machine file; measured 4e-5 of the largest."""
    machine = load(tmp_path, write(tmp_path / "bed.uff", records(ord_data_type=5)))
    history = simulate(machine, {"B": 2e-4}, Settings(sample_rate=5000.0, duration=2.2))
    ours = harmonics(history.at_sensors(machine), history, 1.7)
    expected = harmonics(history.band_limited_acceleration @ transform_of(machine).T, history, 1.7)
    assert np.abs(ours - expected).max() < 1e-4 * np.abs(expected).max()


def test_units(tmp_path: Path) -> None:
    """Labels go before data set 164; a label may hold both; moments are forces times lengths."""
    none = {"ordinate_axis_units_lab": "NONE", "orddenom_axis_units_lab": "NONE"}
    si, mm = ({"type": 164, "units_code": 9, "length": size, "force": size, "temp": 1.0, "temp_offset": 273.15}
              for size in (1.0, 1000.0))  # fmt: skip
    for name, found in {
        "si": [si, *records(**none)],
        "mm over mN": [mm, *records(**none)],
        "labels": [mm, *records()],
        "both": [si, *records(ordinate_axis_units_lab="(m/s^2)/N", orddenom_axis_units_lab="NONE")],
        "by its unit alone": records(ordinate_axis_units_lab="m/s^2/N", orddenom_axis_units_lab="NONE",
                                     ordinate_spec_data_type=0, orddenom_spec_data_type=0),
        "g": [each | {"data": each["data"] / 9.80665, "ordinate_axis_units_lab": "g"} for each in records()],
        "kHz": [each | {"x": LINES / 1e3, "abscissa_inc": 2e-3, "abscissa_axis_units_lab": "kHz"}
                for each in records()],
    }.items():  # fmt: skip
        assert error_of(load(tmp_path, write(tmp_path / f"{name}.uff", found))) < 1e-10, name


def test_forces_at_the_centre_of_gravity_are_columns_themselves(tmp_path: Path) -> None:
    answers = own_answers(tuple(LINES))
    found = [each for each in records() if (each["ref_node"], each["ref_dir"]) != BLOWS[3]]
    for index, each in enumerate(found):
        sensor, force = divmod(index, 3)
        sign = np.sign(each["rsp_dir"])
        per = {"ref_node": 9, "ref_dir": (1, 2, 6)[force], "orddenom_axis_units_lab": ("N", "N", "N m")[force]}
        each |= per | {"data": sign * answers[:, sensor, force]}
    nodes = {"1": NODES["1"], "2": NODES["2"], "9": [0.0, 0.0]}
    assert error_of(load(tmp_path, write(tmp_path / "bed.uff", found), nodes=nodes)) < 1e-10


def test_an_oblique_sensor_is_what_its_node_answers_along_it(tmp_path: Path) -> None:
    tree = MACHINE.model_dump()
    tree["sensors"] = [{"name": "s", "at": [0.2, -0.1], "direction": [3.0, 4.0]}]
    write(tmp_path / "bed.uff", records())
    found = parse_machine(tree | {"response": {"file": "bed.uff", "nodes": NODES}}, folder=tmp_path)
    assert found.response is not None
    both = own_answers(tuple(LINES))
    expected = 0.6 * both[:, 0] + 0.8 * both[:, 1]
    answered = found.response.accelerances(("s",), LINES)[:, 0]
    assert np.abs(answered - expected).max() < 1e-10 * np.abs(expected).max()


def test_what_is_not_between_listed_nodes_in_the_plane_is_left_out(tmp_path: Path) -> None:
    """A coherence, what is answered across the plane, a node that nobody speaks of."""
    ours = records()
    other = [ours[0] | {"func_type": 6, "data": np.ones(len(LINES))}, ours[0] | {"rsp_dir": 3},
             ours[0] | {"ref_dir": 4}, ours[0] | {"rsp_node": 77}]  # fmt: skip
    assert error_of(load(tmp_path, write(tmp_path / "bed.uff", other + ours))) < 1e-10


def changed(**more: Any) -> Records:
    """The third record is another."""
    found = records()
    found[2] |= more
    return found


@pytest.mark.parametrize(
    ("found", "more", "message"),
    [
        (records(), {"nodes": {}}, "response.nodes: a universal file needs where its nodes are in the drawing"),
        (records(), {"nodes": {**NODES, "a": [0, 0]}}, "response.nodes.a: must be the number of a node"),
        (records(), {"nodes": {**NODES, "1": [0.2]}}, "response.nodes.1: [0.2]: must be a list of 2 numbers"),
        (records(), {"nodes": {**NODES, "7": [0.2, 0]}}, "response.nodes.7: bed.uff has no frequency response of it"),
        (records(), {"nodes": {**NODES, "1": [0.2, 0.1]}}, "bed.uff: response.nodes needs one at [0.2, -0.1]: there"),
        (records(), {"nodes": {k: NODES[k] for k in ("1", "2", "40")}}, "40 Y, 2 X: blows that s1-x answers to must"),
        (records(func_type=3), {}, "bed.uff: holds no data set 58 of function type 4 between nodes that are listed"),
        (changed(data=np.ones(len(LINES))), {}, "line 1030: data set 58: a frequency response must be of complex"),
        (changed(data=np.ones(999) * 1j, x=LINES[:-1]), {}, "line 1030: data set 58: must be at the frequencies of th"),
        (changed(ref_node=31, ref_dir=1), {}, "line 1030: data set 58: 1 X to 31 X is there twice"),
        (changed(ordinate_axis_units_lab="mm/s"), {}, "line 1030: mm/s: data set 58: ordinate must be a displacement"),
        (changed(ordinate_axis_units_lab="NONE"), {}, "line 1030: 12: data set 58: ordinate must be a displacement"),
        (changed(ordinate_spec_data_type=2), {}, "line 1030: m/s^2: data set 58: ordinate"),
        (changed(orddenom_spec_data_type=12), {}, "line 1030: N: data set 58: denominator must be an excitation force"),
        (changed(orddenom_axis_units_lab="NONE"), {}, "line 1030: 13: data set 58: denominator must be an excitation"),
        (changed(abscissa_spec_data_type=17), {}, "line 1030: 17: data set 58: abscissa must be a frequency"),
        (changed(abscissa_axis_units_lab="s"), {}, "line 1030: s: data set 58: abscissa must be a frequency"),
        ([{"type": 164, "units_code": 9, "length": 0.0, "force": 1.0, "temp": 1.0, "temp_offset": 0.0}, *records()], {},
         "line 2: data set 164 must have factors of length and force"),
    ],
)  # fmt: skip
def test_files_that_are_refused(found: Records, more: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(MachineError) as caught:
        load(tmp_path, write(tmp_path / "bed.uff", found), **more)
    told = str(caught.value)
    assert message in told and "\n" not in told and told.startswith(str(tmp_path / "machine.json"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-1000], "which begins here, has no end"),
        (lambda data: data.replace(b" 6      1000", b" 6      1001", 1), "declares 1001 samples, 1000 are"),
        (lambda data: data.replace(b" 6      1000", b" 7      1000", 1), "line 9: 7: ordinate data type must"),
        (lambda data: data.replace(b" 6      1000", b" 6     -1000", 1), "line 9: -1000: must be a number of samples"),
        (lambda data: data.replace(b"\n    58", b"\n    58b 1 2 11 " + b"9" * 5000, 1), "a binary record without its"),
        (lambda data: data.replace(b"\n    58", b"\n    58b 1 2 \xb2 1", 1), "a binary record without its size"),
        (lambda data: data.replace(b"\n    4  ", b"\n    4.5", 1), "line 8"),
        (lambda data: data.replace(b"e-", b"x-", 1), "line 2: data set 58 must hold numbers with blanks between them"),
        (lambda data: b"\n".join(data.split(b"\n")[:9]) + b"\n    -1\n", "line 2: is truncated: a data set 58 has 11"),
        (lambda data: b"frequency [Hz]\n", "response.nodes: is for universal files, and bed.uff is none"),
        (lambda data: data.replace(b"    -1\n    58", b"    -1\n    57"), "holds no data set 58 of function type 4"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused(change: Any, message: str, tmp_path: Path) -> None:
    file = write(tmp_path / "bed.uff", records())
    file.write_bytes(change(file.read_bytes()))
    with pytest.raises(MachineError) as caught:
        load(tmp_path, file)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "nodes", [{"1": [0.0, 0.0], "01": [1.0, 0.0]}, {"9" * 5000: [0.0, 0.0]}, {"\u00b2": [0.0, 0.0]}]
)
def test_nodes_that_are_no_numbers_or_there_twice_are_refused(nodes: Any, tmp_path: Path) -> None:
    file = write(tmp_path / "bed.uff", records())
    with pytest.raises(MachineError, match=r"response\.nodes\.[0-9\u00b2]+: (is there twice|must be the number)"):
        load(tmp_path, file, nodes=nodes)


def test_other_numbers_than_ieee_are_refused(tmp_path: Path) -> None:
    head = "    58b     1     3          11{:12d}     0     0           0           0"
    file = by_hand(tmp_path / "bed.uff", records(), as_packed("<fff"), 5, head)
    with pytest.raises(MachineError, match=r"line 2: 1 3: must be of byte ordering 1 or 2 and floating point format 2"):
        load(tmp_path, file)
