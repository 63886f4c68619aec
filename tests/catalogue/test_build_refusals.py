"""What a build refuses, and that it touches nothing then."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from building import quick_build
from fake_simulator import MACHINE, PLAN, compute

from jointplay.catalogue.building.build import build
from jointplay.catalogue.errors import (
    CatalogueFileError,
    CatalogueMismatchError,
    PlanError,
)
from jointplay.catalogue.plans.entry import content_digest
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.hdf5 import LAYOUT_VERSION
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.verify import verify
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.machine import parse_machine, shipped_machine, shipped_machine_text


def test_other_machines_are_refused(tmp_path: Path) -> None:
    quick_build(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(CatalogueMismatchError, match=r"is a catalogue of another machine: slider-crank, not four-bar$"):
        build(shipped_machine("four-bar"), PLAN, tmp_path, workers=0, compute=compute)
    tree = MACHINE.model_dump()
    tree["gravity"] = 9.8
    with pytest.raises(CatalogueMismatchError, match=r"slider-crank with gravity 9\.81, not 9\.8$"):
        build(parse_machine(tree), PLAN, tmp_path, workers=0, compute=compute)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"sample_rate": 14000}, r"was built with sample_rate 10000\.0, not 14000\.0: build into another folder"),
        ({"accuracy": "standard"}, "was built with accuracy draft, not standard"),
        ({"uncertain": {"contact.friction": {"uniform": [0, 0.3]}}}, r"with another uncertain\.contact\.damping"),
    ],
)
def test_other_settings_are_refused(tmp_path: Path, change: dict[str, Any], rule: str) -> None:
    quick_build(tmp_path)
    with pytest.raises(CatalogueMismatchError, match=rule) as caught:
        quick_build(tmp_path, parse_plan({**PLAN.content, **change}))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path))


def test_other_versions_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick_build(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.setattr("jointplay.solver.NUMBERS_VERSION", 99)
    rule = r"holds numbers of version \d+, this program computes version 99: build into another folder$"
    with pytest.raises(CatalogueMismatchError, match=rule) as caught:
        quick_build(tmp_path)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    monkeypatch.undo()
    manifest = tmp_path / "manifest.json"
    good = manifest.read_text()
    ours = f'"layout_version": {LAYOUT_VERSION},'
    assert good.count(ours) == 1
    others = {
        f'"layout_version": {other},': f"layout {other}" for other in (0, LAYOUT_VERSION - 1, LAYOUT_VERSION + 1, 99)
    }
    # Before layouts had versions there were schemas, the first of which had the number of the first layout.
    others |= {f'"schema_version": {other},': "a layout without a version" for other in (1, 2, 3, 4, 5)}
    for member, shown in others.items():
        manifest.write_text(good.replace(ours, member))
        files = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        for use in (lambda: quick_build(tmp_path), lambda: Catalogue.open(tmp_path), lambda: verify(tmp_path)):
            rule = (
                f"has {shown}; this program reads layout {LAYOUT_VERSION}: build the catalogue anew in another folder$"
            )
            with pytest.raises(CatalogueMismatchError, match=rule) as refused:
                use()
            assert "\n" not in str(refused.value)
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == files


def test_catalogues_of_other_draws_are_refused(tmp_path: Path) -> None:
    """Before draws had a version, those of each hypothesis were other machines."""
    quick_build(tmp_path)
    catalogue = Catalogue.open(tmp_path)
    content = json.loads(catalogue.layout.manifest.read_text())
    del content["draws_version"], content["checksum"]
    catalogue.layout.manifest.write_text(json.dumps({**content, "checksum": content_digest(content)}))
    assert Catalogue.open(tmp_path).manifest.draws_version == 1
    with pytest.raises(CatalogueMismatchError, match=r"with other machines in order than worn.*: build into another"):
        quick_build(tmp_path)


def test_another_version_of_the_product_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as it computes the same numbers."""
    quick_build(tmp_path)
    monkeypatch.setattr("jointplay.catalogue.storage.manifest.__version__", "9.9.9")
    larger = parse_plan({**PLAN.content, "draws": {"healthy": 8, "single": 12}})
    assert quick_build(tmp_path, larger).added == 2
    assert Catalogue.open(tmp_path).manifest.versions["jointplay"] != "9.9.9"  # that of the first build
    assert verify(tmp_path).is_sound


def test_folders_that_are_no_catalogue_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.docx").write_text("five years")
    with pytest.raises(CatalogueFileError, match="holds files but no catalogue"):
        quick_build(tmp_path)
    with pytest.raises(CatalogueFileError, match="cannot be created"):
        quick_build(tmp_path / "thesis.docx")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.docx"]


def test_plan_that_does_not_fit_touches_nothing(tmp_path: Path) -> None:
    plan = parse_plan({"uncertain": {"joints.Z.pin_radius": {"lognormal": 0.1}}})
    with pytest.raises(PlanError):
        quick_build(tmp_path / "new", plan)
    assert not (tmp_path / "new").exists()


def test_machine_that_cannot_be_assembled_touches_nothing(tmp_path: Path) -> None:
    text = shipped_machine_text("slider-crank")
    moved = text.replace("links: [rod, slider], at: [0.2, 0.05]", "links: [rod, slider], at: [0.07, 0.05]")
    assert moved != text
    with pytest.raises(AssemblyError, match="cannot be assembled at a drive angle of"):
        build(parse_machine(moved), PLAN, tmp_path / "c", workers=0, compute=compute)
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("url", "rule"),
    [
        ("nonsense", "is no URL of a database"),
        ("mysql://x/y", r"mysql: must be postgresql:// or sqlite:///FILE"),
        ("{sqlite}", "no/such/folder"),
    ],
)
def test_refused_index_leaves_no_folder(tmp_path: Path, url: str, rule: str) -> None:
    folder = tmp_path / "c"
    with pytest.raises(CatalogueFileError, match=rule):
        quick_build(folder, index=url.format(sqlite=f"sqlite:///{tmp_path}/no/such/folder/x.db"))
    assert not folder.exists()
