"""Verdicts as sentences."""

from __future__ import annotations

from typing import Any

import pytest
from answers import changed, diagnosis, hypothesis, joint

from jointplay.app import rows, words
from jointplay.app.figures.plots import draw_diagnosis
from jointplay.app.reports.content import inspection
from jointplay.catalogue.diagnosing.answer import Cause, Diagnosis, JointState


def result(verdict: str, *hypotheses: dict[str, Any], **more: Any) -> Diagnosis:
    return diagnosis(verdict=verdict, hypotheses=hypotheses, goodness_of_fit={"p_value": 0.004}, **more)


def cause(name: str, size: float, unit: str, probability: float) -> dict[str, Any]:
    return {"name": name, "size": size, "unit": unit, "probability": probability}


SOUND = {"A": joint("in_order", 9.0, 0.01), "B": joint("in_order", 12.0, 0.02, detectable_from_um=28.0)}
WORN = {"O": joint("worn", 463.0, 1.0, interval_um=[405, 528], p_over_limit=0.97), **SOUND}
SUGGESTION = {
    "kind": "sensor", "what": "s3-y", "hypotheses": ["A", "B"], "separation_now": 1.0, "separation": 3.0,
    "error_now": 0.2, "error": 0.03,
}  # fmt: skip
SWAPPED = {"sensors": ["s1-x", "s2-y"], "kind": "swapped", "said": "s1-x and s2-y seem to be swapped"}


def test_one_worn_joint() -> None:
    found = result("worn", hypothesis("O", 0.93, O=460), hypothesis("healthy", 0.07), joints=WORN)
    assert words.sentence(found) == "Joint O is worn: radial clearance 463 µm (90 %: 405 to 528), probability > 99 %."
    assert words.short(found) == "O worn"
    assert words.remarks(found) == [
        "O is beyond its limit of 200 µm, probability 97 %.",
        "No wear above: A 35, B 28 µm (95 %).",
        "Next: lock the drive out and measure the play of joint O across the pin.",
    ]


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ((), "press.csv"),
        (("press.csv, 477 rpm, 1.98 to 3.52 s", "press.csv, 599 rpm, 8.45 to 10.4 s"), "press.csv, 2 pieces"),
        (("press.csv", "other.csv"), "2 recordings"),
        (("press.csv, 477 rpm, 1.98 to 3.52 s", "press.csv, 599 rpm, 8.45 to 10.4 s", "other.csv"), "3 recordings"),
    ],
)
def test_what_was_recorded(names: tuple[str, ...], text: str) -> None:
    said = {"alone": "A", "p_alone": 0.9, "verdict": "worn", "weight": 0.7, "without": "A", "p_without": 0.9}
    share = {**said, "sha256": "0" * 64, "drive_speed_rpm": 480.0, "one_machine": 3.0, "contradicts": False}
    found = result("worn", joints=WORN, recordings=[{**share, "measurement": name} for name in names])
    assert "apart from the others" not in words.next_step(found)
    torn = result("worn", joints=WORN, recordings=[{**share, "measurement": "a.csv", "contradicts": True}])
    said = "Next: diagnose a.csv apart from the others: the machine was not the same in all."
    assert words.next_step(torn) == words.remarks(torn)[-1] == said
    assert words.recorded(found, "press.csv") == text


def test_how_a_recording_goes_with_the_others() -> None:
    share = {
        "measurement": "a.csv",
        "sha256": "0" * 64,
        "drive_speed_rpm": 480.0,
        "one_machine": 3.0,
        "verdict": "worn",
    }
    share |= {"alone": "A", "p_alone": 0.9, "weight": 0.7, "without": "A", "p_without": 0.9, "contradicts": False}
    others = [{}, {"held_shut": ["A", "B"]}, {"contradicts": True, "held_shut": ["A"]}, {"left_out": "it is spoiled"}]
    found = result("worn", joints=WORN, recordings=[{**share, **each} for each in others])
    said = ["agrees", "agrees if a load held A and B shut", "contradicts", "left out: it is spoiled"]
    assert [row.said for row in rows.recording_rows(found)] == said


