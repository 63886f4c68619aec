"""Baselines: simulated recordings of machines whose numbers and gains are known to be off come back with them."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from in_order import FITS, FS, GAINS, off_by, recordings
from levels import levels_of

from jointplay.catalogue.diagnosing.baseline import LEAST_WEIGHT, Baseline, fit_baseline
from jointplay.catalogue.diagnosing.baseline_levels import OrderLevels, class_statistics
from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of
from jointplay.catalogue.diagnosing.healthy_machine import quantities
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.measurements.measurement import Channel, Recording, read_measurement
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.suspension import accelerance, suspension_change, with_filed_suspension
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.machines.parts import Mount, Spring
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.sensor import sensor_transform

NAMES = ("frame.mass", "frame.inertia", "supports.stiffness.x", "supports.stiffness.y", "supports.damping")


@pytest.fixture(scope="module")
def fitted(small_catalogue: Catalogue) -> Baseline:
    (prepared,) = recordings(small_catalogue, [off_by(small_catalogue, (1.12, 0.92, 0.85, 1.2, 1.3))])
    return fit_baseline(prepared, small_catalogue)


def test_what_a_baseline_can_correct(small_catalogue: Catalogue) -> None:
    found = quantities(small_catalogue.machine)
    assert tuple(quantity.name for quantity in found) == NAMES
    assert found[2].paths == {"supports.0.stiffness.0": 2e5, "supports.1.stiffness.0": 2e5}
    assert found[0].parameters(math.log(1.1)) == pytest.approx({"links.frame.mass": 22.0})


def test_numbers_and_gains_come_back(fitted: Baseline) -> None:
    """Measured on eleven such recordings, other fits each: mass, stiffness 2 to 4 %, inertia 2 to 14, damping 4 to 20.

    Damping falls short of what it is: it shows in few levels, which the play of fits scatters.
    """
    for name, factor, within in zip(NAMES, (1.12, 0.92, 0.85, 1.2, 1.3), (0.05, 0.15, 0.05, 0.05, 0.25), strict=True):
        error = math.log(fitted.numbers[name].factor / factor)
        assert abs(error) < within and abs(error) < 3.0 * fitted.numbers[name].scatter
    names = ("s1-x", "s1-y", "s2-x", "s2-y")
    error = np.log([fitted.gains[name].factor / gain for name, gain in zip(names, GAINS, strict=True)])
    # What all gains have in common looks like mass; what they differ by does not.
    assert np.abs(error - error.mean()).max() < 0.04 and abs(error.mean()) < 0.05
    assert fitted.explained
    assert fitted.p_before < 0.05 and fitted.p_after > 0.5
    assert fitted.parameters["links.frame.mass"] == pytest.approx(20.0 * fitted.numbers["frame.mass"].factor)
    assert any("supports.stiffness.y is 1.2" in warning for warning in fitted.warnings)


def test_a_machine_as_its_file_has_it(small_catalogue: Catalogue) -> None:
    (prepared,) = recordings(small_catalogue, [off_by(small_catalogue, (1.0,) * 5, 0.99)], (1.0,) * 4)
    found = fit_baseline(prepared, small_catalogue)
    assert found.p_before > 0.3 and found.p_after > 0.3 and found.warnings == ()
    for name in (*NAMES[:1], *NAMES[2:4]):
        assert found.numbers[name].factor == pytest.approx(1.0, abs=0.03)
    assert all(gain.factor == pytest.approx(1.0, abs=0.02) for gain in found.gains.values())


def test_several_recordings_are_fitted_together(small_catalogue: Catalogue) -> None:
    """Measured: scatter of the numbers 0.55 to 0.75 of that from one, errors as for one."""
    factors = (1.12, 0.92, 0.85, 1.2, 1.3)
    made = recordings(small_catalogue, [off_by(small_catalogue, factors, speed) for speed in (0.985, 1.0, 1.012)])
    one, three = (fit_baseline(each, small_catalogue) for each in (made[0], made))
    assert three.explained and three.simulations > 2 * one.simulations
    for name, factor, within in zip(NAMES, factors, (0.05, 0.15, 0.05, 0.05, 0.25), strict=True):
        assert three.numbers[name].scatter < 0.85 * one.numbers[name].scatter
        assert abs(math.log(three.numbers[name].factor / factor)) < within
    fewer = dataclasses.replace(made[1].sensing, sensors=("s1-x", "s1-y", "s2-x", "other"))
    with pytest.raises(DiagnosisError, match="its sensors are not those of baseline"):
        fit_baseline([made[0], dataclasses.replace(made[1], sensing=fewer)], small_catalogue)


def test_gains_are_taken_out_of_recordings(small_catalogue: Catalogue) -> None:
    case = off_by(small_catalogue, (1.0,) * 5)
    crooked, right = (recordings(small_catalogue, [case], gains)[0] for gains in (GAINS, (1.0,) * 4))
    baseline = fit_baseline(crooked, small_catalogue)
    straight = baseline.correct(crooked, small_catalogue.machine)
    orders = slice(0, 60)
    before = np.abs(levels_of(crooked) - levels_of(right))[orders].max()
    after = np.abs(levels_of(straight) - levels_of(right))[orders].max()
    # What two gains make of a level that nearly cancels: 3.6 dB, and 2.2 to 2.5 when gains are known to 2.5 %.
    assert before > 0.8 and after < 0.75 * before
    assert [step.name for step in straight.steps[-2:]] == ["gains", "suspension"]


def test_levels_of_machines_exactly_as_filed_scatter_less(small_catalogue: Catalogue) -> None:
    """Tolerances of frame and mounts are most of what the low orders of machines in order scatter by."""
    (prepared,) = recordings(small_catalogue, [off_by(small_catalogue, (1.0,) * 5)])
    levels = OrderLevels.of(prepared)
    drawn, exact = (class_statistics(small_catalogue, levels, "healthy", as_filed=each) for each in (False, True))
    assert drawn is not None and exact is not None
    first = slice(0, 2 * (len(levels.measured) // 20))  # orders 1 and 2: 0.9 and 0.25 dB in plan standard
    assert np.median(exact.deviations[:, first].std(axis=0)) < 0.5 * np.median(drawn.deviations[:, first].std(axis=0))
    assert exact.fitted > drawn.fitted == 3


def test_what_may_be_hum_counts_as_noise_in_its_order(small_catalogue: Catalogue) -> None:
    (plain,) = recordings(small_catalogue, [off_by(small_catalogue, (1.0,) * 5)])
    assert plain.hum_power is not None and not plain.hum_power.any()  # 606 rpm
    power = np.zeros(len(plain.noise_power))
    power[4] = 0.5 * 0.05**2
    humming = dataclasses.replace(plain, hum_power=power)
    sensing, without = exact_sensing(humming), exact_sensing(plain)
    expected = power[4] * np.sum(plain.sensing.channels**2, axis=1)
    assert sensing.noise[4] - without.noise[4] == pytest.approx(expected)
    assert np.delete(sensing.noise, 4, axis=0) == pytest.approx(np.delete(without.noise, 4, axis=0))
    bands = sensing.noise.shape[0]
    raised = (features_of(humming, sensing) - features_of(plain, without))[: sensing.noise.size]
    raised = raised.reshape(bands, -1)
    assert raised[4] == pytest.approx(10.0 * np.log10(1.0 + expected / plain.group_power[4]))
    assert not np.delete(raised, 4, axis=0).any()
    more, before = OrderLevels.of(humming), OrderLevels.of(plain)
    shape = (20, -1)
    assert (more.noise.reshape(shape)[4] > before.noise.reshape(shape)[4]).all()
    assert (more.measured.reshape(shape)[4] > before.measured.reshape(shape)[4]).all()
    assert np.delete(more.measured.reshape(shape), 4, axis=0) == pytest.approx(
        np.delete(before.measured.reshape(shape), 4, axis=0)
    )


def test_recordings_are_converted_to_the_machine_of_the_file(small_catalogue: Catalogue) -> None:
    """A worn joint in a machine with other numbers and in that of the file: nearly the same levels once converted.

    Measured, orders 1 to 10, root mean square: 5.1 to 1.3 dB (quick-return; slider-crank, whose supports resonate near
    order 2, 4.3 to 3.3 dB).
    """
    machine = shipped_machine("quick-return")
    other: dict[str, float] = {}
    for quantity, factor in zip(quantities(machine), (1.12, 0.92, 0.85, 1.2, 1.3), strict=True):
        other |= quantity.parameters(math.log(factor))
    wear, friction = Fault({"O": 2e-4}), {"contact.friction": 0.05}
    sensors = machine.sensors
    transform = sensor_transform(
        [s.at for s in sensors], [s.direction for s in sensors], machine.links[machine.frame].cg
    )
    channels = tuple(Channel(s.name, "m/s2", "acceleration") for s in sensors)
    settings = Settings(sample_rate=FS, accuracy="draft", revolutions=6.0, motion=False)
    found = []
    for history in simulate_batch(machine, [Case(wear, {**friction, **other}), Case(wear, friction)], settings):
        signal = history.band_limited_acceleration[history.t >= history.transient] @ transform.T
        signal = signal + np.random.default_rng(0).normal(0.0, 0.01, signal.shape)
        found.append(prepare(Recording("worn", FS, signal, channels, (), (), "0" * 64), machine))
    crooked, right = found
    straight = with_filed_suspension(crooked, machine, other)
    orders = slice(0, 30)
    before, after = (
        np.sqrt(np.mean((levels_of(each) - levels_of(right))[orders] ** 2)) for each in (crooked, straight)
    )
    assert after < 0.5 * before
    assert straight.steps[-1].name == "suspension"
    # And so is what is locked to the crank, where the links more than the joints make it: 0.048 to 0.017 (m/s2)^2.
    near, far = (np.abs(each.group_cyclic[:4, 0] - right.group_cyclic[:4, 0]).max() for each in (straight, crooked))
    assert near < 0.5 * far
    same = with_filed_suspension(crooked, machine, {})
    assert same.group_cyclic == pytest.approx(crooked.group_cyclic, abs=1e-9 * np.abs(crooked.group_cyclic).max())
    assert levels_of(with_filed_suspension(crooked, machine, {})) == pytest.approx(levels_of(crooked), abs=1e-6)
    # Two axes at one corner do not see the frame's rotation: nothing can be converted.
    bare = dataclasses.replace(crooked.sensing, compared=crooked.sensing.sensors, channels=np.eye(4))
    part = dataclasses.replace(crooked, sensing=bare)
    assert with_filed_suspension(part, machine, other) is part
    # Nor can it where more than mounts to the ground holds the frame; what holds another link does not count.
    mount, cg = machine.supports[0], machine.links[machine.frame].cg
    assert isinstance(mount, Mount)
    link = next(name for name in machine.links if name != machine.frame)
    spring = Spring(link=machine.frame, at=cg, anchor=(1.0, 0.0), stiffness=1e4)
    held = mount.model_copy(update={"to_link": link})
    beside = mount.model_copy(update={"link": link})
    for support, converted in ((spring, False), (held, False), (beside, True)):
        more = machine.model_copy(update={"supports": (*machine.supports, support)})
        assert (with_filed_suspension(crooked, more, other) is not crooked) == converted


def test_the_suspension_as_a_rigid_body(small_catalogue: Catalogue) -> None:
    machine = small_catalogue.machine
    moving = sum(link.mass or 0.0 for name, link in machine.links.items() if name != machine.frame)
    found = accelerance(machine, {}, np.array([1.0, 1e4]))
    # Far above its resonances a free body, far below a spring.
    assert found[1] == pytest.approx(np.diag([1 / (20 + moving), 1 / (20 + moving), 2.0]), rel=1e-2, abs=1e-4)
    assert found[0, 0, 0].real == pytest.approx(-((2 * math.pi) ** 2) / 4e5, rel=0.1)
    change = suspension_change(machine, {"links.frame.mass": 25.0}, np.array([1e4]))
    assert change[0, 0, 0].real == pytest.approx((25 + moving) / (20 + moving), rel=1e-3)
    assert suspension_change(machine, {}, np.array([30.0]))[0] == pytest.approx(np.eye(3), abs=1e-12)


def test_a_frame_that_cannot_turn_rests_on_mounts_that_do_not_couple() -> None:
    tree = shipped_machine("slider-crank").model_dump()
    tree["supports"][0]["at"] = [-0.75, -0.1]
    tree["links"]["frame"]["locked"] = ["theta"]
    locked = parse_machine(tree)
    mass = sum(link.mass or 0.0 for link in locked.links.values())
    stiffness = np.sum([each.stiffness for each in locked.supports], axis=0)
    damping = np.sum([each.damping for each in locked.supports], axis=0)
    frequency = np.array([3.0, 30.0, 300.0])
    w = 2.0 * math.pi * frequency[:, None]
    expected = -(w**2) / (stiffness + 1j * w * damping - w**2 * mass)
    found = accelerance(locked, {}, frequency)
    assert np.diagonal(found, axis1=1, axis2=2)[:, :2] == pytest.approx(expected, rel=1e-12)
    assert np.abs(found).sum() == pytest.approx(np.abs(expected).sum(), rel=1e-12)
    change = suspension_change(locked, {"supports.0.stiffness.0": 1.0}, frequency)
    assert change[:, 1:] == pytest.approx(np.tile(np.diag([1.0, 1.0, 0.0])[1:], (3, 1, 1)), abs=1e-12)


def test_faults_are_no_baseline(small_catalogue: Catalogue) -> None:
    """A worn joint, and one loose mount: common factors of the supports do not stand for it."""
    worn = Case(Fault({**FITS, "A": 3e-4}), {"contact.friction": 0.05})
    loose = Case(Fault(FITS), {"supports.0.stiffness.0": 1e5, "supports.0.stiffness.1": 2e5})
    (first,) = recordings(small_catalogue, [worn], (1.0,) * 4)
    (second,) = recordings(small_catalogue, [loose], (1.0,) * 4)
    for prepared in (first, second):
        found = fit_baseline(prepared, small_catalogue)
        assert not found.explained and "no healthy machine explains it" in found.warnings[0]
        assert found.correct(prepared, small_catalogue.machine) is prepared
        assert KnownMachine(found, ("0" * 64,)).weights(small_catalogue) is None


@pytest.mark.parametrize("force", [0.0, 40.0])
def test_loads_of_the_process(small_catalogue: Catalogue, force: float) -> None:
    """A constant one moves no low order of a machine in order; one that comes and goes with the drive does.

    One of 20 N is taken for other numbers (p 0.2; mass 1, stiffness 3, damping 20 % off): the play of fits hides it.
    """
    tree = small_catalogue.machine.model_dump(mode="json")
    angles = np.linspace(0.0, 2.0 * math.pi, 37)[:-1]
    thrust = -40.0 + force * np.maximum(0.0, np.sin(angles))
    rows = [[float(angle), float(push), 0.0, 0.0] for angle, push in zip(angles, thrust, strict=True)]
    slider = next(joint for joint in tree["joints"].values() if joint["kind"] == "sliding")
    tree["loads"] = [{"link": slider["links"][0], "at": slider["at"], "over_angle": rows}]
    case = Case(Fault(FITS))
    (prepared,) = recordings(small_catalogue, [case], (1.0,) * 4, parse_machine(tree))
    found = fit_baseline(prepared, small_catalogue)
    assert found.explained == (force == 0.0)
    assert found.numbers["frame.mass"].factor == pytest.approx(1.0, abs=0.03) or force


def weights_with(
    catalogue: Catalogue, fitted: Baseline, factors: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> np.ndarray:
    """Weights of the entries if their stiffness had been drawn, asked for without the table of all entries."""
    drawn = {f"supports.{index}.stiffness.0": 2e5 * factors for index in (0, 1)}
    monkeypatch.setattr(catalogue.matrix, "numbers", lambda paths: {path: drawn[path] for path in paths & drawn.keys()})
    monkeypatch.setitem(catalogue.__dict__, "entries", None)
    weights = KnownMachine(fitted, ("0" * 64,)).weights(catalogue)
    assert weights is not None
    return weights


def test_no_entry_weighs_nothing(small_catalogue: Catalogue, fitted: Baseline, monkeypatch: pytest.MonkeyPatch) -> None:
    factors = np.full(len(small_catalogue.matrix), 0.85)
    factors[::3] = 1e3  # so far off that a Gaussian has nothing left of it
    weights = weights_with(small_catalogue, fitted, factors, monkeypatch)
    assert (weights[::3] == LEAST_WEIGHT).all() and LEAST_WEIGHT > 0.0
    assert (np.delete(weights, np.s_[::3]) > 0.9).all()


def test_entries_like_the_machine_weigh_more(
    small_catalogue: Catalogue, fitted: Baseline, monkeypatch: pytest.MonkeyPatch
) -> None:
    factors = np.exp(np.random.default_rng(0).normal(0.0, 0.15, len(small_catalogue.matrix)))
    weights = weights_with(small_catalogue, fitted, factors, monkeypatch)
    near, far = np.abs(np.log(factors / 0.85)) < 0.05, np.abs(np.log(factors / 0.85)) > 0.35
    assert weights[near].mean() > 5.0 * weights[far].mean()
    for label in small_catalogue.hypotheses:
        own = weights[small_catalogue.matrix.rows(label)]
        assert own.sum() ** 2 / np.square(own).sum() >= min(100.0, 0.5 * len(own)) - 1e-9
    monkeypatch.undo()
    plain = KnownMachine(fitted, ("0" * 64,)).weights(small_catalogue)
    matrix = small_catalogue.matrix
    masses = matrix.table(np.arange(len(matrix))).parameters["links.frame.mass"]
    assert plain is not None and fitted.numbers["frame.mass"].factor > 1.05
    assert plain[masses > np.quantile(masses, 0.7)].mean() > 1.2 * plain[masses < np.quantile(masses, 0.3)].mean()


def test_fitting_reads_neither_the_table_of_all_entries_nor_a_shard(
    small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    (prepared,) = recordings(small_catalogue, [off_by(small_catalogue, (1.0,) * len(NAMES))], (1.0,) * 4)
    monkeypatch.setitem(small_catalogue.__dict__, "entries", None)
    monkeypatch.setattr(Catalogue, "_read", None)
    found = fit_baseline(prepared, small_catalogue)
    assert found.explained
    weights = KnownMachine(found, ("0" * 64,)).weights(small_catalogue)
    assert weights is not None and weights.shape == (len(small_catalogue.matrix),)
    assert weights.max() > 2.0 * weights.min()


@pytest.mark.parametrize("name", ["slider-crank-01", "slider-crank-04"])
def test_recordings_made_by_other_code(small_catalogue: Catalogue, name: str) -> None:
    """A machine without any play, which none is: numbers are off by what play would have added, up to 8 % (inertia).

    Those of machines with play are within 3 %, see above.
    """
    recording = read_measurement(Path(__file__).parents[1] / "data" / "recordings" / f"{name}.csv.gz")
    found = fit_baseline(prepare(recording, small_catalogue.machine, scheme=small_catalogue.scheme), small_catalogue)
    assert found.explained == (name == "slider-crank-01")
    if found.explained:
        for each in (found.numbers[name] for name in NAMES):
            assert abs(math.log(each.factor)) < min(0.1, 2.0 * each.scatter)


def test_refusals(small_catalogue: Catalogue) -> None:
    (prepared,) = recordings(small_catalogue, [off_by(small_catalogue, (1.0,) * 5)])
    with pytest.raises(DiagnosisError, match="baseline steps: 0: must be at least 1"):
        fit_baseline(prepared, small_catalogue, steps=0)
    fixed = parse_machine(
        """
        name: crank
        links: {base: {fixed: true, cg: [0, 0]}, crank: {mass: 1, inertia: 0.01, cg: [0.05, 0]}}
        joints: {O: {kind: turning, links: [crank, base], at: [0, 0]}}
        drive: {kind: rotation, joint: O, speed: 31.4}
        """
    )
    assert quantities(fixed) == ()
    assert len(quantities(shipped_machine("quick-return"))) == 5
