"""Frozen spectra: whether this program still computes the numbers of its ``jointplay.solver.NUMBERS_VERSION``.

A failure means that stored catalogues hold other numbers than this program computes. If that is meant - equations,
integrators, their tolerances, starts or the estimate of spectra were changed - raise ``NUMBERS_VERSION`` by one and
freeze anew, ``python tests/solver/test_numbers_version.py``, in the same commit: catalogues of before are then refused
by builds, and by comparisons with them. If it is not meant, the change is wrong. A new version of the product, of a
file format, of plans or of matching needs none.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from jointplay import solver
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.steps import STEP_RULES
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.runs import TOLERANCES
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import BandScheme
from jointplay.solver.spectra.segments import hann

FROZEN = Path(__file__).parents[1] / "data" / "numbers" / "frozen.npz"
RATE = 4000.0

#: Of a cross-power, as a part of the root of the product of its channels' powers. Kernels and libraries held to
#: AVX-512, AVX2 and SSE2 differed by 5e-9 at most, speeds and clearances moved by one to five units in their last place
#: gave 4e-9 (contacts amplify rounding, but not by more within so few revolutions); a tolerance of the steps changed by
#: 2 % gives 7e-5 to 2e-2.
CLOSE = 1e-6
#: Of the largest power of the channels: rounding is all that a machine without play has at high orders.
FLOOR = 1e-12


class Frozen(NamedTuple):
    """One case."""

    machine: str
    fault: dict[str, float]
    settings: dict[str, Any]
    contact: dict[str, Any] = {}  # noqa: RUF012  (of all turning joints; the file's where empty)
    film: dict[str, Any] | None = None  # of all turning joints


FITS = {"A": 7e-6, "B": 5e-6, "O": 9e-6}
DRAFT: dict[str, Any] = {"accuracy": "draft", "settled": True, "repeating": True}
CASES = {
    "ideal": Frozen("slider-crank", {}, {"accuracy": "draft"}),
    "fits": Frozen("slider-crank", FITS, DRAFT),
    "worn": Frozen("slider-crank", {**FITS, "B": 2e-4}, DRAFT),
    "worn, standard": Frozen("slider-crank", {"B": 2e-4}, {"accuracy": "standard"}),
    "hertz": Frozen("slider-crank", FITS, DRAFT, {"law": "hertz", "stiffness": 1.5e9, "hysteresis": 3.0}),
    "flores": Frozen("slider-crank", FITS, DRAFT, {"law": "flores", "stiffness": 1.5e9, "restitution": 0.8}),
    # Which implicit steps `draft` takes is decided by rounding, to 5e-3 of a band.
    "oil": Frozen("slider-crank", {**FITS, "B": 2e-4}, {"rtol": 1e-9}, film={"viscosity": 0.03, "length": 0.016}),
    "two slides": Frozen("quick-return", dict.fromkeys("ACEFO", 1e-5), DRAFT),
    # Joints that knock are no case for fixed steps: at which of them a contact begins is decided by rounding.
    "gill": Frozen("slider-crank", FITS, {"accuracy": "draft", "method": "gill"}),
}


def machine_of(case: Frozen) -> Machine:
    tree = json.loads(shipped_machine(case.machine).canonical_json())
    for joint in tree["joints"].values():
        if case.contact and joint["kind"] == "turning":
            joint["contact"] = case.contact
        if case.film and joint["kind"] == "turning":
            joint["film"] = case.film
    return parse_machine(tree)


def spectrum(name: str) -> npt.NDArray[np.complex128]:
    """Cross-powers (B, 3, 3) as a catalogue stores them, of three revolutions or the period that is seen in them."""
    case = CASES[name]
    machine = machine_of(case)
    settings = Settings(sample_rate=RATE, revolutions=3.05, motion=False, transient=False, **case.settings)
    history = simulate(machine, Case(Fault(case.fault)), settings)
    assert history.status == "ok", history.message
    scheme = BandScheme.for_drive(abs(machine.drive.speed), 1000.0, 20, 3)  # type: ignore[union-attr,arg-type]
    signal, rate = history.band_limited_acceleration, history.sample_rate
    found = band_matrix(signal, rate, history.drive_speed, scheme, period=history.period).power
    return np.asarray(found, np.complex128)


def off(name: str) -> float:
    """How far a case is off what was frozen, as a part of what it may be."""
    with np.load(FROZEN) as kept:
        before = kept[name]
    now = spectrum(name)
    assert now.shape == before.shape
    power = np.einsum("bii->bi", before).real
    power = CLOSE * power + FLOOR * power.max(axis=0)
    return float(np.max(np.abs(now - before) / np.sqrt(power[:, :, None] * power[:, None, :])))


def test_what_is_frozen_is_of_this_version() -> None:
    with np.load(FROZEN) as kept:
        assert int(kept["version"]) == solver.NUMBERS_VERSION
        assert set(kept.files) == {"version", *CASES}


@pytest.mark.parametrize("name", CASES)
def test_numbers_are_those_of_their_version(name: str) -> None:
    assert off(name) < 1.0, "raise jointplay.solver.NUMBERS_VERSION, see above"


@pytest.mark.parametrize(
    ("name", "where", "what"),
    [
        (
            "fits",
            "jointplay.solver.simulation.runs.TOLERANCES",
            {**TOLERANCES, "draft": 1.02 * TOLERANCES["draft"]},
        ),
        ("worn, standard", "jointplay.solver.simulation.runs.TOLERANCES", {**TOLERANCES, "standard": 0.98e-6}),
        ("two slides", "jointplay.solver.simulation.simulate.SETTLED_PART", 0.5),
        ("fits", "jointplay.solver.simulation.repeating.AGREEMENT", 1e-4),
        (
            "gill",
            "jointplay.solver.cases.preparation.STEP_RULES",
            {**STEP_RULES, "draft": replace(STEP_RULES["draft"], contact=0.4, decay=0.6)},
        ),
        ("worn", "jointplay.solver.spectra.segments.hann", lambda length: hann(length) ** 1.0001),
    ],
)
def test_small_changes_of_the_method_show(name: str, where: str, what: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(where, what)
    assert off(name) > 10.0


if __name__ == "__main__":
    FROZEN.parent.mkdir(exist_ok=True)
    np.savez_compressed(FROZEN, version=solver.NUMBERS_VERSION, **{name: spectrum(name) for name in CASES})