def test_two_worn_joints() -> None:
    joints = {"A": joint("worn", 250.0, 0.97, p_over_limit=0.9), "C": joint("worn", 80.0, 0.96, p_over_limit=0.02)}
    found = result("worn", hypothesis("A+C", 0.8, A=250, C=80), joints=joints)
    assert words.sentence(found) == (
        "Joints A and C are worn: radial clearance A 250 µm (90 %: 225 to 275), probability 97 %; "
        "C 80 µm (90 %: 72 to 88), probability 96 %."
    )
    assert words.probability(found) == "96 %"
    assert words.remarks(found) == [
        "A is beyond its limit of 200 µm, probability 90 %. C is within its limit of 200 µm, probability 98 %.",
        "Next: lock the drive out and measure the play of joints A and C across the pin.",
    ]


@pytest.mark.parametrize(
    ("condition", "beyond", "text"),
    [
        ("worn", 0.45, "O may be beyond its limit of 200 µm, probability 45 %."),
        ("open", 0.3, "O may be beyond its limit of 200 µm, probability 30 %."),
        ("open", 0.1, ""),
        ("in_order", 0.0, ""),
    ],
)
def test_limits(condition: str, beyond: float, text: str) -> None:
    found = result("worn", joints={"O": joint(condition, 190.0, 0.9, p_over_limit=beyond)})
    assert words.limit_sentence(found) == text


def test_wear_of_which_the_joint_is_not_sure() -> None:
    joints = {"A": joint("open", 250.0, 0.7, p_over_limit=0.6), "C": joint("open", 80.0, 0.3)}
    found = result("worn", hypothesis("A", 0.7, A=250), hypothesis("C", 0.3, C=80), joints=joints)
    assert words.sentence(found) == (
        "Probably joint A is worn: radial clearance 250 µm (90 %: 225 to 275), probability 70 %."
    )
    assert words.short(found) == "A probably worn"
    assert list(words.named_joints(found)) == ["A"]
    joints["A"] = joint("open", 90.0, 0.7)  # of fit or wear; what is said is its size if it is worn
    assert "radial clearance 250 µm" in words.sentence(changed(found, joints=joints))


def test_two_joints_of_which_neither_is_sure() -> None:
    joints = {"A": joint("open", 240.0, 0.8), "C": joint("open", 9.0, 0.7)}
    found = result("worn", hypothesis("A+C", 0.8, A=250, C=8), joints=joints)
    assert words.sentence(found) == (
        "Probably joints A and C are worn: radial clearance A 250 µm (90 %: 225 to 275), probability 80 %; "
        "C 8.0 µm (90 %: 7.2 to 8.8), probability 70 %."
    )
    assert (words.short(found), words.probability(found)) == ("A+C probably worn", "70 %")


def test_rows_of_the_ranking() -> None:
    pair, sound = hypothesis("A+C", 0.8, A=250, C=8), hypothesis("healthy", 0.2)
    first, second = rows.hypothesis_rows(result("in_order", pair, sound, candidate_set=["A+C"]))
    assert (first.label, first.candidate, first.percent, first.distance) == ("A+C", True, "80 %", "1.0 dB")
    assert first.clearance == "A 250 µm (225 to 275); C 8.0 µm (7.2 to 8.8)"
    assert (second.label, second.candidate, second.clearance) == ("healthy", False, "")
    single = rows.hypothesis_rows(result("unknown", hypothesis("A", 0.9, A=250), sound), most=1)
    assert [row.clearance for row in single] == ["250 µm (225 to 275)"]


