"""What a builder that is alone sets right first: an index that cannot be used, or does not agree with the shards."""

from __future__ import annotations

from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of
from jointplay.catalogue.storage.hdf5 import decode_shard
from jointplay.catalogue.storage.index import EntriesPresentError, Index
from jointplay.catalogue.storage.location import IndexLocation


def open_index(layout: CatalogueDirectory, location: IndexLocation) -> Index:
    """The index, for a process that is alone: made anew where it is a file that cannot be used."""
    try:
        return location.open()
    except CatalogueFileError:
        if not (location.is_file and layout.index.exists()):
            raise
        layout.move_to_quarantine(layout.index)  # whatever it was, the shards hold all that it should have known
        return location.open()


def match_files(layout: CatalogueDirectory, index: Index) -> int:
    """Make the index agree with the shards on the disk; returns the number of entries it did not know."""
    known, there = index.shards(), layout.shard_names()
    index.remove_shards(set(known) - set(there))
    return sum(adopt(layout, index, name) for name in there if name not in known)


def adopt(layout: CatalogueDirectory, index: Index, name: str) -> int:
    """Enter a shard that the index does not know; returns the number of its entries that are new.

    Raises
    ------
    CatalogueFileError
        The shard is damaged.
    """
    path = layout.shard(name)
    content = path.read_bytes()
    if sha256_of(content) != name:
        raise CatalogueFileError(path, "does not match its checksum: verify the catalogue first")
    try:
        return index.add_shard(name, len(content), decode_shard(content, path))
    except EntriesPresentError:
        # Left by a builder that was killed before it knew that another one had stored these cases.
        layout.move_to_quarantine(path)
        return 0
