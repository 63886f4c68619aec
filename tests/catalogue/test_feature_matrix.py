"""The feature matrix says what the shards say, mapped or in memory, and never what a damaged file says."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from building import quick_build
from fake_simulator import MACHINE, PLAN, compute, diverges

from jointplay.catalogue.building.build import Progress, build
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.entry import Entry, Hypothesis, content_digest
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.plans.variants import Variant
from jointplay.catalogue.storage import matrix, matrix_header, store
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of
from jointplay.catalogue.storage.hdf5 import encode_shard
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.catalogue.storage.sealing import seal
from jointplay.catalogue.storage.shard import OK, CaseOutcome, Shard
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.table import EntryTable
from jointplay.catalogue.storage.verify import verify

ALL = parse_plan(
    {
        **PLAN.content,
        "hypotheses": ["healthy", "singles", "pairs", "triples"],
        "draws": {**PLAN.content["draws"], "pair": 8, "larger": 3},
        "speeds": [1.0, 1.5],
        "bands": {"orders": 24, "per_octave": 12, "f_max": "500 Hz"},
    }
)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalogue")
    build(MACHINE, ALL, path, workers=0, compute=compute, chunk_size=5)
    return path


@pytest.fixture(scope="module")
def mapped(directory: Path) -> FeatureMatrix:
    found = FeatureMatrix.open(Catalogue.open(directory))
    assert found is not None
    return found


@pytest.fixture
def copy(directory: Path, tmp_path: Path) -> Path:
    path = tmp_path / "copy"
    shutil.copytree(directory, path)
    return path


def assert_same_table(one: EntryTable, other: EntryTable) -> None:
    for field in fields(EntryTable):
        if field.name == "parameters":
            assert list(one.parameters) == list(other.parameters)
            assert all(np.array_equal(one.parameters[name], other.parameters[name]) for name in one.parameters)
        elif field.name == "joints":
            assert one.joints == other.joints
        else:
            mine, theirs = getattr(one, field.name), getattr(other, field.name)
            assert np.array_equal(mine, theirs, equal_nan=mine.dtype.kind == "f"), field.name


def assert_same(one: FeatureMatrix, other: FeatureMatrix) -> None:
    assert (one.id, one.content, one.cuts, one.hypotheses) == (other.id, other.content, other.cuts, other.hypotheses)
    assert_same_table(one.table(one.every_row), other.table(other.every_row))
    assert np.array_equal(one.packed(one.all_rows), other.packed(other.all_rows))
    assert np.array_equal(one.places(one.every_row), other.places(other.every_row))


def test_mapped_and_in_memory_are_the_same(directory: Path, mapped: FeatureMatrix) -> None:
    catalogue = Catalogue.open(directory)
    assert_same(mapped, FeatureMatrix.in_memory(catalogue))
    assert mapped.id == catalogue.id == catalogue.matrix.id


def test_groups_are_sums_of_the_stored_bands(directory: Path, mapped: FeatureMatrix) -> None:
    catalogue = Catalogue.open(directory)
    assert mapped.cuts[:21] == tuple(range(21))  # single orders, then more than one band each
    assert mapped.cuts[-1] == catalogue.scheme.count > len(mapped.cuts) - 1
    rows = np.array([3, 40, 7])
    power = mapped.cross_power(rows)
    assert power.shape == (3, len(mapped.cuts) - 1, 3, 3)
    for group, (low, high) in enumerate(zip(mapped.cuts[:-1], mapped.cuts[1:], strict=True)):
        # float32 sums of at most a few bands
        assert np.allclose(power[:, group], catalogue.power()[rows, low:high].sum(axis=1), rtol=1e-5, atol=1e-5)
    assert mapped.edges[0] == catalogue.scheme.edges[0] and mapped.edges[-1] == catalogue.scheme.edges[-1]


def test_rows_are_found_by_hypothesis_draw_and_speed(mapped: FeatureMatrix) -> None:
    table = mapped.table(mapped.all_rows)
    assert [h.label for h in mapped.hypotheses] == ["healthy", "A", "B", "O", "A+B", "A+O", "B+O", "A+B+O"]
    assert mapped.hypotheses[-1] == Hypothesis.of(("A", "B", "O"))
    assert np.array_equal(np.concatenate([mapped.rows(h.label) for h in mapped.hypotheses]), mapped.all_rows)
    rows = mapped.rows("A+O", "trusted")
    assert set(table.hypothesis[rows]) == {"A+O"}
    assert (np.diff(table.draw[rows]) >= 0).all()
    assert mapped.rows("A+O", draws=1).tolist() == rows[table.draw[rows] < 1].tolist()
    assert 0 < len(mapped.rows("A+O", draws=1)) < len(rows)
    slow = mapped.rows("A", speed=1.02 * MACHINE.drive.speed)  # type: ignore[union-attr,operator]
    fast = mapped.rows("A", speed=-1.4 * MACHINE.drive.speed)  # type: ignore[union-attr,operator]
    assert mapped.speeds == (1.0, 1.5)
    assert set(table.speed[slow]) == {1.0} and set(table.speed[fast]) == {1.5}
    assert sorted([*slow, *fast]) == mapped.rows("A").tolist()
    assert len(mapped.rows("A", "wide")) == len(mapped.rows("Z")) == 0


def test_individuals_are_draws_whatever_is_worn_and_the_speed(mapped: FeatureMatrix) -> None:
    table = mapped.table(mapped.all_rows)
    number = mapped.individuals(mapped.all_rows)
    told = [*zip(table.stratum.tolist(), table.draw.tolist(), strict=True)]
    assert len(set(number.tolist())) == len(set(told)) < len({*zip(told, table.hypothesis.tolist(), strict=True)})
    assert len({*zip(number.tolist(), told, strict=True)}) == len(set(told))
    # Numbers are given in the order of the rows.
    assert (np.diff(np.maximum.accumulate(number)) <= 1).all()
    assert number[0] == 0


def test_a_machine_in_order_is_found_for_every_row_that_has_one(mapped: FeatureMatrix) -> None:
    table, rows = mapped.table(mapped.all_rows), mapped.all_rows
    before = mapped.in_order(rows)
    sound = {
        (stratum, draw, speed)
        for label, stratum, draw, speed in zip(table.hypothesis, table.stratum, table.draw, table.speed, strict=True)
        if label == "healthy"
    }
    for row, found in zip(rows.tolist(), before.tolist(), strict=True):
        known = (table.stratum[row], table.draw[row], table.speed[row])
        # One in order is not its own past, and is not there on another day.
        assert (found >= 0) == (known in sound and table.hypothesis[row] != "healthy")
        if found >= 0:
            assert table.hypothesis[found] == "healthy"
            assert (table.stratum[found], table.draw[found], table.speed[found]) == known
    assert (before >= 0).sum() > 20


def test_draws_that_are_other_machines_worn_than_in_order_have_no_past(directory: Path) -> None:
    """As those of catalogues from before draws were the same machines for all hypotheses."""
    whole = FeatureMatrix.in_memory(Catalogue.open(directory))
    columns = whole._columns
    place = next(n for n, name in enumerate(whole._header.parameter_names) if name.startswith("supports."))
    columns.column("parameters")[whole.rows("A"), place] *= 1.001
    assert (whole.in_order(whole.rows("A")) == -1).all()
    assert (whole.in_order(whole.rows("B")) >= 0).any()
    assert not set(whole.individuals(whole.rows("A"))) & set(whole.individuals(whole.rows("B")))


def test_failed_cases_are_rows_behind_the_others(mapped: FeatureMatrix) -> None:
    keys = [entry.key for entry in entries_of(ALL, MACHINE)]
    failed = mapped.table(mapped.failed_rows)
    assert sorted(failed.key) == sorted(key for key in keys if diverges(key))
    assert set(failed.status) == {"diverged"}
    assert sorted(mapped.table(mapped.every_row).key) == sorted(keys)
    for row in (0, 50, len(keys) - 1):
        key = str(mapped.table(np.array([row])).key[0])
        assert mapped.find(key) == mapped.find(key[:9]) == (row,)
    assert mapped.find("zz") == mapped.find("") == mapped.find("0" * 70) == ()
    assert len(mapped.find("7a")) == sum(key.startswith("7a") for key in keys)


def test_numbers_are_those_of_the_table(mapped: FeatureMatrix) -> None:
    table = mapped.table(mapped.all_rows)
    found = mapped.numbers([*table.parameters, "not.drawn"])
    assert found.keys() == table.parameters.keys()
    for path, numbers in found.items():
        assert np.array_equal(numbers, table.parameters[path])


def test_one_matrix_stays_and_who_has_an_old_one_keeps_it(tmp_path: Path) -> None:
    quick_build(tmp_path)
    layout = CatalogueDirectory(tmp_path)
    before = Catalogue.open(tmp_path).matrix
    packed = before.packed(before.all_rows[:3]).copy()
    quick_build(tmp_path, parse_plan({**PLAN.content, "draws": {"healthy": 6, "single": 15}}))
    after = Catalogue.open(tmp_path)
    assert [path.name for path in layout.matrices.iterdir()] == [after.id[:16]]
    assert before.id != after.matrix.id
    assert np.array_equal(before.packed(before.all_rows[:3]), packed)
    assert len(before.table(before.all_rows).key) == len(before) < len(after.matrix)


def test_content_does_not_depend_on_how_it_is_divided(tmp_path: Path) -> None:
    quick_build(tmp_path / "a", chunk_size=4)
    quick_build(tmp_path / "b", chunk_size=3)
    one, other = Catalogue.open(tmp_path / "a"), Catalogue.open(tmp_path / "b")
    assert one.id != other.id
    assert one.matrix.content == other.matrix.content
    quick_build(tmp_path / "b", parse_plan({**PLAN.content, "draws": {"healthy": 6, "single": 15}}))
    assert Catalogue.open(tmp_path / "b").matrix.content != one.matrix.content


def test_catalogue_is_what_the_last_build_left_until_the_next_comes_to_its_end(tmp_path: Path) -> None:
    def stop(progress: Progress) -> None:
        if progress.done > total + 8:
            raise KeyboardInterrupt

    total = quick_build(tmp_path).added
    before = Catalogue.open(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        quick_build(tmp_path, parse_plan({**PLAN.content, "draws": {"healthy": 6, "single": 24}}), progress=stop)
    assert len(CatalogueDirectory(tmp_path).shard_names()) > len(before.manifest.seal.shards)  # type: ignore[union-attr]
    between = Catalogue.open(tmp_path)
    assert between.id == before.id
    assert_same(between.matrix, before.matrix)
    verify(tmp_path)  # enters what is there
    assert len(Catalogue.open(tmp_path).entries) > len(before.entries)


def test_seal_says_of_what_the_catalogue_consists(directory: Path) -> None:
    catalogue = Catalogue.open(directory)
    sealed = catalogue.manifest.seal
    assert sealed is not None
    assert sealed.names == CatalogueDirectory(directory).shard_names()
    assert sealed.root == catalogue.id == catalogue.manifest.root_of(sealed.names)
    assert catalogue.size == sum(path.stat().st_size for path in (directory / "shards").iterdir())
    assert sum(shard.entries for shard in sealed.shards) == len(entries_of(ALL, MACHINE))
    assert sealed.hypotheses == {
        label: int(np.sum(catalogue.entries.hypothesis == label)) for label in sealed.hypotheses
    }
    assert sealed.failed == {"diverged": len(catalogue.failed)}
    assert (sealed.guard, catalogue.matrix.guard) == (None, None)


def test_matching_reads_no_shard(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = Catalogue.open(directory).entries

    def unread(*arguments: object) -> None:
        raise AssertionError("a shard was read")

    monkeypatch.setattr(store, "decode_shard", unread)
    catalogue = Catalogue.open(directory)
    assert_same_table(catalogue.entries, before)
    assert catalogue.matrix.packed(catalogue.matrix.all_rows).shape[0] == len(before)
    assert catalogue.matrix.statuses()["diverged"] == len(catalogue.failed)
    assert catalogue.matrix.ranges.speed == (60.0, 60.0)
    with pytest.raises(AssertionError, match="a shard was read"):
        catalogue.entry(str(before.key[0]))


def test_shard_that_is_gone_is_refused_on_opening(copy: Path) -> None:
    victim = CatalogueDirectory(copy).shard(CatalogueDirectory(copy).shard_names()[2])
    victim.unlink()
    with pytest.raises(CatalogueFileError, match=rf"{victim.name}: is missing: verify the catalogue"):
        Catalogue.open(copy)


def test_any_changed_number_of_the_manifest_is_refused(copy: Path) -> None:
    text = (copy / "manifest.json").read_text()
    (copy / "manifest.json").write_text(text.replace('"sample_rate": 10000.0', '"sample_rate": 10001.0'))
    with pytest.raises(CatalogueFileError, match=r"manifest\.json: is damaged \(it does not match its checksum\)"):
        Catalogue.open(copy)


FILES = ("header.json", "power.npy", "power.sha256", "clearance.npy", "key.npy", "draw.npy", "hypothesis.npy")


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("place", [0.6, 0.99])
def test_damage_is_never_served_and_repaired_by_a_check(copy: Path, directory: Path, name: str, place: float) -> None:
    catalogue = Catalogue.open(copy)
    path = CatalogueDirectory(copy).matrix(catalogue.id) / name
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 4
    path.write_bytes(content)
    with pytest.raises(CatalogueFileError, match=r"`jointplay reindex` makes the matrix again$") as caught:
        use_all(catalogue)
    assert "\n" not in str(caught.value)
    report = verify(copy)
    assert [finding.action for finding in report.findings] == ["made again from the shards"]
    assert report.lost_entries == 0
    assert_same(Catalogue.open(copy).matrix, Catalogue.open(directory).matrix)
    assert verify(copy).is_sound


def use_all(catalogue: Catalogue) -> None:
    matrix = catalogue.matrix
    matrix.table(matrix.every_row)
    matrix.packed(matrix.all_rows)


def test_missing_file_is_damage_and_a_missing_matrix_is_made_in_memory(copy: Path, directory: Path) -> None:
    layout, catalogue = CatalogueDirectory(copy), Catalogue.open(copy)
    (layout.matrix(catalogue.id) / "draw.npy").unlink()
    with pytest.raises(CatalogueFileError, match="lacks a file: `jointplay reindex` makes the matrix again"):
        use_all(catalogue)
    shutil.rmtree(layout.matrices)
    assert_same(Catalogue.open(copy).matrix, Catalogue.open(directory).matrix)
    assert not layout.matrices.exists()
    assert [finding.what for finding in verify(copy).findings] == ["is missing"]
    assert layout.matrix(catalogue.id).is_dir()


@pytest.mark.parametrize("moment", ["before it is named", "after it is named"])
def test_builders_that_publish_the_same_state_at_once(copy: Path, monkeypatch: pytest.MonkeyPatch, moment: str) -> None:
    """Another builder publishes just before this one gives its own matrix the name; or deletes it just after."""
    catalogue, layout = Catalogue.open(copy), CatalogueDirectory(copy)
    expected = catalogue.matrix.packed(catalogue.matrix.all_rows)
    shutil.rmtree(layout.matrices)
    remove, write = CatalogueDirectory.remove_folder, matrix.write_matrix

    def remove_then_publish(self: CatalogueDirectory, path: Path) -> None:
        remove(self, path)
        monkeypatch.undo()
        FeatureMatrix.publish(catalogue)

    def write_then_delete(*arguments: Any) -> Any:
        found = write(*arguments)
        remove(layout, layout.matrix(catalogue.id))
        return found

    if moment == "before it is named":
        monkeypatch.setattr(CatalogueDirectory, "remove_folder", remove_then_publish)
    else:
        monkeypatch.setattr(matrix, "write_matrix", write_then_delete)
    found = FeatureMatrix.publish(catalogue)
    assert np.array_equal(found.packed(found.all_rows), expected)
    assert layout.matrix(catalogue.id).exists() == (moment == "before it is named")
    assert not list(layout.matrices.glob(".tmp*"))


def test_matrix_of_another_version_is_made_again(copy: Path, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matrix_header, "MATRIX_VERSION", 99)
    catalogue = Catalogue.open(copy)
    assert FeatureMatrix.open(catalogue) is None
    in_memory = catalogue.matrix
    FeatureMatrix.publish(catalogue)
    assert FeatureMatrix.open(catalogue) is not None
    monkeypatch.undo()
    assert_same(in_memory, Catalogue.open(directory).matrix)


def test_strata_laws_and_the_guard(tmp_path: Path) -> None:
    """Shards put together by hand: what plans cannot ask for in this test's machine."""
    manifest, layout = Manifest.of(MACHINE, PLAN), CatalogueDirectory(tmp_path)
    layout.create()
    bands = manifest.recipe.scheme.count
    cyclic = np.zeros((len(manifest.recipe.scheme.third_octave_groups()) - 1, 2, 3, 3))
    for stratum, law, draws in (("trusted", "own", range(4)), ("wide", "hertz", (5, 2)), ("trusted", "hertz", (4, 5))):
        entries, outcomes = [], []
        for draw in draws:
            entry = Entry(
                content_digest([stratum, law, draw]), Hypothesis.of(("B",)), ("A", "B"), (1e-5, 1e-4 * (draw + 1)), {},
                draw, stratum, Variant(law),  # type: ignore[arg-type]
            )  # fmt: skip
            power = np.eye(3)[None] * np.full((bands, 1, 1), draw + 1.0)
            guard = 0.5 * draw if draw % 2 == 0 else None
            entries.append(entry)
            outcomes.append(CaseOutcome(OK, "", -10.0 - draw, 0.1, 3, 0.0, power, np.ones((bands, 3)), cyclic, guard))
        content = encode_shard(Shard.of(manifest.header(PLAN), entries, outcomes))
        layout.shard(sha256_of(content)).write_bytes(content)
    matrix = seal(layout, manifest, layout.shard_names).matrix
    table = matrix.table(matrix.all_rows)
    assert table.stratum.tolist() == ["trusted"] * 6 + ["wide"] * 2
    assert table.draw.tolist() == [0, 1, 2, 3, 4, 5, 2, 5]
    assert table.law.tolist() == ["own"] * 4 + ["hertz"] * 4
    assert table.worn_of(0) == ("B",)
    assert matrix.rows("B", "wide").tolist() == [6, 7]
    assert matrix.rows("B", draws=3).tolist() == [0, 1, 2, 6]
    assert np.allclose(matrix.packed(matrix.all_rows)[:, 0, 0], table.draw + 1.0)
    assert matrix.ranges.clearance == {"B": pytest.approx((1e-4, 6e-4))}
    assert matrix.ranges.speed == (10.0, 15.0)
    assert matrix.guard is not None and Catalogue.open(tmp_path).manifest.seal is not None
    assert (matrix.guard.count, matrix.guard.mean_db) == (4, pytest.approx((0 + 1 + 2 + 1) / 4))
    assert Catalogue.open(tmp_path).manifest.seal.guard == {  # type: ignore[union-attr]
        "entries": 4, "mean_db": matrix.guard.mean_db, "p90_db": matrix.guard.p90_db,
    }  # fmt: skip