@pytest.mark.parametrize(
    ("bound", "interval", "text"),
    [
        ("none", [900.0, 1500.0], "1.2 mm (0.9 to 1.5)"),
        ("none", [0.901, 1860.0], "1200 µm (0.9 to 1860)"),
        ("at_least", [2000.0, 2000.0], "at least 2 mm"),
        ("at_least", [405.0, 2000.0], "at least 405 µm"),
        ("at_most", [3.0, 9.5], "at most 9.5 µm"),
    ],
)
def test_clearances_and_bounds(bound: str, interval: list[float], text: str) -> None:
    assert (
        rows.play_of(JointState.model_validate(joint("worn", 1200.0, 1.0, bound=bound, interval_um=interval))).say()
        == text
    )


def test_a_machine_in_order() -> None:
    found = result("in_order", hypothesis("healthy", 0.9), hypothesis("B", 0.1, B=20), joints=SOUND)
    assert words.sentence(found) == "Probably no worn joint: the recording fits a machine in order, probability 90 %."
    sure = changed(found, coverage=0.9)
    assert words.sentence(sure) == "No worn joint: the recording fits a machine in order, probability 90 %."
    assert words.short(found) == "in order"
    joints = {**SOUND, "B": joint("open", 40.0, 0.4, interval_um=[20, 60]), "E": joint("in_order", 9.0, 0.0)}
    joints["E"]["detectable_from_um"] = None
    open_joint = changed(found, joints=joints)
    assert words.sentence(open_joint).endswith("probability 90 %; joint B cannot be told.")
    assert words.seen_sentence(open_joint) == (
        "No wear above: A 35 µm (95 %). Wear of E would not have shown, however large the catalogue has it."
        " B: cannot be told (20 to 60 µm)."
    )
    assert words.next_step(open_joint) == "Next: measure again, longer or with more sensors, to tell joint B."
    wide = {**SOUND, "O": joint("in_order", 9.0, 0.0, detectable_from_um=1600.0)}
    assert words.seen_sentence(changed(found, joints=wide)) == "No wear above: A 35, B 28, O 1.6 mm (95 %)."
    assert words.remarks(sure) == ["No wear above: A 35, B 28 µm (95 %).", "Next: measure again at the usual interval."]
    assert words.next_step(changed(found, suggestions=[SUGGESTION])) == (
        "Next: measure with sensor s3-y as well, to tell A and B apart."
    )


def test_a_machine_that_has_changed() -> None:
    mount = cause("mount 1", 0.4, "x stiffness", 0.82)
    found = result("changed", hypothesis("healthy", 0.9), joints=SOUND, causes=[mount])
    assert words.sentence(found) == "Changed, but not by play: mount 1 at 0.4 times its stiffness, 82 %."
    assert (words.short(found), words.probability(found)) == ("changed: mount 1", "82 %")
    said = ["No wear above: A 35, B 28 µm (95 %).", "Next: look at this: mount 1; put it right, or the machine's file,"]
    assert words.remarks(found) == [said[0], f"{said[1]} and measure again."]
    load = cause("load", -150.0, "N", 0.12)
    assert words.remarks(changed(found, causes=[mount, load]))[:-2] == ["It may also be: load, −150 N, 12 %."]
    doubted = changed(found, joints={**SOUND, "O": joint("worn", 300.0, 0.96)})
    assert words.remarks(doubted)[:-2] == [
        "Whether there is wear in joint O as well is told with reserve: measure again when the change is put right."
    ]
    level = {"channel": "x", "low_order": 1.5, "high_order": 2.5, "difference_db": -1.84, "usual_db": 0.071}
    since = changed(found, past={"p_value": 0.0005, "changed": [level]})
    assert words.remarks(since)[:-2] == [
        "Beside the baseline, order 2 in x is off by −1.8 dB (usually 0.071 dB), p = 0.0005."
    ]
    band = {**level, "low_order": 20.5, "high_order": 25.5, "difference_db": 3.0}
    assert (
        "orders 21 to 25 in x is off by +3.0 dB"
        in words.remarks(changed(found, past={"p_value": 0.0005, "changed": [band]}))[0]
    )
    assert words.remarks(changed(found, past={"p_value": 0.5, "changed": []})) == words.remarks(found)
    nameless = changed(found, causes=[])
    assert words.sentence(nameless) == "Changed, but not by play; none of the known causes explains it."
    assert (words.short(nameless), words.probability(nameless)) == ("changed", "–")
    # What is likelier than not is not denied.
    likely = changed(nameless, hypotheses=[hypothesis("A", 0.88, A=200), hypothesis("healthy", 0.12)])
    assert words.sentence(likely) == "Changed, perhaps by play, 88 %; none of the known causes explains it."
    assert words.sentence(changed(likely, causes=[mount])) == words.sentence(found)
    assert inspection(likely)[1].startswith("It may be wear: measure again")
    assert inspection(nameless)[1].startswith("No joint is to be opened")


