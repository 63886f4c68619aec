"""A catalogue checked against its checksums and what must be true of its numbers; its index made to agree with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from jointplay.catalogue.errors import CatalogueError, CatalogueFileError, CatalogueMismatchError
from jointplay.catalogue.plans.entry import Entry, entry_key
from jointplay.catalogue.storage.cross_power import CYCLIC, pack, unpack
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of
from jointplay.catalogue.storage.hdf5 import decode_shard
from jointplay.catalogue.storage.index import EntriesPresentError, Index
from jointplay.catalogue.storage.location import IndexLocation
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.matrix_files import MappedColumns
from jointplay.catalogue.storage.sealing import seal
from jointplay.catalogue.storage.shard import OK, Shard, ShardHeader
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import parse_machine
from jointplay.solver.spectra.bands import FEATURE_ORDERS


def check_shard(shard: Shard, path: Path) -> None:
    """Refuse a shard whose numbers cannot be, whatever its checksum says.

    Parameters
    ----------
    shard : Shard
    path : Path
        Its file, for messages.

    Raises
    ------
    CatalogueFileError
        Says what is wrong.
    """
    count, spectra = shard.count, shard.power.shape[0]
    bands = shard.header.recipe.scheme.count
    if shard.power.shape != (spectra, bands, 9) or shard.spread_db.shape != (spectra, bands, 3):
        raise CatalogueFileError(path, "has spectra of another shape than its bands ask for")
    groups = len(shard.header.recipe.scheme.third_octave_groups(FEATURE_ORDERS)) - 1
    if shard.cyclic.shape != (spectra, groups, len(CYCLIC)):
        raise CatalogueFileError(path, "has cyclic powers of another shape than its bands ask for")
    columns = ("status", "message", "clearance", "parameters", "draw", "segments", "period", "row", "drive_speed")
    if any(len(getattr(shard, column)) != count for column in (*columns, "transient", "guard_db")):
        raise CatalogueFileError(path, "has columns of different lengths")
    if not (np.isfinite(shard.power).all() and np.isfinite(shard.spread_db).all() and (shard.spread_db >= 0).all()):
        raise CatalogueFileError(path, "holds a number that is not finite, or a negative spread")
    if not np.isfinite(shard.cyclic).all():
        raise CatalogueFileError(path, "holds a cyclic power that is not finite")
    if not (shard.power[..., :3] >= 0).all():
        raise CatalogueFileError(path, "holds a negative power")
    if not np.array_equal(pack(unpack(shard.power)), shard.power):
        raise CatalogueFileError(path, "holds cross-powers that do not read back")
    good = np.array([status == OK for status in shard.status], dtype=bool)
    if not np.array_equal(np.sort(shard.row[good]), np.arange(spectra)) or (shard.row[~good] != -1).any():
        raise CatalogueFileError(path, "has entries whose spectrum is missing")
    _check_keys(shard, path)


def _check_keys(shard: Shard, path: Path) -> None:
    """Make every key again from what it stands for."""
    try:
        machine = parse_machine(shard.header.machine, str(path))
        for position in range(shard.count):
            entry: Entry = shard.entry(position)
            content = shard.header.recipe.content
            version, variant = shard.header.numbers_version, entry.variant.content
            key = entry_key(machine.content_key, entry.fault, entry.parameters, content, version, variant)
            if key != entry.key:
                raise CatalogueFileError(path, f"entry {entry.key[:12]} does not match its key")
    except MachineError as error:
        raise CatalogueFileError(path, f"has a machine that cannot be read ({error.rule})") from None
    except CatalogueFileError:
        raise
    except CatalogueError as error:
        raise CatalogueFileError(path, f"holds a number that is not finite ({error})") from None


_NONE = np.empty((0, 0, 0), np.float32)


@dataclass(frozen=True)
class Finding:
    """Something that was not in order.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What was wrong.
    action : str
        What was done about it.
    """

    path: Path
    what: str
    action: str

    def __str__(self) -> str:
        return f"{self.path}: {self.what}; {self.action}"


@dataclass(frozen=True)
class VerifyReport:
    """What a check found.

    Parameters
    ----------
    shards, entries, failed : int
        Sound shards, entries in them, and those of the entries whose status is not ok.
    findings : tuple of Finding
        What was wrong; empty for a catalogue in order. Everything in it has been repaired or put aside.
    lost_entries : int
        Entries that the index knew and no sound shard holds; building again computes them.
    other_numbers : str
        That it holds other numbers than this program computes, in words, see
        :attr:`jointplay.catalogue.storage.manifest.Manifest.other_numbers`: nothing is wrong with it, but no build goes
        on there.
    """

    shards: int
    entries: int
    failed: int
    findings: tuple[Finding, ...]
    lost_entries: int
    other_numbers: str

    @property
    def is_sound(self) -> bool:
        """Whether nothing was wrong."""
        return not self.findings


def verify(directory: str | Path) -> VerifyReport:
    """Check every shard and every entry of a catalogue, and repair its index and its manifest from the shards.

    A shard that does not match its checksum, cannot be read, belongs elsewhere, or holds numbers that cannot be, is
    moved to ``quarantine``; nothing is deleted but the leftovers of interrupted writing.

    Parameters
    ----------
    directory : str or Path
        The catalogue's folder.

    Returns
    -------
    VerifyReport

    Raises
    ------
    CatalogueFileError
        There is no catalogue, or its files cannot be read or written.
    CatalogueMismatchError
        It has another layout.
    CatalogueBusyError
        A build is running there.
    """
    return _check_alone(directory, again=False)


def reindex(directory: str | Path) -> VerifyReport:
    """Throw the index and the feature matrix of a catalogue away and make them again from its shards.

    Everything is checked on the way, as by :func:`verify`, whose parameters, results and errors these are.
    """
    return _check_alone(directory, again=True)


def _check_alone(directory: str | Path, *, again: bool) -> VerifyReport:
    layout = CatalogueDirectory(Path(directory))
    if not layout.manifest.exists() and not layout.shards.is_dir():
        raise CatalogueFileError(layout.root, "is not a catalogue: it has no manifest.json and no shards")
    with layout.hold_alone():
        return _Check(layout, again=again).run()


class _Check:
    """One check under way."""

    def __init__(self, layout: CatalogueDirectory, *, again: bool) -> None:
        self._layout, self._again = layout, again
        self._findings: list[Finding] = []
        self._header: ShardHeader | None = None
        #: Shards of another layout, met before any sound one had said what the lost manifest should.
        self._strangers: list[tuple[Path, CatalogueMismatchError]] = []

    def run(self) -> VerifyReport:
        leftovers = self._layout.remove_temporaries()
        if leftovers:
            self._note(self._layout.root, f"{leftovers} unfinished files of an interrupted build", "deleted")
        manifest = self._manifest()
        sound: dict[str, Shard] = {}
        sizes: dict[str, int] = {}
        for name in self._layout.shard_names():
            path = self._layout.shard(name)
            try:
                content = path.read_bytes()
                manifest = self._check(name, path, content, manifest, sound, sizes)
            except OSError as error:
                raise CatalogueFileError(path, f"cannot be read ({error.strerror or error})") from error
        if manifest is None and self._strangers:
            raise self._strangers[0][1]  # a whole catalogue of another layout, that has lost its manifest
        for path, wrong in self._strangers:
            self._put_aside(path, wrong)
        if manifest is None:
            raise CatalogueFileError(self._layout.manifest, "is missing, and no shard tells what it should say")
        if self._again:
            self._forget()
        lost = self._repair_index(sound, sizes)
        self._repair_matrix(manifest, tuple(sorted(sound)))
        keys = {key: status for shard in sound.values() for key, status in zip(shard.key, shard.status, strict=True)}
        failed = sum(status != OK for status in keys.values())
        return VerifyReport(len(sound), len(keys), failed, tuple(self._findings), lost, manifest.other_numbers)

    def _forget(self) -> None:
        """Throw away what is made from the shards."""
        location = IndexLocation.of(self._layout)
        if location.is_file:
            for ending in ("", "-wal", "-shm"):
                Path(f"{self._layout.index}{ending}").unlink(missing_ok=True)
        else:
            with location.open(anew=True) as index:
                index.remove_shards(list(index.shards()))
        self._layout.remove_folder(self._layout.matrices)

    def _put_aside(self, path: Path, error: CatalogueFileError) -> None:
        aside = self._layout.move_to_quarantine(path)
        self._note(path, error.rule, f"moved to {aside.relative_to(self._layout.root)}")

    def _note(self, path: Path, what: str, action: str) -> None:
        self._findings.append(Finding(path, what, action))

    def _manifest(self) -> Manifest | None:
        """The manifest; None if it must be made again from a shard."""
        path = self._layout.manifest
        try:
            return Manifest.read(self._layout)
        except CatalogueMismatchError:
            raise
        except CatalogueFileError as error:
            if path.exists():
                aside = self._layout.move_to_quarantine(path)
                self._note(path, error.rule, f"moved to {aside.relative_to(self._layout.root)}")
            return None

    def _check(
        self,
        name: str,
        path: Path,
        content: bytes,
        manifest: Manifest | None,
        sound: dict[str, Shard],
        sizes: dict[str, int],
    ) -> Manifest | None:
        """Sort one shard into the sound ones or out of the way; the first sound one stands in for a lost manifest."""
        try:
            if sha256_of(content) != name:
                raise CatalogueFileError(path, "does not match its checksum")
            shard = decode_shard(content, path)
            check_shard(shard, path)
            if manifest is None:
                manifest = Manifest.of_shard(shard.header, datetime.now(UTC).isoformat(timespec="seconds"))
                manifest.write(self._layout)
                self._note(self._layout.manifest, "was missing or damaged", "made again from the shards")
            header = shard.header
            own = (manifest.machine_content, manifest.recipe, manifest.numbers_version)
            if (header.machine, header.recipe, header.numbers_version) != own:
                raise CatalogueFileError(path, "belongs to another machine, other settings or other numbers")
        except CatalogueFileError as error:
            if manifest is None and isinstance(error, CatalogueMismatchError):
                self._strangers.append((path, error))  # nothing is moved before it is known whose folder this is
                return None
            self._put_aside(path, error)
        else:
            # What follows asks for the table only; spectra, and a machine for every shard, would not fit into memory.
            self._header = self._header or header
            sound[name] = replace(shard, header=self._header, power=_NONE, spread_db=_NONE)
            sizes[name] = len(content)
        return manifest

    def _repair_index(self, sound: dict[str, Shard], sizes: dict[str, int]) -> int:
        """Make the index say what the sound shards hold; returns how many entries it knew that are nowhere now."""
        path, location = self._layout.index, IndexLocation.of(self._layout)
        is_new = location.is_file and not path.exists()
        index: Index | None = None
        try:
            index = location.open()
            if not is_new and not index.is_sound():
                raise CatalogueFileError(path, "is a damaged database")
        except CatalogueFileError as error:
            if not location.is_file:
                raise
            if index is not None:
                index.close()
            aside = self._layout.move_to_quarantine(path)
            self._note(path, error.rule, f"moved to {aside.relative_to(self._layout.root)}, made again from the shards")
            index, is_new = location.open(), True
        else:
            if is_new and sound and not self._again:
                self._note(path, "is missing", "made again from the shards")
        with index:
            known, before = index.shards(), index.places()
            gone = sorted(set(known) - set(sound))
            for name in gone:
                if not self._was_noted(name):
                    self._note(self._layout.shard(name), "is missing", "its entries were taken out of the index")
            new = sorted(set(sound) - set(known))
            wrong = [name for name in sound if name in known and not _agrees(name, sound[name], before)]
            if new and not (is_new or self._again):
                self._note(path, f"did not know {len(new)} shards", "entered them")
            if wrong:
                self._note(path, f"did not agree with {len(wrong)} shards", "entered them again")
            index.remove_shards([*gone, *wrong])
            for name in sorted([*new, *wrong]):
                self._enter(index, name, sizes, sound)
            return len(set(before) - set(index.places()))

    def _enter(self, index: Index, name: str, sizes: dict[str, int], sound: dict[str, Shard]) -> None:
        """Enter a shard, or put it aside if another one holds some of its entries."""
        try:
            index.add_shard(name, sizes[name], sound[name])
        except EntriesPresentError as error:
            path = self._layout.shard(name)
            del sound[name]
            aside = self._layout.move_to_quarantine(path)
            self._note(path, str(error), f"moved to {aside.relative_to(self._layout.root)}")

    def _repair_matrix(self, manifest: Manifest, names: tuple[str, ...]) -> None:
        """Make the matrix and the seal say what the sound shards hold."""
        path = self._layout.matrix(manifest.root_of(names))
        try:
            columns = MappedColumns.open(self._layout, manifest.root_of(names))
            if columns is not None:
                columns.check()
            elif manifest.seal is not None and manifest.seal.names == names and not self._again:
                self._note(path, "is missing", "made again from the shards")
        except CatalogueFileError as error:
            self._note(error.path, error.rule.split(":")[0], "made again from the shards")
        seal(self._layout, manifest, lambda: names)

    def _was_noted(self, name: str) -> bool:
        return any(finding.path == self._layout.shard(name) for finding in self._findings)


def _agrees(name: str, shard: Shard, places: dict[str, tuple[str, int]]) -> bool:
    """Whether the index has every entry of a shard there, or in another shard that holds it, too."""
    return all(key in places and (places[key][0] != name or places[key][1] == i) for i, key in enumerate(shard.key))
