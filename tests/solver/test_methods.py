"""Methods for cross-checks: the whole system of equations, and Gill's steps halved by their error."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.solver.cases.case import METHODS, Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation import methods
from jointplay.solver.simulation.ensemble import Ensemble, simulate_ensemble
from jointplay.solver.simulation.methods import RUNS
from jointplay.solver.simulation.simulate import simulate, simulate_batch

MACHINE, WORN = shipped_machine("quick-return"), {"F": 2e-4}
SHORT = {"duration": 0.05, "sample_rate": 5000.0}


def run(fault: dict[str, float], **more: object) -> History:
    found = simulate(MACHINE, fault, Settings(**{**SHORT, **more}))  # type: ignore[arg-type]
    assert found.status is Status.OK, found.message
    return found


def difference(one: History, other: History) -> float:
    """Largest of the frame's velocities, in parts of the largest velocity of each motion."""
    return float((np.abs(one.velocity - other.velocity).max(axis=0) / np.abs(other.velocity).max(axis=0)).max())


def test_every_method_has_runs() -> None:
    assert tuple(RUNS) == METHODS


@pytest.mark.parametrize(("fault", "rounding"), [({}, 1e-11), (WORN, 1e-5), ({"A": 1e-4, "C": 5e-5}, 1e-5)])
def test_the_whole_system_moves_as_the_reduced_one(fault: dict[str, float], rounding: float) -> None:
    """The same steps of 18 coordinates and up to 13 closures as of 6 and 1; contacts make rounding grow."""
    assert difference(run(fault, method="full", step=5e-6), run(fault, method="gill", step=5e-6)) < rounding


def test_the_whole_system_goes_on_where_it_ended() -> None:
    settings = Settings(**SHORT, method="full")  # type: ignore[arg-type]
    first = simulate(MACHINE, WORN, settings)
    (second,) = simulate_batch(MACHINE, [Case(Fault(WORN))], settings, starts=[first.end])
    whole = run(WORN, method="full", duration=0.15)
    after = np.searchsorted(whole.t, second.t[0])
    assert second.velocity[-1] == pytest.approx(
        [np.interp(second.t[-1], whole.t, column) for column in whole.velocity.T], rel=0.02
    )
    assert 0 < after < len(whole.t)


def test_halved_steps_have_the_error_that_is_asked_for() -> None:
    """Samples so far apart that the tolerance decides; measured 1.6e-5, 1.6e-7 and 3.6e-9, steps by 3.1 and 2.6."""
    reference = run({}, rtol=1e-12, sample_rate=100.0)
    found = [run({}, method="gill-variable", rtol=rtol, sample_rate=100.0) for rtol in (1e-7, 1e-9, 1e-11)]
    errors = [difference(one, reference) for one in found]
    assert errors[0] > 20 * errors[1] > 400 * errors[2]
    assert found[0].step > 2 * found[1].step > 4 * found[2].step


def test_halved_steps_are_short_only_where_surfaces_meet() -> None:
    """Not more steps than fixed ones of 0.39 us, and a sixtieth of their error (measured)."""
    reference = run(WORN, rtol=1e-12)
    fixed, halved = run(WORN, method="gill", step=5e-7), run(WORN, method="gill-variable", rtol=1e-7)
    assert difference(halved, reference) < 0.1 * difference(fixed, reference)
    assert halved.step > 0.8 * fixed.step


def test_no_step_small_enough_is_a_status(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(methods, "MOST_STEPS", 16)
    found = simulate(MACHINE, WORN, Settings(**SHORT, method="gill-variable", rtol=1e-9))  # type: ignore[arg-type]
    assert found.status is Status.STEP_TOO_SMALL
    assert found.message.startswith("no step was small enough at 0.")
    assert 0 < len(found.t) < 251 and np.isfinite(found.displacement).all()


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"method": "full", "links": True}, "links: method full gives the motion of the frame; take adaptive or gill"),
        ({"method": "full", "rtol": 1e-6}, "rtol: 1e-06: only adaptive, rosenbrock and gill-variable have a tolerance"),
        ({"method": "gill", "rtol": 1e-6}, "rtol: 1e-06: only adaptive, rosenbrock and gill-variable have a tolerance"),
        ({"method": "gill-variable", "step": 1e-6}, "step: 1e-06: only gill and full have a fixed step; gill-variable"),
        ({"method": "rk4"}, "method: rk4: must be one of adaptive, rosenbrock, gill, gill-variable, full"),
    ],
)
def test_what_makes_no_sense_is_refused(given: dict[str, object], line: str) -> None:
    with pytest.raises(SettingsError) as caught:
        Settings(**given)  # type: ignore[arg-type]
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize("method", ["full", "gill-variable"])
def test_several_starts_are_run_by_the_usual_methods(method: str) -> None:
    with pytest.raises(
        SettingsError, match=f"method: {method}: several starts are run by adaptive, rosenbrock or gill"
    ):
        simulate_ensemble(MACHINE, settings=Settings(method=method))  # type: ignore[arg-type]


def test_implicit_steps_run_several_starts() -> None:
    """The strongest orders of an ideal machine, which repeats; measured 1.3e-4 dB."""
    ensemble = Ensemble(starts=2, converged_db=0.2, most_revolutions=60)
    levels = [
        simulate_ensemble(MACHINE, None, ensemble, Settings(method=method, sample_rate=5000.0)).level[:6, 0]
        for method in ("adaptive", "rosenbrock")
    ]
    assert np.abs(20 * np.log10(levels[1] / levels[0])).max() < 1e-3


def test_steps_that_do_not_end_at_rows_of_tables_say_so() -> None:
    load = {"link": MACHINE.frame, "at": [0, 0], "over_time": [[0, 0, 0, 0], [0.01, 5, 0, 0], [9, 5, 0, 0]]}
    machine = parse_machine(MACHINE.model_dump() | {"loads": [load]})
    told = [simulate(machine, {}, Settings(method=method, duration=0.05)).message for method in ("gill", "adaptive")]
    assert "gill ends no step at rows of tables, 1 in this run: adaptive does" in told[0] and "rows" not in told[1]
