"""The end of a build beside another builder's: neither takes away what the other has published."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from building import quick_build

from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.catalogue.storage.sealing import seal
from jointplay.catalogue.storage.store import Catalogue


@pytest.mark.parametrize("moment", ["before its manifest", "with its manifest", "with an old matrix and its manifest"])
def test_matrix_of_another_builder_is_kept(tmp_path: Path, moment: str) -> None:
    """The other one knows a shard more, and publishes just after the last look of this one."""
    quick_build(tmp_path)
    layout = CatalogueDirectory(tmp_path)
    whole = Manifest.read(layout)
    manifest = replace(whole, seal=None)
    more = layout.shard_names()
    fewer, old = more[:-1], more[:-2]
    theirs = Catalogue(layout, manifest, more)
    outdated = FeatureMatrix.publish(Catalogue(layout, manifest, old))
    if "old matrix" not in moment:
        layout.remove_matrices([layout.matrix(theirs.id)])
    looks = 0

    def known() -> tuple[str, ...]:
        nonlocal looks
        looks += 1
        if looks == 2:
            FeatureMatrix.publish(theirs)
            if "with" in moment:
                whole.write(layout)
        return fewer

    mine = seal(layout, manifest, known)
    assert looks == 2
    assert FeatureMatrix.open(theirs) is not None
    assert FeatureMatrix.open(mine) is not None
    assert not layout.matrix(outdated.id).exists()


def test_matrices_that_another_builder_deletes_meanwhile_are_no_error(tmp_path: Path) -> None:
    quick_build(tmp_path)
    layout = CatalogueDirectory(tmp_path)
    (found,) = layout.other_matrices("0" * 64)
    layout.remove_matrices([layout.matrices / "gone", found], keep="0" * 64)
    assert layout.other_matrices("0" * 64) == ()
