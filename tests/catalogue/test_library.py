"""Models kept for the next recording, and answers looked up or refitted."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spectra_model import WATCHED, SpectraModel, sensing

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation.cross_checks import MethodLibrary
from jointplay.catalogue.evaluation.nearest_entry import NearestEntry
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.gaussian import FittedGaussian
from jointplay.catalogue.matching.learning import Learning, rows_of, training_set
from jointplay.catalogue.matching.matcher import MatchResult, TrainingSet
from jointplay.catalogue.matching.model_library import ModelLibrary, Observed
from jointplay.catalogue.matching.modelfile import FORMAT, read_model, write_model
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.storage.store import Catalogue

MODEL = SpectraModel(220, wide=60)
LIBRARY = ModelLibrary(MODEL)


def recording(label: str, seed: int = 1, level_db: float = 0.0) -> tuple[np.ndarray, float]:
    """Levels of a machine that is not in the catalogue, and its clearance."""
    other = SpectraModel(6, seed=100 + seed)
    row = other.rows(label)[seed % 6]
    packed = other.packed(np.array([row])) * 10.0 ** (0.1 * level_db)
    features, _ = observe(packed, sensing(), Discrepancy(0.0, 0.0, 3.0, 0.0), np.array([1]), seed)
    return features[0], float(other.clearances[row].max())


def same(first: MatchResult, second: MatchResult) -> bool:
    return [(h.label, h.probability, h.p_value, h.clearances) for h in first.hypotheses] == [
        (h.label, h.probability, h.p_value, h.clearances) for h in second.hypotheses
    ]


@pytest.mark.parametrize("effort", ["fast", "standard"])
def test_finds_joint_and_clearance_at_every_effort(effort: str) -> None:
    errors = []
    for seed in range(6):
        for label in MODEL.joints:
            feature, clearance = recording(label, seed)
            answer = LIBRARY.answer(sensing(), feature, WATCHED, effort, "trusted")  # type: ignore[arg-type]
            assert answer.best.label == label
            assert answer.mode == "trusted"
            assert answer.set(0.95).labels == (label,)
            errors.append(abs(np.log(answer.best.clearances[0].median / clearance)))
    # Measured: 0.11 and 0.08; half the range of ln(clearance) would be 0.9.
    assert np.median(errors) < 0.2


def test_answers_do_not_depend_on_what_was_asked_or_kept_before(tmp_path: Path) -> None:
    feature, _ = recording("B")
    fresh = [ModelLibrary(MODEL, folder) for folder in (None, tmp_path, tmp_path)]
    LIBRARY.answer(sensing(3e-5), recording("A")[0], WATCHED)
    for effort in ("fast", "standard"):
        answers = [library.answer(sensing(), feature, WATCHED, effort) for library in (LIBRARY, *fresh)]  # type: ignore[arg-type]
        assert all(same(answers[0], other) for other in answers[1:])
    assert len(list(tmp_path.glob("*.npz"))) == 1


def test_one_model_serves_about_the_same_noise(tmp_path: Path) -> None:
    library = ModelLibrary(MODEL, tmp_path)
    feature, _ = recording("C")
    for noise in (0.9e-5, 0.95e-5, 1.0e-5):
        assert library.answer(sensing(noise), feature, WATCHED, "fast", "trusted").best.label == "C"
    assert len(list(tmp_path.glob("*.npz"))) == 1
    library.answer(sensing(4e-5), feature, WATCHED, "fast", "trusted")
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_models_of_this_state_are_loaded_from_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    feature, _ = recording("B")
    first, other = ModelLibrary(MODEL, tmp_path), ModelLibrary(SpectraModel(50, seed=3), tmp_path)
    expected = first.answer(sensing(), feature, WATCHED, "fast", "trusted")
    again = ModelLibrary(MODEL, tmp_path)
    assert again.load(0) == 0
    assert again.load() == again.load() == 1
    assert other.load() == ModelLibrary(MODEL).load() == 0
    for file in tmp_path.glob("*.npz"):
        file.unlink()
    monkeypatch.setattr(
        "jointplay.catalogue.matching.model_library.training_set", None
    )  # nothing can be fitted any more
    assert same(again.answer(sensing(), feature, WATCHED, "fast", "trusted"), expected)


FORMAT_SAID = f'"format": {FORMAT}'.encode()


def test_a_damaged_file_or_a_folder_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path) -> None:
    feature, _ = recording("A")
    expected = ModelLibrary(MODEL, tmp_path).answer(sensing(), feature, WATCHED, "fast", "trusted")
    (file,) = tmp_path.glob("*.npz")
    whole = file.read_bytes()
    assert FORMAT_SAID in whole
    for damaged in (whole[: len(whole) // 2], b"", b"PK", whole.replace(FORMAT_SAID, b'"format": 0')):
        file.write_bytes(damaged)
        assert same(ModelLibrary(MODEL, tmp_path).answer(sensing(), feature, WATCHED, "fast", "trusted"), expected)
        assert file.read_bytes() != damaged
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    assert same(ModelLibrary(MODEL, blocked).answer(sensing(), feature, WATCHED, "fast", "trusted"), expected)


def test_files_give_back_the_same_model(tmp_path: Path) -> None:
    fitted = LIBRARY.fit(Observed(sensing(), np.empty(0), WATCHED), Learning.of("trusted"))
    assert isinstance(fitted, FittedGaussian)
    assert write_model(tmp_path, "k", fitted)
    again = read_model(tmp_path, "k")
    assert again is not None
    features = np.stack([recording(label)[0] for label in MODEL.joints])
    assert np.array_equal(again.posterior(features), fitted.posterior(features))
    assert same(again.match(features[0]), fitted.match(features[0]))
    assert read_model(tmp_path, "other") is None


def test_robust_mode_takes_over_where_the_model_is_not_to_be_trusted() -> None:
    feature, _ = recording("B", level_db=0.0)
    assert LIBRARY.answer(sensing(), feature, WATCHED).mode == "trusted"
    bent = feature + 6.0 * np.sin(np.arange(len(feature)) / 3.0) * (np.arange(len(feature)) < len(WATCHED))  # levels
    answer = LIBRARY.answer(sensing(), bent, WATCHED)
    trusted = LIBRARY.answer(sensing(), bent, WATCHED, mode="trusted")
    assert answer.mode == "robust"
    assert answer.trusted_p_value == trusted.p_value
    assert trusted.p_value < 0.05
    assert answer.p_value > trusted.p_value
    assert answer.notes == trusted.notes == ()
    narrow = ModelLibrary(SpectraModel(220)).answer(sensing(), bent, WATCHED)
    assert narrow.mode == "robust"
    assert narrow.notes[0].startswith("the catalogue holds no draws of uncertain machines")


def test_strata_of_the_modes() -> None:
    trusted = rows_of(MODEL, "A", Learning.of("trusted"))
    robust = rows_of(MODEL, "A", Learning.of("robust"))
    assert set(MODEL.stratum[trusted]) == {"trusted"}
    assert np.mean(MODEL.stratum[robust] == "wide") == pytest.approx(2 / 3, abs=0.01)
    few = rows_of(MODEL, "A", replace(Learning(), most=50))
    assert np.array_equal(few, trusted[:50])


def test_with_a_limit_a_refit_learns_from_the_first_draws_only_too(monkeypatch: pytest.MonkeyPatch) -> None:
    feature, _ = recording("A")
    learned: list[dict[str, np.ndarray]] = []

    def spied(*arguments: Any, rows: Mapping[str, np.ndarray], **settings: Any) -> TrainingSet:
        learned.append(dict(rows))
        return training_set(*arguments, rows=rows, **settings)

    monkeypatch.setattr("jointplay.catalogue.matching.refit.training_set", spied)
    for most in (20, None):
        LIBRARY.answer(sensing(), feature, WATCHED, mode="trusted", most=most)
    limited, free = learned
    assert np.array_equal(limited["A"], MODEL.rows("A", "trusted")[:20])
    assert np.array_equal(free["A"], MODEL.rows("A", "trusted"))
    LIBRARY.answer(sensing(), feature, WATCHED, mode="robust", most=30)
    # A third trusted draws, two thirds of uncertain machines.
    assert len(learned[-1]["A"]) == 30


def test_a_refit_of_machines_in_order_keeps_the_shares_of_the_strata(monkeypatch: pytest.MonkeyPatch) -> None:
    model = SpectraModel(900, wide=1800)
    learned: list[np.ndarray] = []

    def spied(*arguments: Any, rows: Mapping[str, np.ndarray], **settings: Any) -> TrainingSet:
        learned.append(rows["healthy"])
        return training_set(*arguments, rows=rows, **settings)

    monkeypatch.setattr("jointplay.catalogue.matching.refit.training_set", spied)
    feature, _ = recording("healthy")
    ModelLibrary(model).answer(sensing(), feature, WATCHED, mode="robust")
    assert len(learned[0]) == 800
    assert np.mean(model.stratum[learned[0]] == "wide") == pytest.approx(2 / 3, abs=0.01)


def test_hypotheses_can_be_left_out_and_weighed() -> None:
    feature, _ = recording("A")
    answer = LIBRARY.answer(sensing(), feature, WATCHED, mode="trusted", without=("A",))
    assert {h.label for h in answer.hypotheses} == {"healthy", "B", "C"}
    assert answer.p_value < LIBRARY.answer(sensing(), feature, WATCHED, mode="trusted").p_value
    weights = np.where(np.arange(len(MODEL.label)) % 2, 1.0, 1e-3)
    weighed = LIBRARY.answer(sensing(), feature, WATCHED, "fast", "trusted", weights=weights)
    assert weighed.best.label == "A"
    assert weighed.best.predicted.tolist() != answer.best.predicted.tolist()


def test_other_methods_answer_in_the_same_way() -> None:
    feature, _ = recording("C")
    answer = MethodLibrary(MODEL, NearestEntry()).answer(sensing(), feature, WATCHED, mode="trusted")
    assert answer.best.label == "C"
    assert answer.mode == "trusted"


def test_what_is_drawn_for_a_hypothesis_does_not_depend_on_the_others() -> None:
    whole = training_set(MODEL, sensing(), WATCHED, Learning())
    part = training_set(MODEL, sensing(), WATCHED, Learning(without=("A",)))
    known = {draws.label: draws.features for draws in whole.hypotheses}
    assert all(np.array_equal(known[draws.label], draws.features) for draws in part.hypotheses)


def test_a_catalogue_is_matched_by_its_own_matrix(small_catalogue: Catalogue, tmp_path: Path) -> None:
    matrix = small_catalogue.matrix
    groups = len(matrix.cuts) - 1
    own = Sensing(np.eye(3), np.eye(3), matrix.cuts, np.full((groups, 3), 1e-3), np.full(groups, 20.0))
    row = matrix.rows("A")[-1]
    features, _ = observe(matrix.packed(np.array([row])), own, Discrepancy(0.0, 0.0, 3.0, 0.0), np.array([1]))
    library = ModelLibrary(matrix, tmp_path)
    answer = library.answer(own, features[0], np.arange(3 * groups) < 30, "fast", "trusted")
    assert answer.best.label == "A"
    truth = float(matrix.clearance(np.array([row]))[0, matrix.joints.index("A")])
    assert answer.best.clearances[0].median == pytest.approx(truth, rel=0.5)


def test_few_models_are_kept_as_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointplay.catalogue.matching.modelfile.KEPT", 2)
    fitted = LIBRARY.fit(Observed(sensing(), np.empty(0), WATCHED), Learning.of("trusted"))
    assert isinstance(fitted, FittedGaussian)
    for k, name in enumerate(("a", "b", "c")):
        assert write_model(tmp_path, name, fitted)
        os.utime(tmp_path / f"{name}.npz", (k, k))
    assert write_model(tmp_path, "d", fitted)
    assert sorted(file.stem for file in tmp_path.glob("*.npz")) == ["c", "d"]


def test_refuses_empty_catalogues() -> None:
    with pytest.raises(DiagnosisError, match="2 entries of hypothesis healthy: at least 3 needed"):
        training_set(SpectraModel(2), sensing(), WATCHED, Learning())
