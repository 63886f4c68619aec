"""Where the index of a catalogue is: a file beside the shards, or a database that several computers reach.

A builder that is alone sets it right first, if it cannot be used or does not agree with the shards.
"""

from __future__ import annotations

import json
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.storage.database import database_url
from jointplay.catalogue.storage.directory import CatalogueDirectory, publish, sha256_of
from jointplay.catalogue.storage.hdf5 import decode_shard
from jointplay.catalogue.storage.index import LOCAL, EntriesPresentError, Index

_NAME = "index.json"


@dataclass(frozen=True)
class IndexLocation:
    """The index of one catalogue.

    Parameters
    ----------
    source : Path or str
        Its file, or the URL of its database, without password.
    instance : str
        Which catalogue of that database.
    password : str, optional
        Of the database; never stored.
    """

    source: Path | str
    instance: str = LOCAL
    password: str | None = field(default=None, repr=False)

    @classmethod
    def of(cls, directory: CatalogueDirectory) -> Self:
        """Where the index is according to the catalogue's folder.

        Raises
        ------
        CatalogueFileError
            The note that says so cannot be read.
        """
        path = directory.root / _NAME
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            return cls(str(content["url"]), str(content["instance"]))
        except FileNotFoundError:
            return cls(directory.index)
        except (OSError, ValueError, KeyError, TypeError):
            rule = "does not say where the index is: delete it, and name the database by --index"
            raise CatalogueFileError(path, rule) from None

    @classmethod
    def choose(cls, directory: CatalogueDirectory, url: str | None, *, alone: bool) -> Self:
        """Where the index is to be; a URL given is remembered in the folder.

        Parameters
        ----------
        directory : CatalogueDirectory
        url : str or None
            Of a database; None for the one remembered, or a file.
        alone : bool
            Whether nobody else uses the catalogue; else its index stays where it is.

        Raises
        ------
        CatalogueFileError
            The URL is none, or another builder uses the index where it is.
        """
        old = cls.of(directory)
        if url is None:
            return old
        wanted = database_url(url)
        plain = wanted._replace(password=None).render_as_string(hide_password=False)
        password = str(wanted.password) if wanted.password is not None else None
        if old.source == plain:
            return cls(plain, old.instance, password)
        if not alone:
            raise CatalogueFileError(directory.root, f"is being built with the index {old.source}: name no other")
        new = cls(plain, str(uuid.uuid4()), password)
        content = {"url": plain, "instance": new.instance}
        new.open().close()  # refuses before it is remembered
        publish(directory.root / _NAME, (json.dumps(content, indent=1) + "\n").encode())
        return new

    @property
    def is_file(self) -> bool:
        """Whether it is the file in the catalogue's folder."""
        return isinstance(self.source, Path)

    def open(self, *, anew: bool = False) -> Index:
        """Open it; tables of another layout are refused, or made `anew`.

        Raises
        ------
        CatalogueFileError
            As :class:`~jointplay.catalogue.storage.index.Index`.
        """
        if self.password is None or isinstance(self.source, Path):
            return Index(self.source, self.instance, anew=anew)
        url = database_url(self.source).set(password=self.password)
        return Index(url.render_as_string(hide_password=False), self.instance, anew=anew)


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
