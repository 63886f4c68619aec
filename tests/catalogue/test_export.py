"""A catalogue as one file: what other programs read is what the shards hold."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from building import quick_build
from fake_simulator import PLAN

from jointplay.catalogue.errors import CatalogueFileError, EntryNotFoundError
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.cross_power import pack
from jointplay.catalogue.storage.export import export
from jointplay.catalogue.storage.hdf5 import read_arrays
from jointplay.catalogue.storage.store import Catalogue


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    path = tmp_path_factory.mktemp("catalogue")
    quick_build(path, parse_plan({**PLAN.content, "hypotheses": ["healthy", "singles", "pairs"]}), chunk_size=5)
    return Catalogue.open(path)


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    if path.suffix == ".npz":
        arrays = dict(np.load(path, allow_pickle=False))
        return arrays, json.loads(str(arrays["attributes"]))
    return read_arrays(path)


@pytest.mark.parametrize("ending", [".npz", ".h5", ".HDF5"])
def test_everything_is_in_the_file(catalogue: Catalogue, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"all{ending}"
    total = len(catalogue.entries) + len(catalogue.failed)
    assert export(catalogue, path) == total
    arrays, attributes = read(path)
    assert (attributes["catalogue"], attributes["machine"]) == (catalogue.id, catalogue.manifest.machine_content)
    assert arrays["power"].shape == (total, catalogue.scheme.count, 9)
    keys = [str(key) for key in arrays["key"]]
    assert sorted(keys) == sorted([*catalogue.entries.key, *catalogue.failed.key])
    for key in (str(catalogue.entries.key[0]), str(catalogue.entries.key[40])):
        row, entry = keys.index(key), catalogue.entry(key)
        assert entry.power is not None
        assert np.array_equal(arrays["power"][row], pack(entry.power))
        assert np.array_equal(arrays["spread_db"][row], entry.spread_db)
        assert (str(arrays["hypothesis"][row]), arrays["draw"][row]) == (entry.hypothesis, entry.draw)
        found = dict(zip(map(str, arrays["joints"]), arrays["clearance"][row], strict=True))
        assert {joint: value for joint, value in found.items() if value} == entry.clearances
        names = map(str, arrays["parameter_names"])
        numbers = dict(zip(names, arrays["parameters"][row], strict=True))
        assert {name: numbers[name] for name in entry.parameters} == entry.parameters  # others: as in the machine file
    row = keys.index(str(catalogue.failed.key[0]))
    assert (str(arrays["status"][row]), str(arrays["message"][row])) == ("diverged", "left the range at t = 0.1 s")
    assert np.isnan(arrays["power"][row]).all() and np.isnan(arrays["spread_db"][row]).all()
    assert np.array_equal(arrays["band_edges"], catalogue.scheme.edges)
    labels = list(dict.fromkeys(map(str, arrays["hypothesis"])))
    assert labels == list(catalogue.hypotheses)  # each in one block
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


def test_units_stand_beside_the_numbers(catalogue: Catalogue, tmp_path: Path) -> None:
    export(catalogue, tmp_path / "x.h5", ["A"])
    with h5py.File(tmp_path / "x.h5") as file:
        assert (file["clearance"].attrs["unit"], file["drive_speed"].attrs["unit"]) == ("m", "rad/s")
        assert set(file["hypothesis"].asstr()[()]) == {"A"}


def test_table_of_levels(catalogue: Catalogue, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    assert export(catalogue, path, ["healthy", "B"]) > 10
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["hypothesis"] for row in rows} == {"healthy", "B"}
    good = next(row for row in rows if row["hypothesis"] == "B" and row["status"] == "ok")
    entry = catalogue.entry(good["key"])
    assert float(good["clearance B [m]"]) == pytest.approx(entry.clearances["B"], rel=1e-8)  # nine digits
    assert entry.power is not None
    level = 10 * np.log10(entry.power[1, 2, 2].real)
    assert float(good["theta order 1.5 to 2.5 [dB]"]) == pytest.approx(level, abs=1e-3)
    assert export(catalogue, path) > len(rows)  # one case in eight fails, of these perhaps none
    with open(path, encoding="utf-8", newline="") as file:
        failed = next(row for row in csv.DictReader(file) if row["status"] != "ok")
    assert failed["x order 0.5 to 1.5 [dB]"] == ""


def test_refusals_leave_nothing(catalogue: Catalogue, tmp_path: Path) -> None:
    with pytest.raises(EntryNotFoundError):
        export(catalogue, tmp_path / "x.h5", ["Z"])
    for name in ("x.h5", "x.npz", "x.csv"):
        with pytest.raises(CatalogueFileError, match="cannot be written"):
            export(catalogue, tmp_path / "none" / name)
    victim = sorted((catalogue.path / "shards").iterdir())[1]
    content = victim.read_bytes()
    victim.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    try:
        for name in ("x.h5", "x.npz"):
            with pytest.raises(CatalogueFileError, match="does not match its checksum"):
                export(catalogue, tmp_path / name)
    finally:
        victim.write_bytes(content)
    assert list(tmp_path.iterdir()) == []
