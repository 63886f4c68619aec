"""The commands that describe a machine, ``machines`` and ``check``: what they say, print and draw."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import assert_refused, invoke
from extremes.scenes import four_bar
from matplotlib.image import imread
from matplotlib.patches import Circle

from jointplay.app.figures.pictures import paint
from jointplay.catalogue.storage.hdf5 import read_arrays
from jointplay.solver.machines.drawing import draw_machine
from jointplay.solver.machines.machine import load_machine, parse_machine, shipped_machine, shipped_machine_text


def test_machines() -> None:
    listed = invoke("machines")
    assert {"slider-crank", "four-bar", "quick-return"} <= {line.split()[0] for line in listed.stdout.splitlines()}
    names = [item["name"] for item in json.loads(invoke("machines", "--json").stdout)]
    for name in names:
        machine = parse_machine(invoke("machines", name).stdout, name)
        again = parse_machine(json.loads(invoke("machines", name, "--json").stdout), name)
        assert again.turning_joints == tuple(sorted(machine.turning_joints))


def with_response(folder: Path, first: float, last: float) -> Path:
    """A slider-crank whose bed is as stiff as it is heavy, by a table."""
    plain = json.loads(invoke("machines", "slider-crank", "--json").stdout)
    heads = [f"{sensor['name']} {force} {part} [{unit}]" for sensor in plain["sensors"] for part in ("re", "im")
             for force, unit in (("fx", "m/s2/N"), ("fy", "m/s2/N"), ("moment", "m/s2/(N m)"))]  # fmt: skip
    rows = [["frequency [Hz]", *heads], *([f"{hertz}", *["0.5"] * len(heads)] for hertz in (first, last))]
    (folder / "bed.csv").write_text("\n".join(map(",".join, rows)))
    file = folder / "m.json"
    file.write_text(json.dumps(plain | {"response": {"file": "bed.csv"}}))
    return file


def test_machines_of_files(tmp_path: Path) -> None:
    """As they are; and with all in place that a service finds nowhere else."""
    file = with_response(tmp_path, 5.0, 9000.0)
    assert invoke("machines", str(file)).stdout == file.read_text()
    whole = json.loads(invoke("machines", str(file), "--json").stdout)
    assert whole["response"]["frequency"] == [5.0, 9000.0]
    assert parse_machine(whole).content_key == load_machine(file).content_key


def test_check_says_and_draws_the_band_of_a_response(tmp_path: Path) -> None:
    file = str(with_response(tmp_path, 5.0, 9000.0))
    known = "response known from 5 to 9000 Hz, orders 0.5 to 900 of the drive; sample rates to 22500 Hz"
    assert f"frequency {known}\n" in invoke("check", file).stdout
    shown = invoke("check", file, "--json", "--response", str(tmp_path / "r.svg"))
    assert json.loads(shown.stdout)["frequency_response"] == known
    assert json.loads(shown.stdout)["response_drawing"] == str(tmp_path / "r.svg")
    assert (tmp_path / "r.svg").read_text().rstrip().endswith("</svg>")
    late = str(with_response(tmp_path, 12.0, 9000.0))
    shown = invoke("check", late, "--response", str(tmp_path / "r.png"))
    assert "it does not go down to the drive's 10 Hz" in shown.stdout
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")
    assert_refused(invoke("check", "slider-crank", "--response", "r.png"), 2, "its file gives no frequency response")
    assert_refused(invoke("check", file, "--response", "r.txt"), 2, "must end in .png, .svg or .pdf")


def test_check_shows_the_sizes_of_the_model() -> None:
    shown = invoke("check", "quick-return", "--fault", "A=0.2mm").stdout
    assert "F = 6, of which 5 are integrated" in shown
    assert "3N + 2J = 32 unknowns" in shown
    row = next(line.split() for line in shown.splitlines() if line.startswith("A "))
    assert row[-2:] == ["200", "um"]
    document = json.loads(invoke("check", "quick-return", "--fault", "A=0.2mm", "--json").stdout)
    assert document["degrees_of_freedom"] == 6
    assert document["fault_um"] == {"A": pytest.approx(200)}
    assert document["mechanism_matrix"]["rows"][2][1] == "C"
    assert document["unknowns_3n_2j"] == 32
    kept = len(document["coordinates"]) + len(document["closures"])
    assert kept + sum(out["unknowns"] for out in document["left_out"]) == 32
    assert "arrays" not in document["mechanism_matrix"]


def test_check_shows_a_link_driven_in_space_and_ground_that_moves(tmp_path: Path) -> None:
    tree = json.loads(invoke("machines", "slider-crank", "--json").stdout)
    foot = {"kind": "mount", "link": "frame", "at": [0, 0], "stiffness": [1e5, 1e5]}
    tree["supports"][0]["motion"] = [{"displacement": [0, 2e-5], "order": 2}, {"over_time": [[0, 0, 0]]}]
    tree["supports"].append({**foot, "motion": [{"displacement": ["1 mm", 0], "frequency": "12 Hz"}]})
    path = tmp_path / "m.json"
    path.write_text(json.dumps(tree))
    (line,) = (line for line in invoke("check", path).stdout.splitlines() if line.startswith("ground"))
    first, last = "supports.0, mount on frame: ", "supports.2, mount on frame: (1e+03, 0) um at 12 Hz"
    assert line == f"ground moves under {first}(0, 20) um at order 2; {first}by a table; {last}"
    assert json.loads(invoke("check", path, "--json").stdout)["ground_motion"][2] == last
    tree["drive"], tree["supports"] = {"kind": "position", "link": "frame", "direction": [0, 1], "speed": 0.1}, []
    path.write_text(json.dumps(tree))
    assert "; drive: frame along y at 0.1 m/s; fault: healthy" in invoke("check", path).stdout


def test_a_matrix_is_shown_and_simulated_as_its_file_gives_it(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "machine-file.md").read_text(encoding="utf-8")
    (given,) = re.findall(r"```yaml\n(name: slider-crank\nmatrix:.*?)```", page, re.DOTALL)
    path = tmp_path / "m.yaml"
    path.write_text(f"{given}drive: {{kind: rotation, joint: O, speed: 300 rpm}}\n")
    shown = invoke("check", path).stdout
    assert shown.splitlines()[0].endswith("; fault: A=0.2mm, as the file gives it")
    assert [line.split()[1:] for line in shown.splitlines()[-4:]] == [
        line.split() for line in given.splitlines()[2:6]
    ]  # fmt: skip
    healthy = json.loads(invoke("check", path, "--fault", "healthy", "--json").stdout)
    assert (healthy["fault_um"], healthy["mechanism_matrix"]["rows"][1]) == ({}, ["B", "0", "B", "0"])
    short = ("--duration", "20 ms", "-o", tmp_path / "out.h5")
    assert "note" not in invoke("simulate", path, *short).stdout
    assert read_arrays(tmp_path / "out.h5")[1]["fault"] == "A=0.2mm"
    assert "note: without the clearance that the file gives A\n" in invoke(
        "simulate", path, "--fault", "healthy", *short
    ).stdout  # fmt: skip
    path.write_text(path.read_text().replace(', clearance: "0.2 mm"', ""))
    for command in (("check", path), ("simulate", path, *short)):
        assert_refused(invoke(*command), 2, 'matrix.1.2: -C: needs its amount, joints.3-2.clearance, as in "0.2 mm"')


def test_check_shows_a_single_sprung_body_as_a_matrix_of_one_entry(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    mount = "{kind: mount, link: block, at: [0, 0], stiffness: [2.0e+4, 4.0e+4], damping: [20, 0]}"
    path.write_text(
        f"name: m\nmatrix: 2/1\nlinks: {{block: {{mass: 4, inertia: 0.1, cg: [0, 0]}}}}\nsupports: [{mount}]\n"
    )
    document = json.loads(invoke("check", path, "--arrays", "--json").stdout)
    matrix = document["mechanism_matrix"]
    assert (matrix["rows"], matrix["arrays"]["NSP"], matrix["arrays"]["NDP"]) == ([["2/1"]], 2, 1)
    assert (document["unknowns_3n_2j"], document["degrees_of_freedom"]) == (3, 3)


def test_check_shows_play_as_new_and_limits(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    at_a = "at: [0.05, 0.05], pin: rod"
    text = invoke("machines", "slider-crank").stdout
    path.write_text(text.replace(at_a, f"{at_a}, fit: H7/g6, limit: 0.1 mm"))
    rows = {line.split()[0]: line for line in invoke("check", path).stdout.splitlines() if " turning  " in line}
    assert rows["A"].endswith("3 to 17.5 um (H7/g6 at 16 mm)  100 um (given)    -")
    assert rows["B"].endswith("3 to 20 um (default)           200 um (default)  -")
    joints = json.loads(invoke("check", path, "--json").stdout)["joints"]
    assert set(joints) == {"O", "A", "B"}
    assert joints["A"] == {
        "fit": "H7/g6 at 16 mm", "play_as_new_um": [3.0, 17.5], "limit": "given", "worn_out_from_um": 100.0,
    }  # fmt: skip
    assert joints["O"] == {
        "fit": "default", "play_as_new_um": [3.0, 20.0], "limit": "default", "worn_out_from_um": 200.0,
    }  # fmt: skip
    path.write_text(text.replace(at_a, f"{at_a}, fit: H7/k6"))
    refused = invoke("check", path)
    assert refused.exit_code == 2
    assert "joints.A.fit: H7/k6: is no clearance fit" in refused.stderr


def test_check_shows_the_arrays_of_the_matrix() -> None:
    arguments = ["check", "quick-return", "--fault", "A=0.2mm", "--arrays"]
    shown = invoke(*arguments).stdout
    assert "N = 6, NSP = 4, NDP = 4" in shown
    assert [line.split() for line in shown.splitlines() if line.startswith("  1  frame")] == [
        ["1", "frame", "2", "1", "3", "2", "0", "1", "3"],
        ["1", "frame", "2", "4", "6", "2", "4", "6", "2", "4", "6", "2", "4", "6"],
    ]
    arrays = json.loads(invoke(*arguments, "--json").stdout)["mechanism_matrix"]["arrays"]
    assert (arrays["N"], arrays["NSP"], arrays["NDP"]) == (6, 4, 4)
    assert arrays["NTC"] == [0, 1, 0, 0, 0, 0]
    assert arrays["JTC"] == [[0] * 6, [3] + [0] * 5, *[[0] * 6] * 4]
    assert (arrays["xi"][1], arrays["n"][2][1], arrays["s"][5][0]) == ([0, None, 1, None, None, None], 1, 1)


def test_check_says_how_near_a_change_point_the_machine_comes(tmp_path: Path) -> None:
    path = tmp_path / "near.json"
    path.write_text(four_bar(0.06, 0.12, 0.14 + 1e-6, 0.20, 1.0).model_dump_json())
    note = (
        "the machine comes within 1 um of a change point at a drive angle of 122.7 deg: links that are off by as much"
    )
    assert f"note: {note}" in invoke("check", path).stdout
    assert json.loads(invoke("check", path, "--json").stdout)["notes"][0].startswith(note)
    path.write_text(four_bar(0.06, 0.12, 0.14 - 1e-6, 0.20, 1.0).model_dump_json())
    assert "at a drive angle of 122.3 deg: a little further joint B stays 1 um open" in invoke("check", path).stderr


def test_check_says_where_a_contact_law_returns_another_restitution(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    contact = "{law: lankarani-nikravesh, stiffness: 6.6e10, restitution: 0.5}"
    at_a = "at: [0.05, 0.05], pin: rod"
    path.write_text(invoke("machines", "slider-crank").stdout.replace(at_a, f"{at_a}, contact: {contact}"))
    note = "joint A: contact law lankarani-nikravesh asked for a restitution of 0.5 returns 0.725"
    assert invoke("check", path).stdout.endswith(f"note: {note}\n")
    assert json.loads(invoke("check", path, "--json").stdout)["notes"][-1] == note
    assert json.loads(invoke("check", "four-bar", "--json").stdout)["notes"] == []
    short = ("--duration", "20 ms", "-o", tmp_path / "out.npz")
    assert f"note: {note}\n" in invoke("simulate", path, "--fault", "A=0.1mm", *short).stdout
    assert "note" not in invoke("simulate", path, "--fault", "B=0.1mm", *short).stdout


@pytest.mark.parametrize("name", ["machine.svg", "machine.png", "machine.pdf"])
def test_check_draws(name: str, tmp_path: Path) -> None:
    result = invoke("check", "slider-crank", "--fault", "B=0.1mm", "--drawing", tmp_path / name)
    assert result.exit_code == 0
    content = (tmp_path / name).read_bytes()
    assert content.startswith({"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}[name[-3:]])


def test_paper_and_page_have_the_same_drawing() -> None:
    """What the one has as lines, discs and texts, the other has at the same places."""
    picture = draw_machine(shipped_machine("quick-return"))
    (axes,) = paint(picture).axes
    marks = [mark for group in picture.groups for mark in group.marks]
    assert len(axes.patches) == len(marks)
    assert (axes.get_xlim(), axes.get_ylim()) == (
        (picture.box[0], picture.box[0] + picture.box[2]),
        (picture.box[1] + picture.box[3], picture.box[1]),  # y down
    )
    places = {text.get_text(): text.get_position() for text in axes.texts}
    assert places == {label.text: label.middle for label in picture.labels}
    discs = [patch.center for patch in axes.patches if isinstance(patch, Circle)]
    assert discs == [mark.points[0] for mark in marks if mark.radius]


STUCK = """name: stuck
links:
  bed: {fixed: true}
  crank: {mass: 1, inertia: 0.01, cg: [0, 0.06]}
  coupler: {mass: 1, inertia: 0.01, cg: [0.1, 0.1]}
  rocker: {mass: 1, inertia: 0.01, cg: [0.2, 0.06]}
