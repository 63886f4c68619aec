from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointplay.solver.errors import UnitError
from jointplay.solver.machines import units
from jointplay.solver.machines.units import to_si


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("0.2 mm", units.LENGTH, 0.0002),
        ("0.2mm", units.LENGTH, 0.0002),
        (" 5 µm ", units.LENGTH, 5e-6),
        ("5 μm", units.LENGTH, 5e-6),
        ("5 um", units.LENGTH, 5e-6),
        ("1 in", units.LENGTH, 0.0254),
        ("80 g", units.MASS, 0.08),
        ("1.0e-3 t", units.MASS, 1.0),
        ("20 ms", units.TIME, 0.02),
        ("2 min", units.TIME, 120.0),
        ("30 deg", units.ANGLE, math.pi / 6),
        ("-90°", units.ANGLE, -math.pi / 2),
        ("600 rpm", units.ANGULAR_SPEED, 20 * math.pi),
        ("600rpm", units.ANGULAR_SPEED, 20 * math.pi),
        ("10 rev/s", units.ANGULAR_SPEED, 20 * math.pi),
        ("360 deg/s", units.ANGULAR_SPEED, 2 * math.pi),
        ("1.5 Hz", units.FREQUENCY, 1.5),
        ("10 mm/s", units.SPEED, 0.01),
        ("3.6 km/h", units.SPEED, 1.0),
        ("9.81 m/s2", units.ACCELERATION, 9.81),
        ("9.81 m/s^2", units.ACCELERATION, 9.81),
        ("9.81 m/s²", units.ACCELERATION, 9.81),
        ("9.81 m s-2", units.ACCELERATION, 9.81),
        ("0.5 kN", units.FORCE, 500.0),
        ("5 N m", units.TORQUE, 5.0),
        ("5 N*m", units.TORQUE, 5.0),
        ("600 kg mm2", units.INERTIA, 6e-4),
        ("1 kg·m²", units.INERTIA, 1.0),
        ("4 N/mm", units.STIFFNESS, 4000.0),
        ("10 kN/mm", units.STIFFNESS, 1e7),
        ("300 N s/m", units.DAMPING, 300.0),
        ("300 N/(m/s)", units.DAMPING, 300.0),
        ("0.1 N m s/rad", units.ROTARY_DAMPING, 0.1),
        ("0.1 N m s", units.ROTARY_DAMPING, 0.1),
        ("5 %", units.RATIO, 0.05),
        ("0.05", units.RATIO, 0.05),
        ("1e7", units.STIFFNESS, 1e7),
    ],
)
def test_text_with_a_unit_becomes_si(text: str, dimension: units.Dimension, value: float) -> None:
    assert to_si(text, dimension) == pytest.approx(value, rel=1e-15)


def test_decimal_units_are_exact() -> None:
    assert to_si("100 kg mm2", units.INERTIA) == 1e-4
    assert to_si("0.3 mm", units.LENGTH) == 0.3e-3
    assert to_si("8 mm", units.LENGTH) == 0.008


def test_g_is_gram_or_gravity_by_what_is_expected() -> None:
    assert to_si("2 g", units.MASS) == 0.002
    assert to_si("2 g", units.ACCELERATION) == 2 * 9.80665
    assert to_si("2 g mm2", units.INERTIA) == 2e-9
    assert to_si("5 mg", units.ACCELERATION) == 5e-3 * 9.80665
    assert to_si("5 mg", units.MASS) == 5e-6


