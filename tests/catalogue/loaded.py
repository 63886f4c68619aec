"""A machine with a load that its file has not, recorded, and what a catalogue says of the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of, watched_levels
from jointplay.catalogue.diagnosing.stroke_loads import StrokeLoads
from jointplay.catalogue.evaluation.protocols import PROTOCOLS, draw_truth
from jointplay.catalogue.evaluation.recordings import Recordings, recorded
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import Observed, library_of
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue

SHORT = replace(PROTOCOLS["matched"], revolutions=12.0)
LOADS = (90.0, 10.0)


def prepared_of(
    catalogue: Catalogue, joint: str, loads: tuple[float, float] | None = None, own: Mapping[str, float] | None = None
) -> PreparedMeasurement:
    truth = draw_truth(catalogue.machine, Hypothesis.of([joint]), SHORT, 5, 1)
    if loads:
        found = StrokeLoads.of(catalogue.machine, catalogue.recipe.nominal_drive_speed)
        assert found is not None
        sizes = {f"loads.{place}.over_angle": size for place, size in enumerate(loads)}
        truth = replace(truth, machine=found.machine(truth.machine), parameters={**truth.parameters, **sizes})
    truth = replace(truth, parameters={**truth.parameters, **(own or {})})
    ((_, ideal),) = Recordings().ideal(SHORT, [truth])
    assert ideal is not None
    return prepare(recorded(SHORT, truth, ideal), catalogue.machine, scheme=catalogue.scheme)


def asked(catalogue: Catalogue, prepared: PreparedMeasurement) -> tuple[Observed, MatchResult]:
    sensing = exact_sensing(prepared)
    observed = Observed(sensing, features_of(prepared, sensing), watched_levels(prepared), prepared.drive_speed)
    result = library_of(catalogue).answer(
        sensing, observed.feature, observed.watched, speed=prepared.drive_speed, mode="auto"
    )
    return observed, result
