"""The seal of a catalogue: which shards it consists of, and one hash over all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from jointplay.catalogue.plans.keys import content_digest


@dataclass(frozen=True)
class SealedShard:
    """One shard: its SHA-256, which is its name, its size in bytes and its number of entries."""

    sha256: str
    size: int
    entries: int


@dataclass(frozen=True)
class Seal:
    """What a catalogue consisted of when a build or a check ended.

    Parameters
    ----------
    root : str
        Root hash, see :func:`root_hash`: the catalogue's id.
    content : str
        SHA-256 over all entries with their spectra, however they are divided into shards: two catalogues with the same
        content answer every question alike.
    shards : tuple of SealedShard
        In the order of their names.
    hypotheses : mapping of str to int
        Entries with a spectrum, by hypothesis, in the catalogue's order.
    failed : mapping of str to int
        Entries without, by status.
    guard : mapping of str to float, or None
        Number of entries that were computed once more and more finely, and mean and 90th percentile of their mean
        differences of band levels [dB]; None if there are none.
    """

    root: str
    content: str
    shards: tuple[SealedShard, ...]
    hypotheses: Mapping[str, int]
    failed: Mapping[str, int]
    guard: Mapping[str, float] | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shards, sorted."""
        return tuple(shard.sha256 for shard in self.shards)

    @property
    def plain(self) -> dict[str, Any]:
        """As plain data; :meth:`from_plain` reads it back."""
        return {
            "root": self.root,
            "content": self.content,
            "hypotheses": dict(self.hypotheses),
            "failed": dict(self.failed),
            "guard": None if self.guard is None else dict(self.guard),
            "shards": [f"{shard.sha256} {shard.size} {shard.entries}" for shard in self.shards],
        }

    @classmethod
    def from_plain(cls, content: Mapping[str, Any]) -> Self:
        """Read what :attr:`plain` wrote.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is something else.
        """
        lines = (str(line).split(" ") for line in content["shards"])
        shards = tuple(SealedShard(name, int(size), int(count)) for name, size, count in lines)
        return cls(**{**content, "shards": shards})


def root_hash(layout_version: int, machine_key: str, recipe: Mapping[str, Any], shards: tuple[str, ...]) -> str:
    """SHA-256 over everything a catalogue holds: machine, recipe, and the checksums of all shards.

    Parameters
    ----------
    layout_version : int
    machine_key : str
        Content key of the machine.
    recipe : mapping
        How the entries were computed, as plain data.
    shards : tuple of str
        SHA-256 of each, sorted.
    """
    return content_digest(
        {"layout_version": layout_version, "machine": machine_key, "recipe": recipe, "shards": list(shards)}
    )
