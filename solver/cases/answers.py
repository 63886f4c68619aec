"""What sensors answer by a measured frequency response of the frame.

A decoupled frame moves by M q'' + C q' + K q = w, so its simulated motion says what wrench w the machine exerts on it,
without aliases and without noise. Sensors answer with H w, H the response. M, C and K, the file's, cancel.
"""

from __future__ import annotations

import math

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.steps import Suspension
from jointplay.solver.equations.drive import drive_rates
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.response import FrequencyResponse
from jointplay.solver.spectra.sampling import PASS

MOTIONS = ("x", "y", "theta")


def wrench_on_frame(
    suspension: Suspension, displacement: FloatArray, velocity: FloatArray, acceleration: FloatArray, sample_rate: float
) -> FloatArray:
    """Wrench (n, 3) of the machine on its decoupled frame about its centre of gravity, N and N m, but for a constant.

    Parameters
    ----------
    suspension : Suspension
        M, -C and -K by which its frame was moved.
    displacement, velocity, acceleration : (n, 3) arrays
        Of the frame, the latter band-limited. The others may have no rows: then this is one period of it.
    sample_rate : float
        Hz.
    """
    free = [MOTIONS.index(motion) for motion in suspension.motions]
    stiffness, damping = (-part for part in suspension.gradients)
    wrench = np.zeros_like(acceleration)
    if len(displacement):
        parts = ((suspension.mass, acceleration), (damping, velocity), (stiffness, displacement))
        wrench[:, free] = sum(motion[:, free] @ matrix.T for matrix, motion in parts)
        return wrench
    lines = np.fft.rfft(acceleration[:, free], axis=0)[1:]
    frequency: FloatArray = np.arange(1.0, len(lines) + 1.0) * (sample_rate / len(acceleration))
    forces = suspension.apparent_mass(frequency) @ lines[:, :, None]
    wrench[:, free] = np.fft.irfft(np.pad(forces[:, :, 0], ((1, 0), (0, 0))), len(acceleration), axis=0)
    return wrench


def answers_of(machine: Machine, wrench: FloatArray, sample_rate: float, *, steady: int, speed: float) -> FloatArray:
    """Accelerations (n, s) of a machine's sensors, in the order of its file, m/s2.

    What is steady counts as periodic, whole revolutions of it, and its orders are answered to exactly. What is before,
    and all where nothing repeats, is filtered as a run that begins at rest.

    Parameters
    ----------
    machine : Machine
        With a frequency response.
    wrench : (n, 3) array
        On its frame, N and N m, band-limited.
    sample_rate : float
        Hz.
    steady : int
        First sample after the transient.
    speed : float
        What revolutions are counted by, rad/s; 0 where nothing repeats.
    """
    count, revolution = len(wrench), 2 * math.pi * sample_rate / abs(speed) if speed else math.inf
    revolutions = math.floor((count - steady) / revolution + 1e-6)
    if steady == 0 and revolutions:
        found = np.zeros((count, len(machine.sensors)))
    else:
        assert machine.response is not None
        more = math.ceil(2 * sample_rate / spacing_of(machine.response))
        found = _filtered(machine, wrench, sample_rate, count + more)[:count]
    if revolutions:
        # So many that samples miss whole revolutions by the least part.
        miss = [abs(n * revolution - round(n * revolution)) for n in range(revolutions, revolutions // 2, -1)]
        length = round((revolutions - int(np.argmin(np.round(miss, 6)))) * revolution)
        periodic = _filtered(machine, wrench[count - length :], sample_rate, length)
        found[steady:] = periodic[np.arange(steady - count, 0) % length]
    return found


def _filtered(machine: Machine, wrench: FloatArray, sample_rate: float, count: int) -> FloatArray:
    """Answers (count, s) to a wrench (n, 3) with its mean after it, which begins again after `count` samples."""
    assert machine.response is not None
    lines = np.fft.rfft(wrench - wrench.mean(axis=0), count, axis=0)
    frequency = np.arange(len(lines), dtype=np.float64) * (sample_rate / count)
    names = tuple(sensor.name for sensor in machine.sensors)
    found = np.squeeze(_continued(machine.response, names, frequency) @ lines[:, :, None], -1)
    fade = np.clip((0.5 * sample_rate - frequency) / ((0.5 - PASS) * sample_rate), 0.0, 1.0)
    found *= np.sin(0.5 * np.pi * fade)[:, None] ** 2
    return np.asarray(np.fft.irfft(found, count, axis=0))


def spacing_of(response: FrequencyResponse) -> float:
    """Least distance of its lines, Hz: one over what was recorded for it, in which its answers have died away."""
    return float(np.diff(response.frequency).min())


def _continued(response: FrequencyResponse, names: tuple[str, ...], frequency: FloatArray) -> ComplexArray:
    """A response (f, s, 3) beyond its band, so that its ends do not ring: below as a frame on springs, above as is."""
    first, last = response.frequency[0], response.frequency[-1]
    found = response.accelerances(names, np.clip(frequency, first, last))
    below = np.minimum(frequency / first, 1.0) ** 2 if first else np.ones_like(frequency)
    return np.asarray(found * below[:, None, None])


def check_band(machine: Machine, sample_rate: float, speed: float) -> None:
    """Refuse to ask a response for what it does not say.

    Parameters
    ----------
    machine : Machine
    sample_rate : float
        Hz.
    speed : float
        What revolutions are counted by, rad/s.
    """
    response = machine.response
    assert response is not None
    first, last = response.frequency[0], response.frequency[-1]
    drive = abs(speed) / (2 * math.pi)
    if drive and first > drive * (1 + 1e-9):
        rule = f"must not be above {drive:.6g} Hz, the frequency of the drive"
        raise MachineError(machine.name, "response.frequency.0", f"{first:.6g} Hz", rule)
    if last < PASS * sample_rate * (1 - 1e-9):
        rule = f"the response of {machine.name} ends at {last:.6g} Hz; take {last / PASS:.6g} Hz or less"
        raise SettingsError(f"sample rate: {sample_rate:.6g} Hz: spectra go to {PASS * sample_rate:.6g} Hz, and {rule}")


def say_band(machine: Machine) -> str:
    """Return where a machine's frequency response is known, and what runs may ask of it, in one clause."""
    assert machine.response is not None
    first, last = machine.response.frequency[0], machine.response.frequency[-1]
    drive = abs(drive_rates(machine, {})[0]) / (2 * math.pi)
    orders = f", orders {first / drive:.3g} to {last / drive:.4g} of the drive" if drive else ""
    missing = f", but it does not go down to the drive's {drive:.4g} Hz" if first > drive * (1 + 1e-9) > 0 else ""
    return f"response known from {first:g} to {last:g} Hz{orders}; sample rates to {last / PASS:.6g} Hz{missing}"
