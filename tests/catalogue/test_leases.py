"""The index and its chunks, in every kind of database: who gets a chunk, for how long, and what is stored of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest
from building import FAILING, KEYS, assert_complete, quick_build
from fake_simulator import MACHINE, PLAN, compute
from sqlalchemy import inspect, text

from jointplay.catalogue.building.chunk import cut_chunks
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.storage.database import INDEX_LAYOUT, Database, database_url
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.index import EntriesPresentError, Index
from jointplay.catalogue.storage.leases import ChunkRow, ChunkStatus, Leases
from jointplay.catalogue.storage.location import IndexLocation
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.shard import Shard
from jointplay.catalogue.storage.verify import reindex, verify

CHUNKS = [ChunkRow(f"chunk-{number:03d}", "A", 4) for number in range(40)]
IDS = [chunk.id for chunk in CHUNKS]


@pytest.fixture
def index(url: str) -> Iterator[Index]:
    with Index(url) as opened:
        yield opened


def shard_of(first: int, last: int) -> Shard:
    entries = [entry for entry in entries_of(PLAN, MACHINE) if entry.worn == ("A",)][first:last]
    manifest = Manifest.of(MACHINE, PLAN)
    (chunk,) = cut_chunks(MACHINE, manifest.recipe, entries, 64)
    return Shard.of(manifest.header(PLAN), entries, compute(chunk))


def test_two_builders_never_get_the_same_chunk(url: str, index: Index) -> None:
    """Eight of them ask for all chunks at the same moment, in different orders."""
    index.leases.plan(CHUNKS, alone=True)
    start = Barrier(8)

    def builder(number: int) -> list[str]:
        with Index(url) as mine:
            start.wait()
            wanted = IDS[number * 5 :] + IDS[: number * 5]
            return [chunk for k in range(0, 40, 4) for chunk in mine.leases.claim(f"b{number}", wanted[k : k + 4], 60)]

    with ThreadPoolExecutor(8) as pool:
        granted = list(pool.map(builder, range(8)))
    assert sorted(chunk for chunks in granted for chunk in chunks) == IDS
    rows = {row.id: row for row in index.chunks()}
    assert all(rows[chunk].owner == f"b{number}" for number, chunks in enumerate(granted) for chunk in chunks)
    assert {row.status for row in rows.values()} == {ChunkStatus.RUNNING}
    assert {row.attempts for row in rows.values()} == {1}


def test_lease_ends_unless_it_is_extended(index: Index, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Leases._now

    def pass_until(seconds: float) -> None:
        monkeypatch.setattr(Leases, "_now", lambda leases: clock(leases) + seconds)

    index.leases.plan(CHUNKS[:2], alone=True)
    assert index.leases.claim("first", IDS[:1], 3000) == {IDS[0]}
    assert index.leases.claim("second", IDS[:2], 60_000) == {IDS[1]}
    assert index.leases.states(IDS[:2]) == dict.fromkeys(IDS[:2], ChunkStatus.RUNNING)
    index.leases.extend("first", 8000)
    pass_until(4000)
    assert index.leases.claim("second", IDS[:1], 60) == set()
    pass_until(10_000)
    assert index.leases.states(IDS[:2]) == {IDS[0]: ChunkStatus.PENDING, IDS[1]: ChunkStatus.RUNNING}
    assert index.leases.claim("third", IDS[:2], 60) == {IDS[0]}
    index.leases.extend("first", 60)  # too late: it is another's now
    assert [(row.owner, row.attempts) for row in index.chunks()] == [("third", 2), ("second", 1)]


def test_what_is_given_back_can_be_claimed(index: Index) -> None:
    index.leases.plan(CHUNKS[:3], alone=True)
    index.leases.claim("first", IDS[:2], 60)
    index.leases.claim("second", IDS[2:3], 60)
    index.leases.give_back("first")
    assert index.leases.claim("third", IDS[:3], 60) == set(IDS[:2])


def test_plan_of_one_who_is_alone_and_of_one_who_is_not(index: Index) -> None:
    index.leases.plan(CHUNKS[:4], alone=True)
    index.leases.claim("first", IDS[:3], 60)
    index.leases.finish(IDS[0])
    index.leases.finish(IDS[1], "its worker died")
    index.leases.plan(CHUNKS[:5], alone=False)
    lost_again = [ChunkStatus.DONE, ChunkStatus.PENDING, ChunkStatus.RUNNING, ChunkStatus.PENDING, ChunkStatus.PENDING]
    assert [row.status for row in index.chunks()] == lost_again
    index.leases.plan(CHUNKS[1:3], alone=True)  # what ran had no owner any more; what is not wanted is forgotten
    assert [(row.id, row.status) for row in index.chunks()] == [
        (IDS[0], ChunkStatus.DONE),
        (IDS[1], ChunkStatus.PENDING),
        (IDS[2], ChunkStatus.PENDING),
    ]


def test_shard_is_entered_once_and_whole(index: Index) -> None:
    shard = shard_of(0, 4)
    index.leases.plan([ChunkRow("c", "A", 4)], alone=True)
    assert index.add_shard("a" * 64, 1000, shard, chunk="c", seconds=1.5) == 4
    assert index.add_shard("a" * 64, 1000, shard, chunk="c", seconds=1.5) == 0
    with pytest.raises(EntriesPresentError, match="2 of its entries lie in another shard") as caught:
        index.add_shard("b" * 64, 1000, shard_of(2, 6))
    assert caught.value.keys == set(shard.key[2:])
    assert set(index.shards()) == {"a" * 64}
    assert index.find_known([*shard.key, "nobody"]) == dict(zip(shard.key, shard.status, strict=True))
    (row,) = index.chunks()
    assert (row.status, row.output_sha256, row.seconds) == (ChunkStatus.DONE, "a" * 64, 1.5)
    index.remove_shards(["a" * 64])
    assert index.places() == {}


def test_entries_of_two_builders_at_the_same_moment(url: str) -> None:
    """The same cases in shards of other bytes: one is entered, the other refused, whoever comes first."""
    start = Barrier(4)

    shard = shard_of(0, 4)

    def builder(number: int) -> int:
        with Index(url) as mine:
            start.wait()
            try:
                return mine.add_shard(str(number) * 64, 1000, shard)
            except EntriesPresentError as error:
                return -len(error.keys)

    with ThreadPoolExecutor(4) as pool:
        assert sorted(pool.map(builder, range(4))) == [-4, -4, -4, 4]


def test_catalogues_in_one_database_do_not_meet(url: str) -> None:
    with Index(url, "one") as one, Index(url, "two") as two:
        one.leases.plan(CHUNKS[:2], alone=True)
        two.leases.plan(CHUNKS[:1], alone=True)
        one.add_shard("a" * 64, 1, shard_of(0, 4))
        two.add_shard("a" * 64, 1, shard_of(0, 4))
        two.remove_shards(["a" * 64])
        two.leases.claim("b", IDS, 60)
        assert (len(one.places()), len(two.places())) == (4, 0)
        assert one.leases.claim("b", IDS, 60) == set(IDS[:2])


def test_tables_are_made_once_by_whoever_comes_first(url: str) -> None:
    start = Barrier(4)

    def opened(_: int) -> int:
        start.wait()
        with Index(url) as index:
            return len(index.shards())

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(opened, range(4))) == [0] * 4


def execute(url: str | Path, *statements: str) -> None:
    database = Database(database_url(url), wait=10.0, durable=False, connect={})
    with database.transaction() as connection:
        for statement in statements:
            connection.execute(text(statement))
    database.close()


OTHER_LAYOUT = "UPDATE index_layout SET number = 99"
OTHER_RULE = rf"is an index of layout 99, not {INDEX_LAYOUT}: `jointplay reindex` makes it anew$"


def test_index_of_another_layout_is_refused_or_made_anew(url: str) -> None:
    with Index(url) as index:
        index.leases.plan(CHUNKS, alone=True)
    execute(url, OTHER_LAYOUT, "ALTER TABLE chunks DROP COLUMN message")
    for _ in range(2):
        with pytest.raises(CatalogueFileError, match=OTHER_RULE):
            Index(url)
    with Index(url, anew=True) as index:
        assert index.chunks() == ()
        index.leases.plan(CHUNKS, alone=True)
    with Index(url, anew=True) as index:  # nothing is lost where the layout is the same
        assert [row.id for row in index.chunks()] == IDS


@pytest.mark.parametrize("anew", [False, True])
def test_tables_of_something_else_are_left_alone(url: str, anew: bool) -> None:
    execute(url, "CREATE TABLE entries (thesis TEXT)", "INSERT INTO entries VALUES ('five years')")
    with pytest.raises(CatalogueFileError, match=r"holds tables of something else \(entries\)$"):
        Index(url, anew=anew)
    database = Database(database_url(url), wait=10.0, durable=False, connect={})
    with database.transaction() as connection:
        assert inspect(connection).get_table_names() == ["entries"]
        assert connection.scalar(text("SELECT thesis FROM entries")) == "five years"
    database.close()


def test_file_of_another_layout_is_made_again_from_the_shards(tmp_path: Path) -> None:
    directory = tmp_path / "catalogue"
    quick_build(directory)
    file = directory / "index.sqlite"
    execute(file, OTHER_LAYOUT)
    assert quick_build(directory).adopted == len(KEYS)
    assert_complete(directory)
    execute(file, OTHER_LAYOUT)
    (finding,) = verify(directory).findings
    assert finding.what.startswith("is an index of layout 99")
    execute(file, OTHER_LAYOUT)
    assert reindex(directory).is_sound
    assert_complete(directory)


def test_database_of_another_layout_is_made_again_by_reindex_alone(tmp_path: Path, url: str) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    for directory in (first, second):
        quick_build(directory, index=url)
    execute(url, OTHER_LAYOUT)
    for use in (lambda: quick_build(first), lambda: verify(first)):
        with pytest.raises(CatalogueFileError, match=OTHER_RULE):
            use()
    assert reindex(first).is_sound
    assert quick_build(first).added == 0
    assert quick_build(second).adopted == len(KEYS)  # what its tables said was lost with them
    for directory in (first, second):
        assert_complete(directory)
        assert verify(directory).is_sound


@pytest.mark.parametrize(
    ("url", "rule"),
    [
        ("nonsense", "is no URL of a database: postgresql://user@host:5432/database"),
        ("mysql://root@localhost/x", "mysql://root@localhost/x: mysql: must be postgresql:// or sqlite:///FILE"),
        ("postgresql://postgres@127.0.0.1:1/test", "cannot be used as an index"),
    ],
)
def test_other_urls_are_one_line(url: str, rule: str) -> None:
    with pytest.raises(CatalogueFileError) as caught:
        Index(url)
    assert rule in str(caught.value)
    assert "\n" not in str(caught.value)


def test_build_with_its_index_in_a_database(tmp_path: Path, url: str) -> None:
    directory = tmp_path / "catalogue"
    first = quick_build(directory, index=url)
    assert first.added == len(KEYS)
    assert first.failed == {"diverged": len(FAILING)}
    assert not (directory / "index.sqlite").exists()
    again = quick_build(directory)  # the URL is remembered
    assert (again.added, again.present) == (0, len(KEYS))
    layout = CatalogueDirectory(directory)
    location = IndexLocation.of(layout)
    assert location.source == database_url(url).render_as_string(hide_password=False)
    with location.open() as index:
        assert len(index.places()) == len(KEYS)
        assert {row.output_sha256 for row in index.chunks()} == set(layout.shard_names())
        index.remove_shards(layout.shard_names()[:1])
    report = verify(directory)
    assert [finding.what for finding in report.findings] == ["did not know 1 shards"]
    layout.shard(layout.shard_names()[0]).unlink()
    assert quick_build(directory).added in (2, 4)
    assert_complete(directory)
    (directory / "index.json").write_text("{}")
    with pytest.raises(CatalogueFileError, match=r"index\.json: does not say where the index is"):
        quick_build(directory)


def test_index_moves_to_a_database_and_back_but_not_under_others(tmp_path: Path, url: str) -> None:
    directory = tmp_path / "catalogue"
    quick_build(directory)
    said: list[str] = []

    def second(progress: object) -> None:
        with pytest.raises(CatalogueFileError) as caught:
            quick_build(directory, index=f"sqlite:///{tmp_path / 'other.db'}")
        said.append(str(caught.value))

    report = quick_build(directory, index=url, progress=second)
    assert (report.added, report.adopted) == (0, len(KEYS))
    assert not said  # nothing was to be done, so nothing was told
    layout = CatalogueDirectory(directory)
    layout.shard(layout.shard_names()[0]).unlink()
    quick_build(directory, progress=second)
    assert said[0].startswith(f"{directory}: is being built with the index")
    assert_complete(directory)


def test_password_is_not_stored(tmp_path: Path) -> None:
    layout = CatalogueDirectory(tmp_path)
    content = {"url": "postgresql+psycopg://me@db.example/x", "instance": "i"}
    (tmp_path / "index.json").write_text(json.dumps(content))
    location = IndexLocation.choose(layout, "postgresql://me:secret@db.example/x", alone=True)
    assert (location.source, location.instance, location.password) == (content["url"], "i", "secret")
    assert "secret" not in (tmp_path / "index.json").read_text()
    assert "secret" not in repr(location)
