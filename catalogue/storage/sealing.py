"""The end of a build: the feature matrix is published, and the manifest says of which shards the catalogue consists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.manifest import Manifest, Seal, SealedShard
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.catalogue.storage.shard import OK
from jointplay.catalogue.storage.store import Catalogue


def seal(layout: CatalogueDirectory, manifest: Manifest, known: Callable[[], tuple[str, ...]]) -> Catalogue:
    """Publish the feature matrix of all shards that belong to a catalogue, and enter them into its manifest.

    The end of every build and every check. Several builders may do it at the same time: the last one sees all shards.

    Parameters
    ----------
    layout : CatalogueDirectory
    manifest : Manifest
        Its own seal does not count.
    known : callable
        Returns the names of the shards, sorted; called again at the end.

    Returns
    -------
    Catalogue
        In the new state.

    Raises
    ------
    CatalogueFileError
        A shard is damaged, or something cannot be written.
    """
    while True:
        names = known()
        catalogue = Catalogue(layout, replace(manifest, seal=None), names)
        matrix = FeatureMatrix.publish(catalogue)
        sealed = replace(manifest, seal=_seal(catalogue, matrix, names))
        if sealed != manifest or not layout.manifest.exists():
            sealed.write(layout)
        # Listed before the last look at the shards: if that finds no new ones, these matrices are of earlier states.
        # What another builder publishes from now on is not among them, even if no manifest names it yet.
        earlier = layout.other_matrices(matrix.id)
        if known() == names:
            named = Manifest.read(layout).seal
            layout.remove_matrices(earlier, keep=None if named is None else named.root)
            return Catalogue(layout, sealed, names)


def _seal(catalogue: Catalogue, matrix: FeatureMatrix, names: Sequence[str]) -> Seal:
    guard = matrix.guard
    counts = np.bincount(matrix.places(matrix.every_row)[:, 0], minlength=len(names)).tolist()
    sizes = (catalogue.layout.shard(name).stat().st_size for name in names)
    return Seal(
        root=matrix.id,
        content=matrix.content,
        shards=tuple(SealedShard(*shard) for shard in zip(names, sizes, counts, strict=True)),
        hypotheses={hypothesis.label: len(matrix.rows(hypothesis.label)) for hypothesis in matrix.hypotheses},
        failed={status: count for status, count in matrix.statuses().items() if status != OK},
        guard=None if guard is None else {"entries": guard.count, "mean_db": guard.mean_db, "p90_db": guard.p90_db},
    )
