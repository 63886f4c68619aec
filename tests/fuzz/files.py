"""Small whole recordings of every kind that is read, and ways to damage them."""

from __future__ import annotations

import gzip
import io
import json
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import h5py
import nptdms
import numpy as np
import pyuff
import scipy.io
import soundfile

RATE = 2000.0
SIGNAL = np.random.default_rng(1).normal(size=(300, 2)).round(3)

Mutation = Callable[[np.random.Generator, bytes], bytes]


def whole_files() -> dict[str, bytes]:
    """Return name to content."""
    rows = "\n".join(f"{n / RATE:.4f},{a},{b}" for n, (a, b) in enumerate(SIGNAL))
    csv = f"time [s],a [g],b [g]\n{rows}\n".encode()
    channels = [{"name": name, "unit": "g", "values": SIGNAL[:, i].tolist()} for i, name in enumerate("ab")]
    files = {
        "r.csv": csv,
        "r.csv.gz": gzip.compress(csv),
        "r.json": json.dumps({"sample_rate_hz": RATE, "channels": channels}).encode(),
    }
    for coding in ("PCM_16", "FLOAT"):
        file = io.BytesIO()
        soundfile.write(file, SIGNAL / 8.0, int(RATE), format="WAV", subtype=coding)
        files[f"{coding}.wav"] = file.getvalue()
    for name, packed in (("v5.mat", True), ("plain.mat", False)):
        file = io.BytesIO()
        scipy.io.savemat(file, {"y": SIGNAL, "fs": RATE, "unit": "g"}, do_compression=packed)
        files[name] = file.getvalue()
    file = io.BytesIO()
    np.savez_compressed(file, y=SIGNAL, fs=RATE, unit=np.array("g"))
    files["r.npz"] = file.getvalue()
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        properties = {"wf_increment": 1.0 / RATE, "unit_string": "g"}
        writer.write_segment([nptdms.ChannelObject("g", name, SIGNAL[:, i], properties) for i, name in enumerate("ab")])
    files["r.tdms"] = file.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        with h5py.File(f"{folder}/r.h5", "w") as held:
            held.create_dataset("y", data=SIGNAL, chunks=(100, 2), compression="gzip").attrs["unit"] = "g,g"
            held["fs"] = RATE
        files["r.h5"] = Path(f"{folder}/r.h5").read_bytes()
        for binary in (0, 1):
            path = Path(f"{folder}/{binary}.uff")
            for name, signal in zip("ab", SIGNAL.T, strict=True):
                record = {
                    "type": 58,
                    "binary": binary,
                    "func_type": 1,
                    "id1": name,
                    "rsp_node": 1,
                    "rsp_dir": 1,
                    "ref_node": 1,
                    "ref_dir": 1,
                    "data": signal,
                    "x": np.arange(len(signal)) / RATE,
                    "abscissa_inc": 1.0 / RATE,
                    "abscissa_spacing": 1,
                    "abscissa_spec_data_type": 17,
                    "ordinate_spec_data_type": 12,
                    "ordinate_axis_units_lab": "g",
                    "orddenom_spec_data_type": 0,
                    "z_axis_spec_data_type": 0,
                }
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", ResourceWarning)  # the library leaves a file open when it writes
                    pyuff.UFF(str(path)).write_sets(record, "add")
            files[f"{binary}.uff"] = path.read_bytes()
    return files


def flipped(random: np.random.Generator, data: bytes) -> bytes:
    """Some bytes are others; half of the time all of them in the first 600, where the heads are."""
    changed = bytearray(data)
    reach = min(len(data), 600) if random.random() < 0.5 else len(data)
    for place in random.integers(0, reach, random.integers(1, 12)):
        changed[place] = random.integers(0, 256)
    return bytes(changed)


def cut(random: np.random.Generator, data: bytes) -> bytes:
    """The end is missing."""
    return data[: random.integers(0, len(data))]


def hollow(random: np.random.Generator, data: bytes) -> bytes:
    """A piece in the middle is missing."""
    first, last = sorted(random.integers(0, len(data), 2))
    return data[:first] + data[last:]


def repeated(random: np.random.Generator, data: bytes) -> bytes:
    """A piece stands there twice."""
    first, last = sorted(random.integers(0, len(data), 2))
    return data[:last] + data[first:]


def huge(random: np.random.Generator, data: bytes) -> bytes:
    """A word in the head says billions, or less than nothing, or nothing."""
    place = 4 * int(random.integers(0, max(1, min(len(data), 2400) // 4)))
    words = (b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\0\x40", b"99999999")
    word = words[random.integers(0, len(words))]
    return data[:place] + word + data[place + len(word) :]


def noise(random: np.random.Generator, data: bytes) -> bytes:
    """The head is right, and nothing else."""
    head = int(random.integers(0, min(len(data), 700)))
    return data[:head] + random.bytes(int(random.integers(0, 3000)))


MUTATIONS: tuple[Mutation, ...] = (flipped, cut, hollow, repeated, huge, noise)
