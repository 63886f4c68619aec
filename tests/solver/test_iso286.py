"""Tables of ISO 286 against values as they are published."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointplay.solver.machines.fields import RuleError
from jointplay.solver.machines.fits import FitClass, ToleranceClass

HOLES, SHAFTS, GRADES = "DEFGH", "defgh", range(5, 12)
diameters = st.floats(1e-3, 0.5)
grades = st.sampled_from(GRADES)


def deviations(name: str, millimetres: float) -> tuple[int, int]:
    return ToleranceClass(name[0], int(name[1:])).deviations(millimetres * 1e-3)


@pytest.mark.parametrize(
    ("millimetres", "name", "lower", "upper"),
    [
        # holes, as in ISO 286-2
        (3, "H7", 0, 10), (6, "H8", 0, 18), (10, "H6", 0, 9), (16, "H7", 0, 18), (25, "H7", 0, 21), (50, "H7", 0, 25),
        (80, "H7", 0, 30), (100, "H8", 0, 54), (120, "H11", 0, 220), (200, "H9", 0, 115), (300, "H10", 0, 210),
        (400, "H7", 0, 57), (500, "H5", 0, 27), (25, "F8", 20, 53), (40, "G7", 9, 34), (20, "E9", 40, 92),
        (30, "D10", 65, 149), (25, "F7", 20, 41),
        # shafts, as in ISO 286-2
        (3, "g6", -8, -2), (10, "f7", -28, -13), (16, "f7", -34, -16), (25, "g6", -20, -7), (25, "h6", -13, 0),
        (50, "f7", -50, -25), (10, "e8", -47, -25), (80, "d9", -174, -100), (40, "h9", -62, 0), (100, "e8", -126, -72),
        (100, "g6", -34, -12), (200, "f7", -96, -50), (250, "d9", -285, -170), (400, "g6", -54, -18),
        (500, "f7", -131, -68), (500, "d11", -630, -230), (6, "d9", -60, -30), (30, "f7", -41, -20),
    ],
)  # fmt: skip
def test_published_deviations(millimetres: float, name: str, lower: int, upper: int) -> None:
    assert deviations(name, millimetres) == (lower, upper)


@pytest.mark.parametrize(
    ("millimetres", "name", "least", "greatest"),
    [
        (25, "H7/g6", 7, 41), (25, "H7/h6", 0, 34), (50, "H8/f7", 25, 89), (80, "H9/d9", 100, 248),
        (16, "H7/g6", 6, 35), (25, "G7/h6", 7, 41), (50, "F8/h7", 25, 89), (100, "H11/h11", 0, 440),
    ],
)  # fmt: skip
def test_published_clearances(millimetres: float, name: str, least: int, greatest: int) -> None:
    assert FitClass.parse(name).clearance(millimetres * 1e-3) == (least, greatest)


@pytest.mark.parametrize("step", [3, 6, 10, 18, 30, 50, 80, 120, 180, 250, 315, 400])
def test_a_step_ends_with_its_size(step: int) -> None:
    for size in (step * 1e-3, 2 * (step / 2000), step / 1000):
        assert deviations("H7", step) == ToleranceClass("H", 7).deviations(size)
    assert deviations("H7", step)[1] < deviations("H7", step * 1.0001)[1]


@given(diameters, st.sampled_from(HOLES), grades, st.sampled_from(SHAFTS), grades)
def test_every_class_is_a_clearance_fit_wider_with_its_grades(d: float, hole: str, i: int, shaft: str, j: int) -> None:
    fit = FitClass.parse(f"{hole}{i}/{shaft}{j}")
    least, greatest = fit.clearance(d)
    assert 0 <= least < greatest
    assert (least == 0) == (str(fit).translate({ord(digit): None for digit in "0123456789"}) == "H/h")
    for coarser in (f"{hole}{i + 1}/{shaft}{j}", f"{hole}{i}/{shaft}{j + 1}"):
        if max(i, j) < GRADES[-1]:
            other = FitClass.parse(coarser).clearance(d)
            assert other[0] == least
            assert other[1] > greatest
    assert FitClass.parse(str(fit)) == fit


@given(diameters, diameters, st.sampled_from(HOLES), grades, st.sampled_from(SHAFTS), grades)
def test_larger_pins_have_no_less_play(d: float, e: float, hole: str, i: int, shaft: str, j: int) -> None:
    fit = FitClass.parse(f"{hole}{i}/{shaft}{j}")
    small, large = fit.clearance(min(d, e)), fit.clearance(max(d, e))
    assert small[0] <= large[0]
    assert small[1] <= large[1]


@given(diameters, st.sampled_from("EFG"), grades, grades)
def test_shaft_basis_mirrors_hole_basis(d: float, letter: str, i: int, j: int) -> None:
    turned = FitClass.parse(f"H{i}/{letter.lower()}{j}").clearance(d)
    assert FitClass.parse(f"{letter}{j}/h{i}").clearance(d) == turned


TIGHT = "is no clearance fit: the pin can be larger than its hole, and the joint would not turn"


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        *((f"H7/{shaft}6", TIGHT) for shaft in ("js", "j", "k", "m", "n", "p", "s", "u", "zc")),
        *((f"{hole}7/h6", TIGHT) for hole in ("JS", "K", "N", "P", "ZC")),
        ("K7/k6", TIGHT),
        ("H11/c11", "c is not known here, only d to h; give the range [low, high] of radial clearance"),
        ("C11/h11", "C is not known here, only D to H; give the range [low, high] of radial clearance"),
        ("F8/k6", "k is not known here, only d to h; give the range [low, high] of radial clearance"),
        ("H7/g4", "grade 4 is not known here, only 5 to 11; give the range [low, high] of radial clearance"),
        ("H12/g6", "grade 12 is not known here, only 5 to 11; give the range [low, high] of radial clearance"),
        ("H7/q6", "q is no letter of ISO 286"),
        ("g6/H7", 'must have the hole first, in capitals, then the shaft, in small letters, as in "H7/g6"'),
        ("H7/G6", 'must have the hole first, in capitals, then the shaft, in small letters, as in "H7/g6"'),
        ("H7", 'is no fit class of ISO 286; write hole/shaft, as in "H7/g6"'),
        ("H7-g6", 'is no fit class of ISO 286; write hole/shaft, as in "H7/g6"'),
    ],
)
def test_what_is_no_class_is_refused(text: str, rule: str) -> None:
    with pytest.raises(RuleError) as caught:
        FitClass.parse(text)
    assert caught.value.message() == rule


@pytest.mark.parametrize("millimetres", [500.001, 16000, 0])
def test_sizes_outside_the_tables_are_refused(millimetres: float) -> None:
    with pytest.raises(RuleError, match="known here for pins of up to 500 mm, this one has"):
        deviations("H7", millimetres)
