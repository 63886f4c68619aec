"""What a catalogue gives back, and that its files are what they are said to be."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from fake_simulator import MACHINE, PLAN, compute, diverges
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jointplay.catalogue.building.build import build
from jointplay.catalogue.errors import CatalogueFileError, EntryNotFoundError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.plans.variants import Variant
from jointplay.catalogue.storage import hdf5
from jointplay.catalogue.storage.cross_power import pack, unpack
from jointplay.catalogue.storage.directory import publish, sha256_of
from jointplay.catalogue.storage.shard import CaseOutcome, Shard
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import parse_machine

ALL = parse_plan(
    {
        **PLAN.content,
        "hypotheses": ["healthy", "singles", "pairs", "triples"],
        "draws": {**PLAN.content["draws"], "pair": 8, "larger": 3},
    }
)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalogue")
    build(MACHINE, ALL, path, workers=0, compute=compute, chunk_size=5)
    return path


@pytest.fixture(scope="module")
def catalogue(directory: Path) -> Catalogue:
    return Catalogue.open(directory)


def test_says_what_it_is_of(catalogue: Catalogue, directory: Path) -> None:
    assert catalogue.machine.content_key == MACHINE.content_key
    assert catalogue.plan == ALL.resolve(MACHINE)
    assert catalogue.recipe == ALL.recipe(MACHINE)
    assert catalogue.scheme == catalogue.recipe.scheme
    assert catalogue.path == directory
    assert catalogue.hypotheses == ("healthy", "A", "B", "O", "A+B", "A+O", "B+O", "A+B+O")
    assert set(catalogue.manifest.versions) >= {"python", "numpy", "scipy", "casadi", "numba"}


def test_entries_are_those_of_the_plan_in_a_stated_order(catalogue: Catalogue) -> None:
    table = catalogue.entries
    wanted = {entry.key: entry for entry in entries_of(ALL, MACHINE)}
    filed = {path: MachineNumbers(MACHINE).nominal(path) for path in table.parameters}
    assert set(table.key) == {key for key in wanted if not diverges(key)}
    for row, key in enumerate(table.key.tolist()):
        entry = wanted[key]
        assert table.hypothesis[row] == entry.hypothesis.label
        assert table.joints_of(row) == entry.joints
        assert table.worn_of(row) == entry.worn
        assert (table.stratum[row], table.law[row]) == ("trusted", "own")
        assert tuple(table.clearance[row][table.clearance[row] > 0]) == entry.clearances
        numbers = {path: column[row] for path, column in table.parameters.items()}
        assert numbers == {**filed, **entry.parameters}
        assert table.draw[row] == entry.draw
    labels = list(dict.fromkeys(table.hypothesis.tolist()))
    assert tuple(labels) == catalogue.hypotheses  # each in one block
    assert table.hypotheses[:3] == (Hypothesis.of(()), Hypothesis.of("A"), Hypothesis.of("B"))
    assert table.hypotheses[-1].joints == ("A", "B", "O")
    singles = table.rows(table.hypothesis == "A")
    assert (np.diff(singles.draw) >= 0).all()  # the first draws stand together


def test_failed_cases_have_rows_but_no_spectra(catalogue: Catalogue) -> None:
    assert len(catalogue.failed) > 0
    assert set(catalogue.failed.status) == {"diverged"}
    assert set(catalogue.failed.message) == {"left the range at t = 0.1 s"}
    assert len(catalogue.entries) == len(catalogue.power()) == len(catalogue.spread_db())
    entry = catalogue.entry(str(catalogue.failed.key[0]))
    assert (entry.status, entry.power, entry.spread_db) == ("diverged", None, None)
    assert set(catalogue.entries.status) == {"ok"}


def test_spectra_are_those_that_were_computed(catalogue: Catalogue) -> None:
    power, spread = catalogue.power(), catalogue.spread_db()
    bands = catalogue.scheme.count
    assert power.dtype == np.complex64
    assert power.shape == (len(catalogue.entries), bands, 3, 3)
    assert spread.shape == (len(catalogue.entries), bands, 3)
    assert np.array_equal(power, power.conj().swapaxes(2, 3))
    assert catalogue.power() is power
    assert not power.flags.writeable
    key = str(catalogue.entries.key[10])
    random = np.random.default_rng(int(key[:8], 16))
    root = random.normal(size=(bands, 3, 3)) + 1j * random.normal(size=(bands, 3, 3))
    assert np.allclose(power[10], root @ root.conj().swapaxes(1, 2), rtol=1e-5, atol=1e-6)
    assert np.array_equal(spread[10], random.random((bands, 3)).astype(np.float32))


def test_one_entry(catalogue: Catalogue) -> None:
    row = int(np.flatnonzero(catalogue.entries.hypothesis == "A+O")[0])
    key = str(catalogue.entries.key[row])
    entry = catalogue.entry(key[:10])
    assert entry.key == key
    assert set(entry.clearances) == {"A", "B", "O"}
    assert entry.worn == ("A", "O")
    assert entry.parameters["drive.speed"] == catalogue.entries.parameters["drive.speed"][row]
    assert entry.power is not None
    assert np.array_equal(entry.power, catalogue.power()[row])
    assert (entry.segments, entry.transient, entry.drive_speed) == (4, 0.25, 60.0)


def test_cases_that_lie_in_shards_by_turns_read_each_of_them_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    two_laws = parse_plan({**PLAN.content, "laws": {"own": 1, "hertz": 1}})
    build(MACHINE, two_laws, tmp_path, workers=0, compute=compute)
    catalogue, read = Catalogue.open(tmp_path), []
    rows = catalogue.matrix.rows("A")
    shards = catalogue.matrix.places(rows)[:, 0]
    assert np.count_nonzero(np.diff(shards)) > len(set(shards.tolist()))
    whole = Catalogue._read

    def noted(self: Catalogue, name: str) -> Shard:
        read.append(name)
        return whole(self, name)

    monkeypatch.setattr(Catalogue, "_read", noted)
    keys = [entry.key for entry, _ in catalogue.cases(rows)]
    assert keys == catalogue.matrix.table(rows).key.tolist()
    assert len(read) == len(set(read)) == len(set(shards.tolist()))


@pytest.mark.parametrize("key", ["", "0" * 64, "zzzzzzzz", "a"])
def test_unknown_keys_are_refused(catalogue: Catalogue, key: str) -> None:
    with pytest.raises(EntryNotFoundError, match="no such entry in the catalogue"):
        catalogue.entry(key)


def test_id_follows_from_the_content(directory: Path, tmp_path: Path) -> None:
    first = Catalogue.open(directory).id
    assert first == Catalogue.open(directory).id
    build(MACHINE, PLAN, tmp_path, workers=0, compute=compute)
    before = Catalogue.open(tmp_path)
    build(MACHINE, ALL, tmp_path, workers=0, compute=compute)
    after = Catalogue.open(tmp_path)
    assert len({first, before.id, after.id}) == 3
    assert len(before.entries) < len(after.entries)  # what was opened stays what it was


def test_opens_without_index_and_where_nothing_can_be_written(directory: Path, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(directory, copy)
    (copy / "index.sqlite").unlink()
    for folder in (copy / "shards", copy):
        os.chmod(folder, 0o500)
    try:
        assert Catalogue.open(copy).id == Catalogue.open(directory).id
        assert len(Catalogue.open(copy).power()) == len(Catalogue.open(directory).power())
    finally:
        for folder in (copy, copy / "shards"):
            os.chmod(folder, 0o700)


def test_folders_that_are_no_catalogue_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(CatalogueFileError, match=r"is not a catalogue: it has no manifest\.json$"):
            Catalogue.open(path)


def test_damage_is_never_served(directory: Path, tmp_path: Path) -> None:
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(directory, copy)
    victim = sorted((copy / "shards").iterdir())[1]
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    with pytest.raises(CatalogueFileError, match=rf"{victim.name}: does not match its checksum"):
        Catalogue.open(copy).power()
    victim.unlink()
    opened = Catalogue(Catalogue.open(directory).layout, Catalogue.open(directory).manifest, ["f" * 64])
    with pytest.raises(CatalogueFileError, match="cannot be read"):
        opened.power()


def test_numbers_only_some_entries_vary_have_the_value_of_the_file(tmp_path: Path) -> None:
    plain = parse_plan({**PLAN.content, "uncertain": {}})
    faster = parse_plan({**plain.content, "speeds": [1.0, 1.5]})
    build(MACHINE, plain, tmp_path, workers=0, compute=compute)
    build(MACHINE, faster, tmp_path, workers=0, compute=compute)
    speeds = Catalogue.open(tmp_path).entries.parameters["drive.speed"] / MACHINE.drive.speed  # type: ignore[union-attr, operator]
    assert set(np.round(speeds, 12)) == {1.0, 1.5}


def test_loads_extend_a_catalogue_by_the_same_machines(tmp_path: Path) -> None:
    """A recording is compared with all entries at its speed, under whatever load; machines stay together."""
    plain = parse_plan({**PLAN.content, "uncertain": {}})
    loaded = parse_plan({**plain.content, "loads": [{"force": 0}, {"force": "-300 N"}]})
    build(MACHINE, plain, tmp_path, workers=0, compute=compute)
    before = Catalogue.open(tmp_path).matrix.rows("O")
    assert build(MACHINE, loaded, tmp_path, workers=0, compute=compute).present == len(entries_of(plain, MACHINE))
    matrix = Catalogue.open(tmp_path).matrix
    rows = matrix.rows("O", speed=MACHINE.drive.speed)  # type: ignore[union-attr, arg-type]
    table = matrix.table(rows)
    force = table.parameters["loads.0.force.0"]
    pressed = (force >= -360.0) & (force <= -240.0)
    assert np.sum(force == 0.0) == len(before)
    assert np.sum(pressed) == len(rows) - len(before) > 0
    # Some cases fail; draws that have both are one machine each.
    number = matrix.individuals(rows)
    assert set(number[pressed]) & set(number[~pressed])
    assert len({*zip(number.tolist(), table.draw.tolist(), strict=True)}) == len(set(number)) == len(set(table.draw))


# The files.


def some_shard() -> Shard:
    entries = [entry for entry in entries_of(PLAN, MACHINE) if entry.hypothesis.label == "A"]
    from jointplay.catalogue.building.chunk import Chunk
    from jointplay.catalogue.storage.manifest import Manifest

    manifest = Manifest.of(MACHINE, PLAN)
    outcomes = compute(Chunk(MACHINE.canonical_json(), manifest.recipe, tuple(entries)))
    return Shard.of(manifest.header(PLAN), entries, outcomes)


def test_shard_reads_back_and_says_all_about_itself() -> None:
    shard = some_shard()
    content = hdf5.encode_shard(shard)
    assert hdf5.encode_shard(shard) == content
    back = hdf5.decode_shard(content, Path("x.h5"))
    assert back.header == shard.header
    assert [back.entry(i) for i in range(back.count)] == [shard.entry(i) for i in range(shard.count)]
    assert [back.entry(i) for i in range(back.count)] == [
        e for e in entries_of(PLAN, MACHINE) if e.hypothesis.label == "A"
    ]
    for name in ("status", "message", "hypothesis", "stratum", "variant"):
        assert getattr(back, name) == getattr(shard, name)
    for name in ("power", "spread_db", "row", "segments", "drive_speed", "transient", "guard_db"):
        assert np.array_equal(getattr(back, name), getattr(shard, name), equal_nan=name == "guard_db")
    assert parse_machine(back.header.machine).content_key == MACHINE.content_key
    assert parse_plan(back.header.plan) == PLAN


def test_other_programs_find_units_and_meaning_in_a_shard(tmp_path: Path) -> None:
    (tmp_path / "x.h5").write_bytes(hdf5.encode_shard(some_shard()))
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["spectra/power"].attrs["columns"].tolist()[3:5] == ["re x y", "im x y"]
        assert "integrated over each band" in file["spectra/power"].attrs["quantity"]
        assert file["entries/clearance"].attrs["unit"] == "m"
        assert file["bands/edges"].attrs["unit"] == "orders"
        assert len(file["bands/edges"]) == file["spectra/power"].shape[1] + 1


def test_shards_keep_what_differs_in_kind_and_no_time_of_computing() -> None:
    first = some_shard()
    hertz = replace(
        first.entry(0), hypothesis=Hypothesis.of("BA"), joints=("A", "B", "O"), clearances=(1e-4, 2e-4, 1e-5)
    )
    hertz = replace(hertz, stratum="wide", variant=Variant("hertz"))
    outcome = CaseOutcome("diverged", "so", 1.0, 0.0, 0, 0.1, guard_db=0.5)
    contents = [
        hdf5.encode_shard(
            Shard.of(first.header, [hertz] * 2, [replace(outcome, seconds=s), replace(outcome, guard_db=None)])
        )
        for s in (0.1, 0.2)
    ]
    assert contents[0] == contents[1]
    back = hdf5.decode_shard(contents[0], Path("x.h5"))
    assert back.entry(1) == hertz
    assert back.entry(1).worn == ("A", "B")
    assert np.array_equal(back.guard_db, [0.5, np.nan], equal_nan=True)


def test_shard_of_failed_cases_only() -> None:
    shard = some_shard()
    entries = [shard.entry(i) for i in range(2)]
    failed = Shard.of(shard.header, entries, [CaseOutcome("diverged", "so", 1.0, 0.0, 0, 0.1)] * 2)
    back = hdf5.decode_shard(hdf5.encode_shard(failed), Path("x.h5"))
    assert back.row.tolist() == [-1, -1]
    assert back.power.shape == (0, shard.header.recipe.scheme.count, 9)


def test_files_that_are_no_shards_are_refused(tmp_path: Path) -> None:
    good = hdf5.encode_shard(some_shard())
    hdf5.write_arrays(tmp_path / "other.h5", {"t": np.arange(3.0)})
    other = (tmp_path / "other.h5").read_bytes()
    for content in (b"", b"no", good[: len(good) // 2], other):
        with pytest.raises(CatalogueFileError, match=r"^x\.h5: ") as caught:
            hdf5.decode_shard(content, Path("x.h5"))
        assert "\n" not in str(caught.value)


def test_entry_of_a_usual_catalogue_takes_less_than_12_kb() -> None:
    """152 bands, as quick-return up to 4 kHz has; 64 cases in a shard: measured 8.06 kB and 3.9 of cyclic powers."""
    shard = some_shard()
    recipe = replace(shard.header.recipe, orders=100, per_octave=12, f_max=4000.0, nominal_drive_speed=4 * np.pi)
    assert recipe.scheme.count == 152
    entries = [shard.entry(0)] * 64
    root = np.ones((152, 3, 3), np.complex64)
    cyclic = np.zeros((len(recipe.scheme.third_octave_groups()) - 1, 2, 3, 3), np.complex64)
    outcomes = [CaseOutcome("ok", "", 12.5, 1.0, 3, 0.02, root, np.ones((152, 3), np.float32), cyclic)] * 64
    content = hdf5.encode_shard(Shard.of(replace(shard.header, recipe=recipe), entries, outcomes))
    assert len(content) / 64 < 12288


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays(np.float32, (4, 9), elements=st.floats(-(2.0**100), 2.0**100, width=32)),
)
def test_packing_loses_nothing(packed: np.ndarray) -> None:  # type: ignore[type-arg]
    power = unpack(packed)
    assert np.array_equal(power, power.conj().swapaxes(1, 2))
    assert np.array_equal(pack(power), packed)


def test_arrays_of_a_simulation_read_back(tmp_path: Path) -> None:
    arrays = {
        "t": np.linspace(0, 1, 20001),
        "frame_acceleration": np.random.default_rng(1).normal(size=(20001, 3)),
        "links": np.array(["bed", "crank µ"]),
    }
    attributes = {"status": "ok", "sample_rate": 2e4, "steps": 7, "channels": ("x", "y", "theta"), "ok": True}
    path = tmp_path / "out.h5"
    hdf5.write_arrays(path, arrays, units={"t": "s", "frame_acceleration": "m/s2, m/s2, rad/s2"}, attributes=attributes)
    back, found = hdf5.read_arrays(path)
    assert list(back) == list(arrays)
    assert np.array_equal(back["t"], arrays["t"])
    assert np.array_equal(back["frame_acceleration"], arrays["frame_acceleration"])
    assert back["links"].tolist() == ["bed", "crank µ"]
    assert found == attributes
    with h5py.File(path) as file:
        assert file["t"].attrs["unit"] == "s"


def test_arrays_that_cannot_be_read_or_written_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "no.h5").write_text("text")
    for path in (tmp_path / "no.h5", tmp_path / "none.h5"):
        with pytest.raises(CatalogueFileError, match="cannot be read as HDF5") as caught:
            hdf5.read_arrays(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(CatalogueFileError, match=r"out\.h5: cannot be written"):
        hdf5.write_arrays(tmp_path / "none" / "out.h5", {"t": np.arange(3.0)})


def test_publishing_replaces_whole_files_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a"
    publish(path, b"old")

    def crash(descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", crash)
    with pytest.raises(KeyboardInterrupt):
        publish(path, b"new and longer")
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert path.read_bytes() == b"old"
    publish(path, b"new")
    assert path.read_bytes() == b"new"
    assert sha256_of(b"new").startswith("11507a0e")