joints:
  O: {kind: turning, links: [crank, bed], at: [0, 0]}
  A: {kind: turning, links: [coupler, crank], at: [0, 0.12]}
  B: {kind: turning, links: [coupler, rocker], at: [0.2, 0.12]}
  D: {kind: turning, links: [rocker, bed], at: [0.2, 0]}
drive: {kind: rotation, joint: O, speed: 60 rpm}
"""


def test_three_cranks_drawn_in_one_line_are_refused_in_one_line(tmp_path: Path) -> None:
    text = shipped_machine_text("parallel-cranks")
    for drawn, level in (
        ("[0.02, 0.034641016]", "[0.04, 0.0]"),
        ("[0.36, 0.034641016]", "[0.38, 0.0]"),
        ("[0.19, 0.254641016]", "[0.21, 0.22]"),
    ):
        assert drawn in text
        text = text.replace(drawn, level)
    file, drawing = tmp_path / "level.yaml", tmp_path / "level.svg"
    file.write_text(text)
    result = invoke("check", file, "--drawing", drawing)
    assert result.exit_code == 2 and "<svg" in drawing.read_text()
    said = (
        "parallel-cranks: drive: links lie in one line in the drawn pose, from which nothing can be computed: draw it"
    )
    assert said in result.stderr and "unexpected" not in result.stderr


@pytest.mark.parametrize("ending", ["svg", "png"])
def test_check_draws_what_cannot_be_assembled(ending: str, tmp_path: Path) -> None:
    file, drawn = tmp_path / "stuck.yaml", tmp_path / f"stuck.{ending}"
    # A rocker shorter than the crank: it would have to go round, too, and cannot.
    file.write_text(STUCK.replace("B: {kind: turning, links: [coupler, rocker], at: [0.2, 0.12]}",
                                  "B: {kind: turning, links: [coupler, rocker], at: [0.2, 0.05]}"))  # fmt: skip
    result = invoke("check", file, "--drawing", drawn)
    assert result.exit_code == 2
    said = r"cannot be assembled at a drive angle of [\d.]+ deg: a little further joint [BD] stays"
    assert re.search(said, result.stderr)
    if ending == "svg":
        svg = drawn.read_text()
        assert svg.count('class="gap gap-') == 1
        assert re.search(r">[BD]: [\d.]+ mm open</text>", svg)
    else:
        red = imread(drawn)[..., :3] @ [1.0, -1.0, 0.0]
        assert (red > 0.5).sum() > 1000
    file.write_text("name: stuck\nlinks: 3\n")
    assert invoke("check", file, "--drawing", tmp_path / "none.svg").exit_code == 2
    assert not (tmp_path / "none.svg").exists()  # there is nothing to draw