@pytest.mark.parametrize(
    ("name", "size", "unit", "text"),
    [
        ("all mounts", 0.5, "x stiffness", "all mounts at 0.5 times their stiffness"),
        ("mass of ram", 1.2, "x mass", "ram at 1.2 times its mass"),
        ("unbalance", 0.01234, "kg m", "unbalance, 0.0123 kg m"),
        ("ripple of the drive, order 6", 0.005, "rad", "ripple of the drive, order 6, 0.005 rad"),
    ],
)
def test_causes(name: str, size: float, unit: str, text: str) -> None:
    assert words.cause(Cause.model_validate(cause(name, size, unit, 0.5))) == text


def test_causes_and_sensors_beside_wear() -> None:
    found = result("worn", joints=WORN, causes=[cause("all mounts", 0.5, "x stiffness", 0.3)], sensors=[SWAPPED])
    assert words.remarks(found)[1:3] == [
        "Other than play, there may be a change: all mounts at 0.5 times their stiffness, 30 %.",
        "s1-x and s2-y seem to be swapped.",
    ]


def test_why_a_model_is_not_believed() -> None:
    doubted = diagnosis(mode={"asked": "auto", "used": "robust", "trusted_p_value": 0.004})
    assert words.mode_sentence(doubted) == (
        "The machine is taken to differ from its model (robust): "
        "as simulated it does not explain the recording, p = 0.004."
    )
    asked = diagnosis(mode={"asked": "robust", "used": "robust", "trusted_p_value": None})
    assert words.mode_sentence(asked) == "The machine is taken to differ from its model (robust)."


def test_what_was_held_likely() -> None:
    usual = {"worn": 0.75, "another": 0.6, "joints": {}, "numbers": [0.51, 0.306, 0.184]}
    assert words.prior_sentence(diagnosis(prior=usual)) == (
        "Before the recording: wear with 75 %, and then of joints at once 1 with 51 %, 2 with 31 % and 3 with 18 %."
    )
    own = {"worn": 0.5, "another": 1.0, "joints": {"A": 3.0, "B": 0.5}, "numbers": [0.5, 0.5]}
    assert words.prior_sentence(diagnosis(prior=own)) == (
        "Before the recording: wear with 50 %, and then of joints at once 1 with 50 % and 2 with 50 %; "
        "A 3 times as likely; B 0.5 times as likely."
    )


def test_a_widened_set_promises_nothing() -> None:
    found = result("worn", hypothesis("F", 0.6, F=20), candidate_set=["F"])
    assert words.set_sentence(found) == "Candidates, which hold the true cause in 95 % of cases: F."
    assert words.set_sentence(changed(found, widened=True)) == (
        "Candidates, from a set widened because the one for 95 % was empty: F."
    )


