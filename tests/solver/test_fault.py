"""Fault states: what they are and how they are written."""

from __future__ import annotations

import pytest

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import HEALTHY, Fault, parse_fault
from jointplay.solver.machines.machine import shipped_machine

QR = shipped_machine("quick-return")


@pytest.mark.parametrize(
    ("text", "clearances"),
    [
        ("", {}),
        ("healthy", {}),
        ("A=0.2mm", {"A": 2e-4}),
        (" F = 50 um , A=1e-4 ", {"A": 1e-4, "F": 5e-5}),
        ("A=0", {}),
    ],
)
def test_reading(text: str, clearances: dict[str, float]) -> None:
    assert parse_fault(text, QR) == Fault(clearances)


def test_writing_reads_back() -> None:
    fault = Fault({"F": 2.125e-4, "A": 1.23456e-5})
    assert fault.label == "A=0.0123456mm,F=0.2125mm"
    assert parse_fault(fault.label, QR) == fault
    assert HEALTHY.label == "healthy"
    assert parse_fault(HEALTHY.label, QR) == HEALTHY


def test_value() -> None:
    assert Fault({"B": 1e-4, "A": 2e-4}) == Fault({"A": 2e-4, "B": 1e-4, "C": 0.0})
    assert hash(Fault({"A": 1e-4})) == hash(Fault({"A": 1e-4}))
    assert Fault({"B": 1e-4, "A": 2e-4}).joints == ("A", "B")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "G1=0.1mm",
            "quick-return: joints.G1.length: is missing: clearance of sliding joint G1 tilts its block by its length",
        ),
        ("a=0.1mm", 'quick-return: fault.a: 0.1 mm: no such joint; did you mean "A"?'),
        ("A=0.2", "quick-return: fault.A: 0.2: is 200 mm without a unit; write 0.2mm if that is meant, or the unit"),
        ("A=-1mm", "quick-return: fault.A: -1mm: must not be less than 0"),
        ("A", "quick-return: fault: A: write JOINT=CLEARANCE, as in A=0.2mm"),
        ("A=1mm,A=2mm", "quick-return: fault.A: 2mm: this joint is named twice"),
        ("A=1kg", 'quick-return: fault.A: 1kg: "kg" is a mass, must be a length, for example "0.2 mm"'),
        ("A=nan", 'quick-return: fault.A: nan: must be a length: a number, or a number with a unit ("0.2 mm")'),
    ],
)  # fmt: skip
def test_refusals(text: str, line: str) -> None:
    with pytest.raises(MachineError) as refusal:
        parse_fault(text, QR)
    assert str(refusal.value) == line


@pytest.mark.parametrize("value", [-1e-6, float("nan"), float("inf")])
def test_impossible_clearances(value: float) -> None:
    with pytest.raises(MachineError, match="finite number of metres, 0 or more"):
        Fault({"A": value})
