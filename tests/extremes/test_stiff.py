"""What is so stiff, light or rough that explicit steps would never come to an end: it runs, in not many steps, and says
why its steps are implicit. The figures are in docs/measured/extremes.md.
"""

from __future__ import annotations

import pytest
from laws import Tree, tree_of

from jointplay.solver.cases.case import Settings, Status
from jointplay.solver.machines.machine import parse_machine
from jointplay.solver.simulation.simulate import simulate

#: Trial steps of 0.3 s: explicit ones half a second of processor time, implicit ones three times as long.
MOST_TRIALS = 1_200_000


def mounted(**numbers: float) -> Tree:
    tree = tree_of("slider-crank")
    for support in tree["supports"]:
        support |= {name: [value, value] for name, value in numbers.items()}
    return tree


def heavy(factor: float) -> Tree:
    tree = tree_of("slider-crank")
    tree["links"]["rod"]["mass"] *= factor
    tree["links"]["rod"]["inertia"] *= factor
    return tree


def wedged() -> Tree:
    tree = tree_of("slider-crank")
    tree["joints"]["G1"]["friction"] = 5.0
    return tree


@pytest.mark.parametrize(
    ("tree", "cause"), [
        (mounted(stiffness=1e9), ""),
        (mounted(stiffness=1e11), ""),
        (mounted(stiffness=1e13), ""),
        (mounted(stiffness=1e15), "supports.1.stiffness.1: 1e+15"),
        (mounted(damping=1e5), ""),
        (mounted(damping=1e7), "supports.1.damping.1: 1e+07"),
        (mounted(damping=1e9), "supports.1.damping.1: 1e+09"),
        (tree_of("slider-crank", damping=1e6), "joints.B.contact.damping: 1e+06"),
        (tree_of("slider-crank", damping=1e9), "joints.B.contact.damping: 1e+09"),
        (heavy(1e-6), "links.rod.mass: 2.5e-07"),
        (heavy(1e-9), "links.rod.mass: 2.5e-10"),
        (tree_of("slider-crank", friction=50.0), ""),
        (wedged(), "joints.G1.friction: 5: times its leverage on the normal force is 1.77: the guide wedges"),
    ],
)  # fmt: skip
def test_a_stiff_scene_ends_and_says_how(tree: Tree, cause: str) -> None:
    history = simulate(parse_machine(tree), {"B": 2e-4}, Settings(duration=0.3, most_trials=MOST_TRIALS))
    assert history.status is Status.OK
    told = f"implicit steps (rosenbrock), because of {cause}" if cause else ""
    assert told in history.message
    assert ("rosenbrock" in history.message) == bool(cause)


@pytest.mark.parametrize("factor", [1e-6, 1e-9])
def test_a_light_link_of_an_ideal_machine_needs_nothing(factor: float) -> None:
    history = simulate(parse_machine(heavy(factor)), {}, Settings(duration=0.3, most_trials=MOST_TRIALS))
    assert (history.status, history.message) == (Status.OK, "")