def test_nothing_known() -> None:
    found = result("unknown", hypothesis("F", 1.0, F=20))
    assert words.sentence(found) == (
        "No verdict: the recording fits none of the hypotheses of this catalogue, p = 0.004."
    )
    assert (words.short(found), words.probability(found)) == ("no verdict", "–")
    fit = {"p_value": 0.17}
    hypotheses = [hypothesis("F", 0.84, F=20), hypothesis("healthy", 0.16)]
    unsure = changed(found, goodness_of_fit=fit, candidate_set=["F", "healthy"], hypotheses=hypotheses)
    assert words.sentence(unsure) == (
        "No verdict: the machine is not as its file says, and neither wear (84 %) nor none is sure enough then."
    )
    assert words.set_sentence(unsure).endswith("none of them is sure enough.")
    flawed = changed(found, sensors=[SWAPPED], joints=WORN)
    assert rows.joint_rows(flawed) == []
    assert words.sentence(flawed) == "No verdict: s1-x and s2-y seem to be swapped."
    nothing = "Nothing is said of any joint: wear of any size may be behind such a recording."
    assert words.remarks(flawed) == [nothing, "Next: check s1-x and s2-y (cable, direction, scale), and measure again."]
    lost = changed(found, warnings=["clipped", "drive speed 606.3 rpm is far from the nominal 120 rpm"])
    assert words.remarks(lost) == [
        nothing,
        "Next: check the drive speed, and that this is the machine of the catalogue:"
        " drive speed 606.3 rpm is far from the nominal 120 rpm.",
    ]
    assert words.next_step(found) == (
        "Next: check that catalogue, machine, sensors (places, directions, units) and speed belong together;"
        " compare with a recording of the machine in order as a baseline."
    )
    assert "none of them explains the recording" in words.set_sentence(found)
    assert "what has changed is none of them" in words.set_sentence(changed(found, verdict="changed"))


BAND = {
    "order": 3.0, "low_hz": 25.0, "high_hz": 35.0, "channel": "x", "measured_db": -20.0, "predicted_db": -21.0,
    "spread_db": 1.0, "z": 1.0, "rival_db": -30.0, "favours_best": 4.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "decided"), [("worn", True), ("in_order", True), ("changed", False), ("unknown", False)]
)
def test_only_a_verdict_on_joints_colours_rings_and_fills(verdict: str, decided: bool) -> None:
    evidence = {"orders": [BAND], "bands": [], "rival": "B"}
    found = result(verdict, hypothesis("A", 0.8, A=200), hypothesis("B", 0.2, B=90), evidence=evidence, joints=WORN)
    found = changed(found, joint_probabilities={"A": 0.8, "B": 0.2})
    assert dict(rows.joint_colours(found)) == ({"A": 0.8, "B": 0.2} if decided else {})
    assert words.colour_sentence(found).startswith("The deeper" if decided else "No joint is coloured")
    ringed = rows.deciding(found, rows.comparisons(found))
    assert [band.order for _, band in ringed] == ([3.0] if decided else [])
    assert words.rings_sentence(found) == ("Rings: bands that decided for A and against B." if decided else "")
    drawn = draw_diagnosis(found, "a.csv")
    rings = [line for line in drawn.axes[1].lines if line.get_fillstyle() == "none" and len(line.get_xdata())]
    assert len(rings) == decided
    filled = [bar.get_facecolor()[3] > 0 for bar in drawn.axes[0].patches]
    assert filled == [decided, decided]


@pytest.mark.parametrize(
    ("probability", "text"),
    [(1.0, "> 99 %"), (0.996, "> 99 %"), (0.99, "99 %"), (0.5, "50 %"), (0.004, "< 1 %"), (0.0, "< 1 %")],
)
def test_nothing_is_certain(probability: float, text: str) -> None:
    assert rows.percent(probability) == text


@pytest.mark.parametrize(("value", "text"), [(2.0, "2"), (14.52, "14.5"), (1428.6, "1429"), (100.4, "100")])
def test_orders(value: float, text: str) -> None:
    assert rows.order(value) == text