@pytest.mark.parametrize(
    ("value", "dimension", "message"),
    [
        ("2 kg", units.LENGTH, '"kg" is a mass, must be a length, for example "0.2 mm"'),
        ("30 deg", units.RATIO, '"deg" is an angle, must be a plain number, for example "0.05"'),
        ("10 Hz", units.ANGULAR_SPEED, '"Hz" is a frequency, must be a speed of rotation, for example "600 rpm"'),
        ("2 g", units.LENGTH, '"g" is a mass, must be a length, for example "0.2 mm"'),
        ("2 m3", units.LENGTH, '"m3" must be a length, for example "0.2 mm"'),
        ("2 MM", units.LENGTH, '"MM" is not a known unit; did you mean "mm"?'),
        ("2 RPM", units.ANGULAR_SPEED, '"RPM" is not a known unit; did you mean "rpm"?'),
        ("2 N/mmm", units.STIFFNESS, '"mmm" in "N/mmm" is not a known unit; did you mean "mm"?'),
        ("2 xyzzy", units.LENGTH, '"xyzzy" is not a known unit'),
        ("2 m/", units.LENGTH, '"m/" is not a unit'),
        ("2 (m", units.LENGTH, '"(m" is not a unit'),
        ("2 m)", units.LENGTH, '"m)" is not a unit'),
        ("2 m//s", units.SPEED, '"m//s" is not a unit'),
        ("2 m^99", units.LENGTH, '"m^99" is not a unit'),
        ("1,5 mm", units.LENGTH, "must use a point, not a comma, for decimals"),
        ("mm", units.LENGTH, 'must be a length: a number, or a number with a unit ("0.2 mm")'),
        ("", units.LENGTH, 'must be a length: a number, or a number with a unit ("0.2 mm")'),
        ("nan mm", units.LENGTH, 'must be a length: a number, or a number with a unit ("0.2 mm")'),
        ("1 " + "m" * 200, units.LENGTH, 'must be a length: a number, or a number with a unit ("0.2 mm")'),
        ("1e400 m", units.LENGTH, "must be finite"),
        ("1e308 km", units.LENGTH, "must be finite"),
        (math.nan, units.MASS, "must be finite"),
        (-math.inf, units.MASS, "must be finite"),
        (10**400, units.MASS, "must be finite"),
        (True, units.MASS, 'must be a number in kg or a string with a unit ("80 g")'),
        (None, units.MASS, 'must be a number in kg or a string with a unit ("80 g")'),
        ([1], units.MASS, 'must be a number in kg or a string with a unit ("80 g")'),
    ],
)
def test_refusals_say_what_was_expected(value: object, dimension: units.Dimension, message: str) -> None:
    with pytest.raises(UnitError) as caught:
        to_si(value, dimension)
    assert str(caught.value) == message


def test_a_vanishing_number_does_not_fill_the_memory() -> None:
    assert to_si("1e-999999999 mm", units.LENGTH) == 0.0


@pytest.mark.parametrize(
    ("value", "dimension", "message"),
    [
        ("600", units.ANGULAR_SPEED, "give a unit: 600rpm or 62.8rad/s?"),
        (600, units.ANGULAR_SPEED, "give a unit: 600rpm or 62.8rad/s?"),
        (" 6e2 ", units.ANGULAR_SPEED, "give a unit: 600rpm or 62.8rad/s?"),
        ("0.2", units.SPEED, "give a unit: 0.2m/s or 200mm/s?"),
        ("3 kg", units.ANGULAR_SPEED, '"kg" is a mass, must be a speed of rotation, for example "600 rpm"'),
    ],
)
def test_a_speed_says_what_it_is(value: object, dimension: units.Dimension, message: str) -> None:
    assert units.speed_to_si("62.8 rad/s") == 62.8 and units.speed_to_si("60 rad s-1") == 60.0
    with pytest.raises(UnitError) as caught:
        units.speed_to_si(value, dimension)
    assert str(caught.value) == message


def test_minus_zero_is_zero() -> None:
    assert math.copysign(1.0, to_si(-0.0, units.LENGTH)) == 1.0
    assert math.copysign(1.0, to_si("-0 mm", units.LENGTH)) == 1.0


@pytest.mark.parametrize("dimension", units.DIMENSIONS, ids=lambda dimension: dimension.name)
def test_every_dimension_reads_its_own_unit_and_example(dimension: units.Dimension) -> None:
    assert to_si(f"3 {dimension.unit}", dimension) == 3.0
    assert to_si(dimension.example, dimension) > 0


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e300, max_value=1e300))
def test_a_number_and_its_text_are_the_same(number: float) -> None:
    assert to_si(repr(number), units.LENGTH) == to_si(number, units.LENGTH) == to_si(f"{number!r} m", units.LENGTH)


@given(st.text(max_size=30))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    try:
        number, message = to_si(text, units.LENGTH), ""
    except UnitError as error:
        number, message = 0.0, str(error)
    assert math.isfinite(number)
    assert len(message.splitlines()) <= 1
