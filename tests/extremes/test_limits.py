"""Limits that several runs show together: vanishing clearance, and a run-up through a resonance."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from laws import Array, run, tree_of
from scipy.integrate import solve_ivp

from jointplay.solver.cases.history import History
from jointplay.solver.machines.machine import parse_machine, shipped_machine


def harmonics(history: History) -> Array:
    """Amplitudes (20, 3) of the frame's acceleration at the first orders of 10 Hz, over five revolutions from 0.1 s."""
    start, samples = (round(t * history.sample_rate) for t in (0.1, 0.5))
    steady = history.band_limited_acceleration[start : start + samples]
    return np.asarray(np.abs(np.fft.rfft(steady, axis=0))[5 * np.arange(1, 21)] * 2 / samples)


@pytest.mark.parametrize("joints", ["B", "OAB"])
def test_spectra_tend_to_those_of_the_ideal_joint(joints: str) -> None:
    """Clearance to 0, stiffness to infinity, restitution kept: motion and spectra come nearer with every decade.

    The frame (20 kg) gives way by a tenth of the clearance of one joint, by half of it of all three. From 1e-4 m on
    the spectrum's distance falls with the clearance: a factor of seven at least for each ten.
    """
    settings = {"duration": 0.6, "sample_rate": 5000, "rtol": 1e-8}
    ideal, _ = run(shipped_machine("slider-crank"), {}, **settings)
    levels = harmonics(ideal)
    distance, spectrum = [], []
    for decade in range(5):
        clearance, stiffness = 1e-4 / 10**decade, 1e7 * 10**decade
        machine = parse_machine(tree_of("slider-crank", stiffness=stiffness, damping=300 * 10 ** (decade / 2)))
        worn, _ = run(machine, dict.fromkeys(joints, clearance), **settings)
        distance.append(np.abs(worn.displacement - ideal.displacement).max())
        spectrum.append((np.abs(harmonics(worn) - levels).max(axis=0) / levels.max(axis=0)).max())
    assert all(near < 0.15 * far for far, near in itertools.pairwise(distance))
    assert all(near < 0.15 * far for far, near in itertools.pairwise(spectrum))
    assert distance[-1] < 1e-8


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_a_run_up_through_the_resonance(method: str) -> None:
    """An unbalanced crank on a frame that moves only in y: one linear equation, solved by SciPy's DOP853.

    (M + m) y'' + c y' + k y = -(M + m) g - m d2/dt2 (r sin a(t)), from rest to 30 Hz in 3 s through 15.7 Hz.
    """
    tree = {
        "name": "unbalance",
        "links": {
            "bed": {"mass": 40.0, "inertia": 1.0, "cg": [0, 0], "locked": ["x", "theta"]},
            "rotor": {"mass": 1.0, "inertia": 1e-3, "cg": [0.01, 0]},
        },
        "joints": {"O": {"kind": "turning", "links": ["rotor", "bed"], "at": [0, 0]}},
        "drive": {"kind": "rotation", "joint": "O", "speed": [[0, 0], [3, 60 * np.pi]]},
        "supports": [{"kind": "mount", "link": "bed", "at": [0, 0], "stiffness": [0, 4e5], "damping": [0, 120]}],
    }
    history, _ = run(parse_machine(tree), {}, duration=3.0, sample_rate=1000, method=method)
    rate = 20 * np.pi

    def slope(t: float, y: Array) -> list[float]:
        angle, speed = rate * t * t / 2, rate * t
        push = -0.01 * (rate * np.cos(angle) - speed**2 * np.sin(angle))
        return [y[1], (push - 4e5 * y[0] - 120 * y[1]) / 41 - 9.81]

    exact = solve_ivp(slope, (0, 3), [0, 0], "DOP853", history.t, rtol=1e-12, atol=1e-15).y[0]
    peak = history.t[np.abs(exact).argmax()]
    assert 15.7 < rate * peak / (2 * np.pi) < 18  # a little after the natural frequency
    swing = np.abs(exact + 41 * 9.81 / 4e5)
    assert swing.max() > 3 * swing[-200:].max()
    # Measured 1.6e-11 m (adaptive) and 9e-14 m (gill) of 4.4 mm.
    assert np.abs(history.displacement[:, 1] - exact).max() < (5e-11 if method == "adaptive" else 1e-12)
