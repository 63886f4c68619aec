from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from machine_trees import changed

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import HEALTHY, Fault, parse_fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine, shipped_machine_names
from jointplay.solver.machines.matrix import MechanismMatrix, matrix_arrays, matrix_tree, read_matrix_form
from jointplay.solver.simulation.simulate import simulate

FILE = """
name: slider-crank as a matrix
matrix: |
  2  B  0 -A
  B  0 -C  0
  0  C  0 -C
  A  0  C  1
links:
  - {name: frame, mass: 20, inertia: 0.5, cg: [0, 0]}
  - {name: crank, mass: 0.3, inertia: 1.0e-4, cg: [0.025, 0.05]}
  - {mass: 0.25, inertia: 6.0e-4, cg: [0.125, 0.05]}
  - {name: slider, mass: 0.5, inertia: 1.0e-4, cg: [0.2, 0.05]}
joints:
  2-1: {name: O, at: [0, 0.05]}
  2-3: {at: [0.05, 0.05], clearance: 0.2 mm}
  3-4: {name: B, at: [0.2, 0.05], clearance: 5.0e-5, contact: {friction: 0.1}}
  4-1: {name: G, at: [0.2, 0.05], direction: [1, 0]}
drive: {kind: rotation, joint: 2-1, speed: "600 rpm"}
supports:
  - {kind: spring, link: frame, at: [0, 0], anchor: [0, -1], stiffness: 1.0e5}
  - {kind: mount, link: frame, at: [0.25, -0.1], stiffness: [0, 4.0e+5], damping: ["0 N s/m", "300 N s/m"]}
  - {kind: damper, link: slider, at: [0.2, 0.05], anchor: [1, 0.05], damping: 3}
"""
EXAMPLE: dict[str, Any] = {
    "name": "m",
    "matrix": ["0 B 0", ["B", 0, "-A"], "0 A 0"],
    "links": {name: {"mass": 1, "inertia": 1, "cg": [0, 0]} for name in ("frame", "arm", "foot")},
    "joints": {"2-1": {"at": [0, 0]}, "3-2": {"at": [1, 0], "direction": [1, 0]}},
}


def test_quick_return_matrix() -> None:
    matrix = MechanismMatrix.from_machine(shipped_machine("quick-return"), ["A", "C"])
    assert matrix.links == ("frame", "crank", "block", "rocker", "coupler", "ram")
    assert matrix.text().splitlines() == [
        "  4  B  0 -C  0 -A",
        "  B  0 -C  0  0  0",
        "  0  C  0 -A  0  0",
        "  C  0  A  0  B  0",
        "  0  0  0  B  0  B",
        "  A  0  0  0  B  4",
    ]
    assert (matrix.springs, matrix.dampers) == (4, 4)
    assert [(i, j) for i, j, symbol in matrix.pairs() if symbol.endswith("C")] == [(0, 3), (1, 2)]
    assert MechanismMatrix.parse(matrix.text(), matrix.links, "m") == matrix


@pytest.mark.parametrize("name", shipped_machine_names())
@pytest.mark.parametrize("count", [0, 1, 4])
def test_there_and_back(name: str, count: int) -> None:
    shipped = shipped_machine(name)
    worn = {joint: 1e-4 * (index + 1) for index, joint in enumerate(shipped.turning_joints[:count])}
    given = {
        joint: {**shipped.model_dump()["joints"][joint], "clearance": clearance} for joint, clearance in worn.items()
    }
    machine = parse_machine({**shipped.model_dump(), "joints": {**shipped.model_dump()["joints"], **given}})
    assert machine.clearances == worn
    tree = matrix_tree(machine)
    assert parse_machine(tree) == machine
    assert MechanismMatrix.from_machine(machine, worn) == read_matrix_form(tree, "m").matrix
    assert machine.without_clearances() == shipped and machine.without_clearances().content_key == shipped.content_key
    assert (machine.content_key == shipped.content_key) == (count == 0)


def test_a_file_in_matrix_form() -> None:
    machine = parse_machine(FILE)
    assert (machine.frame, list(machine.links)) == ("frame", ["frame", "crank", "3", "slider"])
    joints = machine.joints
    assert {name: (joint.kind, joint.links) for name, joint in joints.items()} == {
        "O": ("turning", ("crank", "frame")),
        "2-3": ("turning", ("crank", "3")),
        "B": ("turning", ("3", "slider")),
        "G": ("sliding", ("slider", "frame")),
    }
    assert machine.clearances == {"2-3": pytest.approx(2e-4), "B": 5e-5}
    pins = {name: joint.pin for name, joint in joints.items() if joint.kind == "turning"}
    assert pins == {"O": "crank", "2-3": "3", "B": "slider"}  # by the signs of C
    assert machine.drive is not None
    assert machine.drive.joint == "O"


