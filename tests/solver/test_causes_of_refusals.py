"""Refusals name the link, joint, mount or setting that asks for explicit steps without number."""

from __future__ import annotations

from typing import Any

import pytest
from laws import Tree, tree_of

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import parse_machine
from jointplay.solver.simulation.simulate import simulate


def refusal(tree: Tree, settings: Settings | None = None, **numbers: float) -> str:
    case = Case(Fault({"B": 2e-4}), {path.replace("__", "."): value for path, value in numbers.items()})
    with pytest.raises((MachineError, SettingsError)) as refused:
        simulate(parse_machine(tree), case, settings or Settings(duration=0.3, method="adaptive"))
    return str(refused.value)


def test_a_light_link_is_named() -> None:
    tree = tree_of("slider-crank")
    tree["links"]["rod"] |= {"mass": 2.5e-7, "inertia": 6e-10}
    told = refusal(tree)
    assert told.startswith("slider-crank: links.rod.mass: 2.5e-07: joint B damps an effective mass of 8.9")
    assert told.endswith("take a heavier link: 0.3 s need more than 2e+09 steps of 1.19e-10 s")


def test_a_contact_is_named() -> None:
    told = refusal(tree_of("slider-crank"), contact__damping=1e9)
    assert told.startswith("slider-crank: joints.B.contact.damping: 1000000000.0: damps an effective mass of 0.0863 kg")
    told = refusal(tree_of("slider-crank"), contact__stiffness=1e22)
    assert told.startswith("slider-crank: joints.B.contact.stiffness: 1e+22: swings at")


@pytest.mark.parametrize(
    ("support", "start"),
    [
        ({"damping": [0.0, 1e16]}, "supports.2.damping.1: 1e+16: a motion that it holds decays at"),
        ({"stiffness": [1e22, 0.0]}, "supports.2.stiffness.0: 1e+22: a motion that it holds swings at"),
    ],
)
def test_a_support_is_named(support: dict[str, Any], start: str) -> None:
    tree = tree_of("slider-crank")
    tree["supports"].append({"kind": "mount", "link": "slider", "at": [0.2, 0.05], "stiffness": [0, 0]} | support)
    assert refusal(tree).startswith(f"slider-crank: {start}")


def test_a_pin_out_of_all_proportion_is_named() -> None:
    told = refusal(tree_of("slider-crank"), pin_radius=10.0)
    assert told == "slider-crank: joints.B.pin_radius: 10.0: is more than 10 times the machine's extent of 0.206 m"


def test_samples_farther_apart_than_the_run_are_refused() -> None:
    told = refusal(tree_of("slider-crank"), Settings(sample_rate=0.01))
    assert told == (
        "sample rate: 0.01 Hz: less than one sample in the run of 1.6 s and in a revolution; take at least 0.625 Hz"
    )
    one = simulate(parse_machine(tree_of("slider-crank")), None, Settings(duration=1e-9))
    assert (one.status, len(one.t)) == (Status.OK, 1)
