"""Worn joints that a load never lets open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.evaluation.differences import with_differences
from jointplay.catalogue.evaluation.protocols import PROTOCOLS, EvaluationProtocol, draw_truth
from jointplay.catalogue.evaluation.recordings import Recordings, hidden
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.solver.machines.machine import shipped_machine

MACHINE = shipped_machine("quick-return")
LOADED = replace(PROTOCOLS["model-error-e"], revolutions=5.0)


def truth_of(force: float, clearance: float) -> Truth:
    """Joint F worn, and a constant force along the way of the ram."""
    drawn = with_differences(draw_truth(MACHINE, Hypothesis.of(["F"]), LOADED, 1, 0), LOADED.differences, 1, 0)
    loads = {path: force if value else 0.0 for path, value in drawn.parameters.items() if path.startswith("loads.")}
    return replace(drawn, clearances={"F": clearance}, parameters={**drawn.parameters, **loads})


def test_a_joint_pressed_together_cannot_be_seen_and_one_that_opens_can() -> None:
    truths = [truth_of(force, clearance) for force, clearance in ((100.0, 5e-5), (25.0, 5e-5), (25.0, 5e-4))]
    recordings = Recordings()
    signals = {number: signal for number, signal in recordings.ideal(LOADED, truths) if signal is not None}
    assert len(signals) == 3
    # Measured: 0.0001, 0.2 and 0.8 m/s2 of change under a noise of 0.15.
    assert hidden(LOADED, truths, signals, recordings) == {0}
    assert hidden(PROTOCOLS["model-error-a"], truths, signals, recordings) == frozenset()


def test_machines_in_order_and_failed_ones_are_not_looked_at() -> None:
    class Failing(Recordings):
        asked: int = 0

        def ideal(
            self, _: EvaluationProtocol, truths: Sequence[Truth]
        ) -> Iterator[tuple[int, NDArray[np.float64] | None]]:
            for number, truth in enumerate(truths):
                assert truth.clearances == {}
                assert not any("contact" in path for path in truth.parameters)
                yield number, None

    worn = truth_of(50.0, 1e-4)
    healthy = replace(worn, hypothesis=Hypothesis.of(()), clearances={})
    silent = np.zeros((100, 4))
    assert hidden(LOADED, [worn, healthy], {0: silent, 1: silent}, Failing()) == frozenset()