def refusal(tree: dict[str, Any]) -> str:
    with pytest.raises(MachineError) as caught:
        parse_machine(tree, "m.yaml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"matrix": ["0 B", "B 0"]}, "matrix: must have one row for each of the 3 links, at least one"),
        ({"matrix": 5}, "matrix: must have one row for each of the 3 links, at least one"),
        ({"matrix": "", "links": []}, "matrix: must have one row for each of the 0 links, at least one"),
        ({"matrix": ["0 B 0", "B 0", "0 A 0"]}, "matrix.1: must have 3 symbols"),
        ({"matrix": ["0 B 0", "B 0 -D", "0 D 0"]}, "matrix.1.2: -D: must be 0, A, -A, B, C or -C"),
        ({"matrix": ["0 B 0", "B 0 A", "0 -A 0"]},
         "matrix.1.2: A: a sliding joint is A below the diagonal, -A above it"),
        ({"matrix": ["0 B 0", "B 0 -A", "0 0 0"]}, "matrix.1.2: -A: must face A, not 0"),
        ({"matrix": ["0 C 0", "C 0 -A", "0 A 0"]}, "matrix.0.1: C: must face -C, not C"),
        ({"matrix": ["0 B 0", "B 1 -A", "0 A 0"]}, "matrix.1.1: 1: must be a count in the two corners, 0 between them"),
        ({"matrix": ["x B 0", "B 0 -A", "0 A 0"]}, "matrix.0.0: x: must be a count in the two corners, 0 between them"),
        ({"matrix": ["2 B 0", "B 0 -A", "0 A 0"]},
         "matrix.0.0: 2: must be the number of springs between frame and ground in supports, 0"),
        ({"matrix": ["0 B 0", "B 0 -A", "0 A 1"]},
         "matrix.2.2: 1: must be the number of dampers between frame and ground in supports, 0"),
        ({"frame": "arm"}, "frame: arm: must be the link of the first row, frame"),
        ({"links": 3}, "links: must be a list or a mapping of links in the order of the rows"),
        ({"links": [{"name": "a"}, {"name": "a"}, {}]}, "links.1.name: a: is the name of another link"),
        ({"joints": []}, 'joints: must be a mapping of keys "i-j" to the data of the joints'),
        ({"joints": {"2-1": {"at": [0, 0]}}}, "joints.2-3: is missing: the matrix has this joint"),
        ({"joints": {"1-3": {}}}, "joints.1-3: is no joint of the matrix, or stands here twice"),
        ({"joints": {"1-2": {"at": [0, 0]}, "2-1": {"at": [0, 0]}}},
         "joints.2-1: is no joint of the matrix, or stands here twice"),
        ({"joints": {"1-4": {}}}, 'joints.1-4: must be keyed "i-j" by two link numbers from 1 to 3'),
        ({"joints": {"A": {}}}, 'joints.A: must be keyed "i-j" by two link numbers from 1 to 3'),
        ({"joints": {"2-1": 3}}, "joints.2-1: must be a mapping of keys to values"),
        ({"joints": {"2-1": {"kind": "sliding"}}}, "joints.2-1.kind: sliding: contradicts the matrix: turning"),
        ({"joints": {"2-1": {"at": [0, 0], "name": "P"}, "3-2": {"name": "P"}}},
         "joints.3-2.name: P: is the name of another joint"),
        ({"matrix": ["0 -C 0", "C 0 -A", "0 A 0"]},
         'matrix.0.1: -C: needs its amount, joints.2-1.clearance, as in "0.2 mm"'),
        ({"joints": {"2-1": {"at": [0, 0], "clearance": "0.2 mm"}}},
         "joints.2-1.clearance: 0.2 mm: contradicts the matrix: B"),
        ({"joints": {"2-1": {}, "3-2": {"at": [1, 0], "direction": [1, 0]}}}, "joints.2-1.at: is missing"),
    ],
)  # fmt: skip
def test_refusals(change: dict[str, Any], line: str) -> None:
    assert refusal({**copy.deepcopy(EXAMPLE), **change}) == f"m.yaml: {line}"


def test_the_example_that_the_refusals_change_is_a_machine() -> None:
    assert parse_machine(EXAMPLE).sliding_joints == ("3-2",)


