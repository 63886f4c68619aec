"""A recording without the moments that are not the machine's: drop-outs, clipping, shocks from outside."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import SpeedTrack, rough_track
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.measurements.waveform import find_clipped
from jointplay.catalogue.signals.disturbances import (
    Disturbance,
    DisturbanceKind,
    find_shocks,
    patch,
    stretches_of,
)
from jointplay.catalogue.signals.feature_bands import usable_cuts
from jointplay.catalogue.signals.hum import Cleaned, remove_hum
from jointplay.catalogue.signals.sensors import SensorMap
from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.spectra.band_power import WINDOW_REVOLUTIONS, BandMatrix, band_matrix
from jointplay.solver.spectra.bands import BandScheme

Tracking = Callable[[FloatArray], SpeedTrack]

#: What goes with a dropped or clipped sample on either side [s]: filters ring.
MARGIN = 0.001
#: Disturbances of a kind closer than this [s] are one.
TOGETHER = 0.05
#: Where there is one shock, others are looked for that stand out by this much less: of ten recordings with shocks the
#: loudest window was up to 11 dB above the median one in orders 20 to 400, and then up to 2 dB.
WEAKER = 0.5
#: Lines and patches are found in turns so many times more.
TURNS = 2
#: Windows without any disturbance are enough where there are so many, and so large a share of all.
LEAST_WINDOWS = 4
LEAST_SHARE = 0.25
#: Names of the kinds in a warning.
TOLD: dict[DisturbanceKind, str] = {"shock": "shock from outside", "drop-out": "drop-out", "clipping": "clipping"}
#: So many of a kind are told by their times.
LISTED = 5


@dataclass(frozen=True, eq=False)
class Undisturbed:
    """A signal without disturbances.

    Parameters
    ----------
    signal : (n, c) array
    track : SpeedTrack
        Course of the speed.
    disturbances : tuple of Disturbance
    left_out : float
        Share of the samples that others stand for.
    warnings : tuple of str
        One line a kind.
    raw : (n, c) array
        The signal as it was, what dropped out filled with the median.
    bad : (n,) array of bool
        Samples that others stand for.
    """

    signal: FloatArray
    track: SpeedTrack
    raw: FloatArray
    bad: BoolArray
    disturbances: tuple[Disturbance, ...] = ()
    left_out: float = 0.0
    warnings: tuple[str, ...] = ()


def find_flawed(measurement: Recording, sensing: SensorMap) -> dict[DisturbanceKind, BoolArray]:
    """Samples (n, c) of the used columns that dropped out or were clipped, with what goes with them.

    Parameters
    ----------
    measurement : Recording
    sensing : SensorMap

    Returns
    -------
    dict of kind to array
    """
    names = measurement.channel_names
    shape = (len(measurement.signal), len(sensing.columns))
    found: dict[DisturbanceKind, BoolArray] = {
        "drop-out": np.zeros(shape, dtype=bool),
        "clipping": np.zeros(shape, dtype=bool),
    }
    reach = max(1, round(MARGIN * measurement.sample_rate))
    for place, column in enumerate(sensing.columns):
        kinds = {flaw.kind for flaw in measurement.flaws if flaw.channel == names[column]}
        for flaw in measurement.flaws:
            if flaw.channel == names[column] and flaw.kind == "dropout":
                found["drop-out"][max(0, flaw.first - reach) : flaw.last + reach, place] = True
        if "clipped" in kinds:
            clipped = find_clipped(measurement.signal[:, column], measurement.sample_rate)
            for first, last in stretches_of(clipped):
                found["clipping"][max(0, first - reach) : last + reach, place] = True
    return found


def remove_disturbances(
    signal: FloatArray,
    sample_rate: float,
    flawed: dict[DisturbanceKind, BoolArray],
    tracking: Tracking,
    about: float,
    sensing: SensorMap,
    source: str,
    start: float,
) -> Undisturbed:
    """Leave out what is not the machine's.

    Parameters
    ----------
    signal : (n, c) array
    sample_rate : float
        Hz.
    flawed : dict of kind to (n, c) array of bool
        What is known to be missing, see :func:`find_flawed`.
    tracking : callable
        Finds the course of the speed in a signal.
    about : float
        About the speed of the drive [rad/s].
    sensing : SensorMap
        Names the columns.
    source : str
        What messages call the recording.
    start : float
        When the signal begins in the recording [s].

    Returns
    -------
    Undisturbed

    Raises
    ------
    MeasurementError
        No speed is found, or no revolution is whole where one is disturbed.
    """
    missing = np.any([mask.any(axis=1) for mask in flawed.values()], axis=0)
    filled = signal
    if flawed["drop-out"].any():
        filled = np.where(flawed["drop-out"], np.median(signal, axis=0), signal)
    try:
        track = tracking(filled)
    except MeasurementError:
        rough = rough_track(filled, sample_rate, about)
        if rough is None:
            raise
        blows = missing | find_shocks(filled, sample_rate, rough, missing)
        track = tracking(patch(filled, sample_rate, rough, blows)[0])
    shocks = find_shocks(filled, sample_rate, track, missing)
    if shocks.any():
        found = missing | shocks
        without = patch(filled, sample_rate, track, found)[0]
        shocks |= find_shocks(without, sample_rate, track, found, WEAKER)
    bad = missing | shocks
    if not bad.any():
        return Undisturbed(signal, track, signal, bad)
    rest, left = patch(filled, sample_rate, track, bad)
    if (left & flawed["drop-out"].any(axis=1)).any() or (left & shocks).any():
        rule = f"{100 * bad.mean():.2g} % of it are shocks, drop-outs or clipped, the same angles in every revolution"
        raise MeasurementError(source, rule=f"{rule}: too little is left")
    bad &= ~left
    masks = {**flawed, "shock": np.repeat(shocks[:, None], signal.shape[1], axis=1)}
    disturbances, warnings = [], []
    for kind, mask in masks.items():
        alike = _of_kind(kind, mask & ~left[:, None], sample_rate, sensing, start)
        disturbances += alike
        if alike:
            warnings.append(_describe(kind, alike, float((mask.any(axis=1) & ~left).mean())))
    return Undisturbed(
        signal=rest,
        track=tracking(rest),
        raw=filled,
        bad=bad,
        disturbances=tuple(sorted(disturbances, key=lambda each: each.begin)),
        left_out=float(bad.mean()),
        warnings=tuple(warnings),
    )


def without_lines(rest: Undisturbed, sample_rate: float) -> Cleaned:
    """Take steady lines out of a signal without disturbances.

    They keep no phase against the drive, so that what stands for a disturbance must be taken from where they are out
    already: lines and patches are found in turns.

    Parameters
    ----------
    rest : Undisturbed
    sample_rate : float
        Hz.

    Returns
    -------
    Cleaned
    """
    found = remove_hum(rest.signal, sample_rate, rest.track)
    if not rest.bad.any():
        return found
    signal = rest.signal
    for _ in range(TURNS):
        if not found.lines:
            break
        lines = signal - found.signal
        signal = patch(rest.raw - lines, sample_rate, rest.track, rest.bad)[0] + lines
        found = remove_hum(signal, sample_rate, rest.track)
    return found


def lines_of(cleaned: Cleaned, begin: float, end: float) -> tuple[Disturbance, ...]:
    """Return steady lines that were taken out between two times [s] as disturbances."""
    found = []
    for line in cleaned.lines:
        of = (
            f"multiple {round(line.frequency / line.mains)} of mains hum"
            if line.mains
            else "no multiple of the drive's"
        )
        text = f"steady line at {line.frequency:.2f} Hz, {of}: taken out"
        found.append(Disturbance("line", text, begin, end, frequency=line.frequency))
    return tuple(found)


def band_power_without(
    signal: FloatArray, bad: BoolArray, sample_rate: float, speed: float, scheme: BandScheme, sensing: SensorMap
) -> BandMatrix:
    """Band powers of a signal, of windows without any disturbance where there are enough of them.

    What stands for a disturbance is as good as another revolution where the machine is loud, but no better than a
    hundredth of that where it is silent.

    Parameters
    ----------
    signal : (n, c) array
        With other revolutions in place of what was disturbed.
    bad : (n,) array of bool
        Samples that others stand for.
    sample_rate : float
        Hz.
    speed : float
        Of the drive [rad/s].
    scheme : BandScheme
    sensing : SensorMap
    """
    derivatives = sensing.derivatives if any(sensing.derivatives) else None

    cuts = usable_cuts(scheme, speed, sample_rate)

    def of(first: int, last: int) -> BandMatrix:
        return band_matrix(
            signal[first:last],
            sample_rate,
            speed,
            scheme,
            channels=sensing.sensors,
            derivatives=derivatives,
            cuts=cuts,
            angle=speed * first / sample_rate,
        )

    whole = of(0, len(signal))
    if not bad.any():
        return whole
    window = 1.001 * WINDOW_REVOLUTIONS * 2.0 * math.pi / speed * sample_rate
    parts = [of(first, last) for first, last in stretches_of(~bad) if last - first > window]
    count = sum(part.segments for part in parts)
    if count < max(LEAST_WINDOWS, LEAST_SHARE * whole.segments):
        freedom = np.maximum(2.0, float(1.0 - bad.mean()) * whole.degrees_of_freedom)
        return dataclasses.replace(whole, degrees_of_freedom=freedom)
    weight = np.array([part.segments for part in parts]) / count
    return dataclasses.replace(
        whole,
        power=np.tensordot(weight, [part.power for part in parts], axes=1),
        cyclic=np.tensordot(weight, [part.cyclic for part in parts], axes=1),
        segments=count,
        degrees_of_freedom=np.sum([part.degrees_of_freedom for part in parts], axis=0),
    )


def _of_kind(
    kind: DisturbanceKind, mask: BoolArray, sample_rate: float, sensing: SensorMap, start: float
) -> list[Disturbance]:
    """Stretches of a kind, those close together as one."""
    together: list[list[int]] = []
    for first, last in stretches_of(np.asarray(mask.any(axis=1))):
        if together and first - together[-1][1] < TOGETHER * sample_rate:
            together[-1][1] = last
        else:
            together.append([first, last])
    found = []
    for first, last in together:
        hit = np.flatnonzero(mask[first:last].any(axis=0))
        sensors = () if len(hit) == mask.shape[1] else tuple(sensing.sensors[index] for index in hit)
        begin, end = start + first / sample_rate, start + last / sample_rate
        where = f" of {', '.join(sensors)}" if sensors else ""
        text = f"{TOLD[kind]}{where} from {begin:.4g} to {end:.4g} s"
        found.append(Disturbance(kind, text, begin, end, sensors))
    return found


def _describe(kind: DisturbanceKind, alike: list[Disturbance], share: float) -> str:
    sensors = sorted({sensor for each in alike for sensor in each.sensors})
    where = f" of {', '.join(sensors)}" if sensors else ""
    times = ", ".join(f"{each.begin:.3g}" for each in alike[:LISTED]) + (" ..." if len(alike) > LISTED else "")
    count = f"{len(alike)} times, " if len(alike) > 1 else ""
    return f"{TOLD[kind]}{where} {count}at {times} s: {100 * share:.2g} % of the time left out"
