"""Verification: whatever is damaged is named, put aside or repaired, and a build restores the rest."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_simulator import MACHINE, PLAN, compute

from jointplay import solver
from jointplay.catalogue.building.build import build
from jointplay.catalogue.errors import CatalogueFileError, CatalogueMismatchError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of
from jointplay.catalogue.storage.hdf5 import LAYOUT_VERSION, decode_shard, encode_shard
from jointplay.catalogue.storage.shard import Shard
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.verify import reindex, verify

TOTAL = len(entries_of(PLAN, MACHINE))


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("built")
    build(MACHINE, PLAN, path, workers=0, compute=compute, chunk_size=4)
    return path


@pytest.fixture
def directory(built: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "catalogue"
    shutil.copytree(built, copy)
    return copy


def rebuilt(directory: Path, built: Path) -> bool:
    """Whether building again and verifying makes the same catalogue as before the damage."""
    build(MACHINE, PLAN, directory, workers=0, compute=compute, chunk_size=4)
    return verify(directory).is_sound and Catalogue.open(directory).id == Catalogue.open(built).id


def dump(path: Path) -> list[str]:
    with sqlite3.connect(path) as connection:
        lines = [line for line in connection.iterdump() if "chunks" not in line]
    connection.close()
    return sorted(lines)


def test_sound_catalogue(directory: Path) -> None:
    report = verify(directory)
    assert report.is_sound
    assert report.entries == TOTAL
    assert report.failed == len(Catalogue.open(directory).failed)
    assert report.shards == len(CatalogueDirectory(directory).shard_names())
    assert report.lost_entries == 0


@pytest.mark.parametrize("place", [0.0, 0.3, 0.6, 0.999])
@pytest.mark.parametrize("with_index", [True, False])
def test_flipped_bit_is_found_and_the_shard_named(directory: Path, built: Path, place: float, with_index: bool) -> None:
    victim = sorted((directory / "shards").iterdir())[2]
    content = bytearray(victim.read_bytes())
    lost = decode_shard(bytes(content), victim).count
    content[int(place * len(content))] ^= 16
    victim.write_bytes(content)
    if not with_index:
        (directory / "index.sqlite").unlink()
    report = verify(directory)
    assert not report.is_sound
    found = [finding for finding in report.findings if finding.path == victim]
    assert [finding.what for finding in found] == ["does not match its checksum"]
    assert report.entries == TOTAL - lost
    assert report.lost_entries == (lost if with_index else 0)
    assert not victim.exists()
    assert (directory / "quarantine" / victim.name).read_bytes() == content
    assert str(found[0]) == f"{victim}: does not match its checksum; moved to quarantine/{victim.name}"
    assert verify(directory).is_sound
    assert rebuilt(directory, built)


def test_truncated_shard_is_found(directory: Path, built: Path) -> None:
    victim = sorted((directory / "shards").iterdir())[0]
    victim.write_bytes(victim.read_bytes()[:1000])
    assert [finding.path for finding in verify(directory).findings] == [victim]
    assert rebuilt(directory, built)


def test_missing_shard_is_found(directory: Path, built: Path) -> None:
    victim = sorted((directory / "shards").iterdir())[0]
    lost = decode_shard(victim.read_bytes(), victim).count
    victim.unlink()
    report = verify(directory)
    assert [(finding.path, finding.what) for finding in report.findings] == [(victim, "is missing")]
    assert report.lost_entries == lost > 0
    assert rebuilt(directory, built)


def test_deleted_index_is_made_again_the_same(directory: Path, built: Path) -> None:
    before = dump(directory / "index.sqlite")
    (directory / "index.sqlite").unlink()
    report = verify(directory)
    assert [(finding.path.name, finding.what) for finding in report.findings] == [("index.sqlite", "is missing")]
    assert dump(directory / "index.sqlite") == before
    assert verify(directory).is_sound
    assert rebuilt(directory, built)


def test_reindex_makes_everything_that_follows_from_the_shards_again(directory: Path) -> None:
    before, catalogue = dump(directory / "index.sqlite"), Catalogue.open(directory)
    folder = CatalogueDirectory(directory).matrix(catalogue.id)
    matrix = {path.name: path.read_bytes() for path in folder.iterdir()}
    (folder / "power.npy").write_bytes(b"nonsense")
    (folder / "draw.npy").unlink()
    (directory / "index.sqlite").write_bytes(b"nonsense")
    report = reindex(directory)
    assert (report.findings, report.entries, report.lost_entries) == ((), TOTAL, 0)
    assert dump(directory / "index.sqlite") == before
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == matrix
    assert Catalogue.open(directory).id == catalogue.id
    assert reindex(directory).is_sound and verify(directory).is_sound


def test_reindex_puts_damaged_shards_aside(directory: Path, built: Path) -> None:
    victim = sorted((directory / "shards").iterdir())[2]
    victim.write_bytes(victim.read_bytes()[:-3])
    report = reindex(directory)
    assert [(finding.path, finding.what) for finding in report.findings] == [(victim, "does not match its checksum")]
    assert rebuilt(directory, built)


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"nonsense" * 1000),
        lambda path: path.write_bytes(path.read_bytes()[:5000] + bytes(9000) + path.read_bytes()[14000:]),
    ],
)
def test_damaged_index_is_put_aside_and_made_again(
    directory: Path, built: Path, damage: Callable[[Path], object]
) -> None:
    damage(directory / "index.sqlite")
    report = verify(directory)
    assert {finding.path.name for finding in report.findings} == {"index.sqlite"}
    assert (directory / "quarantine" / "index.sqlite").exists()
    assert verify(directory).is_sound
    assert rebuilt(directory, built)


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM entries WHERE position = 1",
        "DELETE FROM shards",
        "UPDATE entries SET position = 3 - position",
    ],
)
def test_index_that_says_something_else_is_corrected(directory: Path, statement: str) -> None:
    before = dump(directory / "index.sqlite")
    with sqlite3.connect(directory / "index.sqlite") as connection:
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute(statement)
    connection.close()
    report = verify(directory)
    assert not report.is_sound
    assert dump(directory / "index.sqlite") == before
    assert verify(directory).is_sound


@pytest.mark.parametrize(
    "content", [None, "", "{}", f'{{"format": "jointplay catalogue", "layout_version": {LAYOUT_VERSION}}}']
)
def test_manifest_is_made_again_from_a_shard(directory: Path, built: Path, content: str | None) -> None:
    before = Catalogue.open(directory)
    (directory / "manifest.json").unlink()
    if content is not None:
        (directory / "manifest.json").write_text(content)
    report = verify(directory)
    assert {finding.path.name for finding in report.findings} == {"manifest.json"}
    after = Catalogue.open(directory)
    assert after.id == before.id
    assert after.plan == before.plan
    assert rebuilt(directory, built)


def test_unfinished_files_are_deleted(directory: Path) -> None:
    (directory / "shards" / ".tmp-1-2").write_bytes(b"half")
    report = verify(directory)
    assert [finding.what for finding in report.findings] == ["1 unfinished files of an interrupted build"]
    assert verify(directory).is_sound


def test_shard_of_another_catalogue_is_put_aside(directory: Path, tmp_path: Path) -> None:
    other = parse_plan({**PLAN.content, "sample_rate": 14000})
    build(MACHINE, other, tmp_path / "other", workers=0, compute=compute)
    stray = sorted((tmp_path / "other" / "shards").iterdir())[0]
    shutil.copy(stray, directory / "shards")
    report = verify(directory)
    assert [finding.what for finding in report.findings] == [
        "belongs to another machine, other settings or other numbers"
    ]
    assert (directory / "quarantine" / stray.name).exists()


def test_other_numbers_are_said_and_nothing_is_put_aside(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, here = Catalogue.open(directory).id, solver.NUMBERS_VERSION
    assert verify(directory).other_numbers == ""
    monkeypatch.setattr(solver, "NUMBERS_VERSION", here + 1)
    report = verify(directory)
    assert report.other_numbers == f"holds numbers of version {here}, this program computes version {here + 1}"
    assert report.is_sound and report.entries == TOTAL
    assert Catalogue.open(directory).id == before
    (directory / "manifest.json").unlink()
    again = verify(directory)  # the manifest is made of a shard, and says what that says
    assert [finding.path.name for finding in again.findings] == ["manifest.json"]
    assert again.other_numbers == report.other_numbers


def test_shard_with_other_numbers_is_put_aside(
    directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(solver, "NUMBERS_VERSION", solver.NUMBERS_VERSION + 1)
    build(MACHINE, PLAN, tmp_path / "other", workers=0, compute=compute)
    stray = sorted((tmp_path / "other" / "shards").iterdir())[0]
    shutil.copy(stray, directory / "shards")
    monkeypatch.undo()
    report = verify(directory)
    assert [finding.what for finding in report.findings] == [
        "belongs to another machine, other settings or other numbers"
    ]
    assert report.entries == TOTAL


def test_catalogue_of_another_layout_that_lost_its_manifest_is_left_alone(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (directory / "manifest.json").unlink()
    before = sorted(path for path in directory.rglob("*") if path.name != "build.lock")
    monkeypatch.setattr("jointplay.catalogue.storage.hdf5.LAYOUT_VERSION", 99)
    for check in (verify, reindex):
        with pytest.raises(
            CatalogueMismatchError, match=rf"\.h5: has layout {LAYOUT_VERSION}; this program reads layout 99: build the"
        ):
            check(directory)
    assert sorted(path for path in directory.rglob("*") if path.name != "build.lock") == before


def test_shard_of_another_layout_is_put_aside(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = sorted((directory / "shards").iterdir())[0]
    shard = decode_shard(path.read_bytes(), path)
    monkeypatch.setattr("jointplay.catalogue.storage.hdf5.LAYOUT_VERSION", 99)
    content = encode_shard(shard)
    monkeypatch.undo()
    stray = directory / "shards" / f"{sha256_of(content)}.h5"
    stray.write_bytes(content)
    report = verify(directory)
    rule = f"has layout 99; this program reads layout {LAYOUT_VERSION}: build the catalogue anew in another folder"
    assert [(finding.path, finding.what) for finding in report.findings] == [(stray, rule)]
    assert report.entries == TOTAL


def test_a_stray_shard_of_another_layout_does_not_keep_a_lost_manifest_from_being_made_again(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = sorted(path.stem for path in (directory / "shards").iterdir())
    shard = decode_shard((directory / "shards" / f"{names[-1]}.h5").read_bytes(), directory)
    monkeypatch.setattr("jointplay.catalogue.storage.hdf5.LAYOUT_VERSION", 99)
    content = encode_shard(shard)
    monkeypatch.undo()
    stray = directory / "shards" / f"{sha256_of(content)}.h5"
    stray.write_bytes(content)
    monkeypatch.setattr(
        CatalogueDirectory, "shard_names", lambda _: [stray.stem, *names]
    )  # it is met before all others
    (directory / "manifest.json").unlink()
    report = verify(directory)
    assert {finding.path for finding in report.findings} == {stray, directory / "manifest.json"}
    assert report.entries == TOTAL


def with_nan(shard: Shard) -> Shard:
    power = shard.power.copy()
    power[0, 3, 4] = np.nan
    return replace(shard, power=power)


def with_negative_power(shard: Shard) -> Shard:
    power = shard.power.copy()
    power[0, 3, 1] = -1.0
    return replace(shard, power=power)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (with_nan, "holds a number that is not finite, or a negative spread"),
        (with_negative_power, "holds a negative power"),
        (lambda shard: replace(shard, clearance=shard.clearance * 1.001), "does not match its key"),
        (lambda shard: replace(shard, draw=shard.draw[1:]), "has columns of different lengths"),
        (lambda shard: replace(shard, power=shard.power[1:]), "has spectra of another shape"),
        (lambda shard: replace(shard, row=shard.row * 0), "has entries whose spectrum is missing"),
    ],
)
def test_numbers_that_cannot_be_are_found_under_a_good_checksum(
    directory: Path, change: Callable[[Shard], Shard], what: str
) -> None:
    layout = CatalogueDirectory(directory)
    name = next(n for n in layout.shard_names() if decode_shard(layout.shard(n).read_bytes(), layout.root).joints)
    shard = decode_shard(layout.shard(name).read_bytes(), layout.shard(name))
    content = encode_shard(change(shard))
    layout.shard(name).unlink()
    layout.shard(sha256_of(content)).write_bytes(content)
    report = verify(directory)
    assert any(what in finding.what for finding in report.findings)
    assert verify(directory).is_sound


def test_same_entries_in_two_shards_count_once(directory: Path) -> None:
    layout = CatalogueDirectory(directory)
    name = layout.shard_names()[0]
    shard = decode_shard(layout.shard(name).read_bytes(), layout.shard(name))
    content = encode_shard(replace(shard, transient=shard.transient + 1))
    layout.shard(sha256_of(content)).write_bytes(content)
    assert verify(directory).entries == TOTAL
    assert verify(directory).is_sound
    catalogue = Catalogue.open(directory)
    assert len(catalogue.entries) + len(catalogue.failed) == TOTAL


def test_folders_that_are_no_catalogue_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(CatalogueFileError, match=r"is not a catalogue: it has no manifest\.json and no shards$"):
            verify(path)
    (tmp_path / "shards").mkdir()
    with pytest.raises(CatalogueFileError, match="is missing, and no shard tells what it should say"):
        verify(tmp_path)