def test_pin_of_a_clearance_joint_follows_the_sign() -> None:
    tree = {**copy.deepcopy(EXAMPLE), "matrix": ["0 -C 0", "C 0 -A", "0 A 0"]}
    tree["joints"]["2-1"] |= {"pin": "frame", "clearance": 1e-4}
    assert refusal(tree) == "m.yaml: joints.2-1.pin: frame: contradicts the matrix: arm"


def test_what_a_matrix_cannot_say() -> None:
    body = {"mass": 1, "inertia": 1, "cg": [0, 0]}
    joint = {"kind": "turning", "links": ["a", "b"], "at": [0, 0]}
    twice = parse_machine({"name": "m", "links": {"a": body, "b": body}, "joints": {"P": joint, "Q": joint}})

    def message(machine: Machine, *worn: str) -> str:
        with pytest.raises(MachineError) as caught:
            MechanismMatrix.from_machine(machine, worn)
        return str(caught.value)

    assert message(twice) == (
        "m: joints.Q: is a second joint between the same links, which a mechanism matrix cannot hold"
    )
    assert message(shipped_machine("slider-crank"), "G1") == (
        "slider-crank: joints.G1: is no joint that can have clearance"
    )


ALONE: dict[str, Any] = {
    "name": "sprung block",
    "links": {"block": {"mass": 4, "inertia": 0.1, "cg": [0, 0]}},
    "supports": [
        {"kind": "spring", "link": "block", "at": [x, 0], "anchor": [x, -1], "stiffness": 1e4} for x in (-1, 0, 1)
    ] + [{"kind": "damper", "link": "block", "at": [0, 0], "anchor": [0, -1], "damping": 20}],
}  # fmt: skip


@pytest.mark.parametrize(("dampers", "cell"), [(1, "3/1"), (3, "3")])
def test_a_single_link_counts_springs_and_dampers_in_its_one_entry(dampers: int, cell: str) -> None:
    supports = [*ALONE["supports"], *ALONE["supports"][3:] * (dampers - 1)]
    plain = parse_machine({**ALONE, "supports": supports})
    matrix = MechanismMatrix.from_machine(plain)
    assert (matrix.rows, matrix.springs, matrix.dampers) == (((cell,),), 3, dampers)
    for rows in (cell, [cell], [[cell]], f"3/{dampers}"):
        assert parse_machine({**ALONE, "supports": supports, "matrix": rows}) == plain
    arrays = matrix_arrays(matrix)
    assert (arrays.springs, arrays.dampers, arrays.counts["NL"], arrays.neighbours["JL"]) == (3, dampers, (0,), ((0,),))


@pytest.mark.parametrize(
    ("cell", "line"),
    [
        ("3", "matrix.0.0: 3: must be the number of dampers between frame and ground in supports, 1"),
        ("2/1", "matrix.0.0: 2: must be the number of springs between frame and ground in supports, 3"),
        ("B", "matrix.0.0: B: must count springs and dampers: 4, or 4/2"),
        ("3/1/1", "matrix.0.0: 3/1/1: must count springs and dampers: 4, or 4/2"),
    ],
)
def test_refusals_of_a_single_entry(cell: str, line: str) -> None:
    assert refusal({**ALONE, "matrix": [cell]}) == f"m.yaml: {line}"


def test_what_a_file_gives_is_the_fault_where_none_is_asked_for() -> None:
    machine = parse_machine(FILE)
    short = Settings(duration=0.02, sample_rate=2000)
    ran = simulate(machine, settings=short)
    assert ran.case.fault == Fault({"2-3": 2e-4, "B": 5e-5}) == parse_fault(None, machine)
    assert ran.message == ""
    closed = simulate(machine, {}, short)
    assert closed.case.fault == HEALTHY == parse_fault("healthy", machine) == parse_fault("", machine)
    assert closed.message == "without the clearance that the file gives 2-3, B"
    assert np.abs(ran.displacement - closed.displacement).max() > 1e-6
    other = simulate(machine, Case(Fault({"B": 1e-4})), short)
    assert other.message == "without the clearance that the file gives 2-3"
    alone = simulate(machine.without_clearances(), {"2-3": 2e-4, "B": 5e-5}, short)
    assert np.array_equal(alone.displacement, ran.displacement) and alone.message == ""


@pytest.mark.parametrize(
    ("value", "rule"),
    [
        (0, "0: must be greater than 0"),
        (0.2, "0.2: is 200 mm without a unit; write 0.2mm if that is meant, or the unit"),
        ("1 kg", '1 kg: "kg" is a mass, must be a length, for example "0.2 mm"'),
    ],
)
def test_clearances_that_are_none(value: object, rule: str) -> None:
    assert refusal(changed("joints.A.clearance", value)) == f"m.yaml: joints.A.clearance: {rule}"
