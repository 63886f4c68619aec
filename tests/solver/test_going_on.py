"""Runs that start where, and when, another one ended; the queue of lanes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.integrators.lanes import SLOTS
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.simulate import simulate, simulate_batch

MACHINE = shipped_machine("slider-crank")


def go_on(history: History, settings: Settings) -> History:
    return simulate_batch(MACHINE, [history.case], settings, starts=[history.end])[0]


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_a_run_goes_on_where_it_ended(method: str) -> None:
    """Against one run through both parts; a healthy machine, so that only errors of steps differ."""
    first = simulate(MACHINE, Case(), Settings(duration=0.1, accuracy="reference", method=method, sample_rate=4000))
    assert first.end is not None and first.t[-1] < first.end.t < first.t[-1] + 0.01
    second = go_on(first, Settings(duration=0.05, accuracy="reference", method=method, sample_rate=4000))
    whole = simulate(MACHINE, Case(), Settings(duration=0.16, accuracy="reference", method=method, sample_rate=4000))
    assert second.t[0] == first.end.t
    start = round(first.end.t * 4000)
    assert second.t == pytest.approx(whole.t[start : start + len(second.t)], abs=1e-12)
    # The error of either run, measured against each other's halves: 1e-11 m.
    assert np.abs(second.displacement - whole.displacement[start : start + len(second.t)]).max() < 1e-10


def test_without_motion_only_the_signal_for_spectra_is_there() -> None:
    case = Case(Fault({"B": 2e-4}))
    whole = simulate(MACHINE, case, Settings(duration=0.1))
    cheap = simulate(MACHINE, case, Settings(duration=0.1, motion=False))
    assert (whole.band_limited_acceleration == cheap.band_limited_acceleration).all()
    assert cheap.displacement.shape == cheap.velocity.shape == cheap.acceleration.shape == (0, 3)


@pytest.mark.parametrize(
    "settings", [Settings(revolutions=0.5), Settings(revolutions=0.5, motion=False, sample_rate=7777.7)]
)
def test_without_the_transient_the_rest_is_the_same(settings: Settings) -> None:
    case = Case(Fault({"B": 2e-4}))
    whole = simulate(MACHINE, case, settings)
    late = simulate(MACHINE, case, replace(settings, transient=False))
    first = int(np.searchsorted(whole.t, whole.transient))
    assert first > 0 and len(late.t) == len(whole.t) - first > 0
    for name in ("t", "displacement", "velocity", "acceleration", "band_limited_acceleration"):
        assert (getattr(late, name) == getattr(whole, name)[first:]).all(), name


def test_a_run_that_ends_within_its_transient_has_nothing_else() -> None:
    ended = simulate(MACHINE, Case(), Settings(duration=0.01, transient=False))
    assert ended.status is Status.OK and ended.transient > 0.01
    assert len(ended.t) == len(ended.displacement) == len(ended.band_limited_acceleration) == 0


def test_links_without_the_transient() -> None:
    settings = Settings(revolutions=0.2, links=True, sample_rate=4000)
    whole, late = (simulate(MACHINE, Case(), replace(settings, transient=wanted)) for wanted in (True, False))
    assert whole.links is not None and late.links is not None
    assert len(late.links.displacement) == len(late.t) < len(whole.t)
    assert (late.links.displacement == whole.links.displacement[-len(late.t) :]).all()


def test_more_cases_than_places_for_their_records() -> None:
    """Every case as if it were alone, whichever waited for which; durations differ."""
    clearances = np.geomspace(5e-5, 5e-4, 2 * SLOTS + 3)
    cases = [Case(Fault({"B": float(c)})) for c in clearances]
    settings = Settings(duration=0.03)
    together = simulate_batch(MACHINE, cases, settings)
    assert {history.status for history in together} == {Status.OK}
    for index in (0, SLOTS, 2 * SLOTS + 2):
        alone = simulate(MACHINE, cases[index], settings)
        assert (alone.displacement == together[index].displacement).all()
        assert (alone.band_limited_acceleration == together[index].band_limited_acceleration).all()
