"""From a recording to what is compared: one recipe, whose steps are named, ordered and kept with the result."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import (
    SEARCH_RANGE,
    SpeedEstimate,
    SpeedTrack,
    doubt_speed,
    likeliest_speed,
    track_speed,
)
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.measurements.tacho import track_of, usual_speed
from jointplay.catalogue.plans.driving import nominal_drive_speed
from jointplay.catalogue.signals.feature_bands import USABLE, usable_cuts
from jointplay.catalogue.signals.hum import SteadyLine, hum_in_orders
from jointplay.catalogue.signals.noise import NoiseFloor, noise_floor
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.recipe_steps import RecipeStep, note_step
from jointplay.catalogue.signals.sensor_flaws import SensorContradiction, find_sensor_flaws
from jointplay.catalogue.signals.sensors import SensorMap, map_sensors, without_columns
from jointplay.catalogue.signals.spectrum_features import prepare_spectrum
from jointplay.catalogue.signals.steadiness import (
    KEPT,
    LEVEL_DEVIATION_DB,
    SPEED_DEVIATION,
    WANDER,
    at_mean_speed,
    samples_at_mean_speed,
    steady_stretch,
)
from jointplay.catalogue.signals.undisturbed import (
    band_power_without,
    find_flawed,
    lines_of,
    remove_disturbances,
    without_lines,
)
from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.band_power import HOP_REVOLUTIONS, WINDOW_REVOLUTIONS
from jointplay.solver.spectra.bands import FEATURE_ORDERS, BandScheme

#: Revolutions below which a recording is refused, and warned of.
MIN_REVOLUTIONS = 3.0
FEW_REVOLUTIONS = 10.0
#: Factor on the noise power of compared channels, as it follows from independent sensors, from which on they are not
#: taken to be independent (0.5 dB; chance makes a tenth of one).
ALIKE = 1.12
#: Wander, relative, that is warned of: the course is followed, but a machine that turns so unevenly is hardly steady.
MUCH_WANDER = 0.015

#: A sensor that the others can do without is left out when more of its time has dropped out, or when it is clipped in
#: more of its revolutions.
MUCH_DROPPED = 0.1
MUCH_CLIPPED = 0.25

#: Difference of a given speed from the one in the recording, relative, up to which they agree.
GIVEN_AGREES = 0.005


def prepare(
    measurement: Recording | MeasuredSpectrum,
    machine: Machine,
    mapping: Mapping[str, str] | None = None,
    speed: float | None = None,
    scheme: BandScheme | None = None,
    nominal: float | None = None,
    near: Sequence[float] = (),
) -> PreparedMeasurement:
    """Make a recording ready to be compared.

    Parameters
    ----------
    measurement : Recording or MeasuredSpectrum
    machine : Machine
        Gives sensors, frame and nominal drive speed.
    mapping : mapping of column to sensor, optional
    speed : float, optional
        Mean drive speed [rad/s] where it is known; estimated otherwise.
    scheme : BandScheme, optional
        The catalogue's; the default is that of the machine's nominal speed.
    nominal : float, optional
        Nominal drive speed [rad/s] of the catalogue; the default is the machine's, which a motor has to be run for.
    near : sequence of float, optional
        Drive speeds [rad/s] that the catalogue has, where there are several: a recording is looked for about the one
        whose orders stand out most.

    Returns
    -------
    PreparedMeasurement

    Raises
    ------
    MeasurementError
        No column matches a sensor, the recording is shorter than three revolutions, does not reach order 20, or its
        speed cannot be found.
    """
    nominal = nominal or nominal_drive_speed(machine)
    if isinstance(measurement, MeasuredSpectrum):
        turned = nominal if speed is not None else _nearest_of(measurement, machine, mapping, nominal, near)
        return prepare_spectrum(measurement, machine, mapping, speed, scheme, turned)
    rate = measurement.sample_rate
    if speed is not None and not (abs(speed) > 0 and math.isfinite(speed)):
        raise MeasurementError(measurement.name, value=speed, rule="drive speed must be finite and not zero")
    by_pulses = measurement.turns if speed is None else None
    expected = speed or (nominal if by_pulses is None else usual_speed(by_pulses, rate))
    several = near if speed is None and by_pulses is None and len(near) > 1 else ()
    fastest = max(map(abs, several), default=expected)
    _refuse_short(measurement.name, measurement.duration, fastest, allowance=0.1 if speed is None else 0.0)

    sensing, sensor_step = _sensors(measurement, machine, mapping, expected)
    if several:
        found = likeliest_speed(measurement.signal[:, list(sensing.columns)], rate, several)
        nominal = expected = found or nominal
    elif by_pulses is not None and near:
        nominal = min(near, key=lambda each: abs(math.log(expected / abs(each))))
    warnings = [*measurement.warnings, *sensing.warnings]
    first, last, part_step, unsteady = _steady_part(measurement, sensing, expected)
    doubt: list[str] = []

    def tracking(signal: FloatArray) -> SpeedTrack:
        nonlocal doubt
        if by_pulses is not None:
            return track_of(by_pulses, rate, first, last, measurement.name)
        track, doubt = _track(signal, rate, nominal, speed, measurement.name)
        return track

    flawed = {kind: mask[first:last] for kind, mask in find_flawed(measurement, sensing).items()}
    raw = measurement.signal[first:last, list(sensing.columns)]
    rest = remove_disturbances(raw, rate, flawed, tracking, expected, sensing, measurement.name, first / rate)
    signal, track = rest.signal, rest.track
    if any(each.kind == "shock" for each in rest.disturbances):
        unsteady = [line for line in unsteady if not line.endswith(KEPT)]
    estimate = track.estimate
    warnings += [*unsteady, *doubt, *rest.warnings]
    revolutions = _refuse_short(measurement.name, (1.0 - rest.left_out) * len(signal) / rate, estimate.speed)
    turn = estimate.speed / (2.0 * math.pi)
    if USABLE * rate < (FEATURE_ORDERS + 0.5) * turn:
        least = math.ceil((FEATURE_ORDERS + 0.5) * turn / USABLE)
        rule = f"sample rate {rate:g} Hz: does not reach order {FEATURE_ORDERS} of a drive at {turn:.4g} Hz"
        rule += f": must be {least} Hz or more"
        raise MeasurementError(measurement.name, rule=rule)

    cleaned = without_lines(rest, rate)
    wander = float(np.max(np.abs(track.speed / track.speed.mean() - 1.0)))
    floor = noise_floor(cleaned.signal, rate, measurement.name, turn=turn, wander=wander)
    resampled = wander > WANDER
    even = at_mean_speed(cleaned.signal, rate, track) if resampled else cleaned.signal
    scheme = scheme or BandScheme.for_drive(nominal)
    bad = samples_at_mean_speed(rest.bad, rate, track) if resampled else rest.bad
    bands = band_power_without(even, bad, rate, estimate.speed, scheme, sensing)
    edges = scheme.edges_hz(estimate.speed)
    cuts = usable_cuts(scheme, estimate.speed, rate)
    flaws = find_sensor_flaws(sensing, bands, floor)
    warnings += [flaw.text for flaw in flaws]
    if round(revolutions) < FEW_REVOLUTIONS:
        warnings.append(f"only {revolutions:.1f} revolutions: results are less certain below {FEW_REVOLUTIONS:g}")
    warnings += doubt_speed(estimate, signal, rate, nominal)
    if wander > MUCH_WANDER:
        warnings.append(f"drive speed wanders by {100 * wander:.2g} %: results are less certain")
    if cuts[-1] < scheme.count:
        warnings.append(
            f"sample rate {rate:g} Hz: bands above {edges[cuts[-1]]:.4g} Hz are not compared"
            f" (the catalogue goes to {edges[-1]:.4g} Hz)"
        )
    steps = (
        sensor_step,
        part_step,
        note_step("disturbances", found="; ".join(rest.warnings) or "none found"),
        note_step(
            "drive speed",
            parameters={"search_range": SEARCH_RANGE},
            found=_speed_note(estimate, wander),
        ),
        note_step("hum", found=_lines_note(cleaned.lines)),
        note_step("noise floor", found=_floor_note(floor, sensing)),
        note_step(
            "angular resampling",
            parameters={"from_wander": WANDER},
            found=f"wander {100 * wander:.2g} %: " + ("sampled anew at the mean speed" if resampled else "not needed"),
        ),
        note_step(
            "bands",
            parameters={"window_revolutions": WINDOW_REVOLUTIONS, "hop_revolutions": HOP_REVOLUTIONS},
            found=f"{bands.segments} windows; {', '.join(sensing.compared)} in {len(cuts) - 1} bands"
            f" up to {edges[cuts[-1]]:.4g} Hz",
        ),
        note_step("sensors checked", found=_flaws_note(flaws, sensing)),
    )
    notes = [*measurement.import_report, steps[3].found]
    notes += [
        f"steady line at {line.frequency:.2f} Hz taken out, amplitude up to {line.amplitude.max():.2g}"
        for line in cleaned.lines
    ]
    derivatives = np.array(sensing.derivatives)
    hum = hum_in_orders(
        turn,
        len(signal) / rate,
        [
            dataclasses.replace(line, amplitude=line.amplitude * (2.0 * math.pi * line.frequency) ** derivatives)
            for line in cleaned.lines
        ],
    )
    notes += [
        f"mains hum at {order * turn:.4g} Hz cannot be told from order {order}: up to {amplitude:.2g} m/s2 of it are"
        " taken to be hum"
        for order, amplitude in hum.items()
        if order <= FEATURE_ORDERS
    ]
    noise = floor.band_power(edges, sensing.derivatives) @ (sensing.channels**2).T
    if len(set(sensing.derivatives)) == 1:
        # Vibration from elsewhere moves the whole frame: it is alike in all sensors, and does not average out.
        alike = noise_floor(cleaned.signal @ sensing.channels.T, rate, measurement.name, turn=turn, wander=wander)
        power = alike.band_power(edges, sensing.derivatives[:1] * len(sensing.channels))
        noise = np.where(power > ALIKE * noise, power, noise)
    return PreparedMeasurement(
        name=measurement.name,
        sensing=sensing,
        speed=estimate,
        revolutions=revolutions,
        sensor_bands=bands,
        noise_power=noise,
        floor=floor,
        lines=cleaned.lines,
        cuts=cuts,
        warnings=tuple(warnings),
        notes=tuple(notes),
        steps=steps,
        flaws=flaws,
        disturbances=(*rest.disturbances, *lines_of(cleaned, first / rate, last / rate)),
        left_out=rest.left_out,
        hum_power=_hum_power(hum, edges / turn),
    )


def _hum_power(hum: Mapping[int, float], edges: FloatArray) -> FloatArray:
    """Power (B,) that hum of some amplitudes [m/s2], by order, has in bands between edges [orders]."""
    power = np.zeros(len(edges) - 1)
    for order, amplitude in hum.items():
        band = int(np.searchsorted(edges, order)) - 1
        if 0 <= band < len(power):
            power[band] += 0.5 * amplitude**2
    return power


def _sensors(
    measurement: Recording, machine: Machine, mapping: Mapping[str, str] | None, speed: float
) -> tuple[SensorMap, RecipeStep]:
    """Sensors to be used: those mostly clipped or missing for long are left out where the others see as much."""
    sensing = map_sensors(measurement, machine, mapping)
    names = measurement.channel_names
    left_out: list[int] = []
    flawed = find_flawed(measurement, sensing)
    # What all have lost is not won back by doing without one of them.
    alone = flawed["drop-out"] & ~flawed["drop-out"].all(axis=1, keepdims=True)
    share = {
        column: max(
            float(alone[:, place].mean()) / MUCH_DROPPED,
            _share_of_revolutions(flawed["clipping"][:, place], measurement.sample_rate, speed) / MUCH_CLIPPED,
        )
        for place, column in enumerate(sensing.columns)
    }
    for column in sensing.columns:
        if share[column] > 1.0:
            without = without_columns(sensing, machine, [column])
            if without is not None:
                sensing, left_out = without, [*left_out, column]
    found = f"columns {', '.join(names[column] for column in sensing.columns)} as {', '.join(sensing.sensors)}"
    if left_out:
        text = f"left out, as the others see as much of the frame: {', '.join(names[column] for column in left_out)}"
        sensing = dataclasses.replace(sensing, warnings=(*sensing.warnings, text))
        found += f"; {text}"
    return sensing, note_step("sensors", parameters={"compared": ", ".join(sensing.compared)}, found=found)


def _steady_part(measurement: Recording, sensing: SensorMap, speed: float) -> tuple[int, int, RecipeStep, list[str]]:
    """Samples to be used: the steady part; and what there is to say."""
    raw = measurement.signal[:, list(sensing.columns)]
    dropped = find_flawed(measurement, sensing)["drop-out"]
    if dropped.any():
        raw = np.where(dropped, np.median(raw, axis=0), raw)
    rate = measurement.sample_rate
    stretch = steady_stretch(raw, rate, speed)
    findings = list(stretch.findings)
    first, last = stretch.first, stretch.last
    step = note_step(
        "steady part",
        parameters={"speed_deviation": SPEED_DEVIATION, "level_deviation_db": LEVEL_DEVIATION_DB},
        found="; ".join([f"{first / rate:.4g} to {last / rate:.4g} s of {measurement.duration:.4g} s", *findings]),
    )
    return first, last, step, findings


def _share_of_revolutions(mask: BoolArray, rate: float, speed: float) -> float:
    """Share of the revolutions that hold any of some samples."""
    turn = abs(speed) / (2.0 * math.pi * rate)
    hit = np.unique(np.floor(np.flatnonzero(mask) * turn))
    return float(len(hit) / max(1.0, len(mask) * turn))


def _speed_note(estimate: SpeedEstimate, wander: float) -> str:
    rpm = estimate.speed * 30.0 / math.pi
    if estimate.given:
        return f"drive speed {rpm:.6g} rpm, as given"
    share = 100 * estimate.uncertainty / estimate.speed
    return f"drive speed {rpm:.6g} rpm +- {share:.2g} %, found in the recording; wander {100 * wander:.2g} %"


def _lines_note(lines: tuple[SteadyLine, ...]) -> str:
    return "taken out: " + (", ".join(f"{line.frequency:.2f} Hz" for line in lines) or "none found")


def _floor_note(floor: NoiseFloor, sensing: SensorMap) -> str:
    rms = ", ".join(f"{value:.2g}" for value in floor.rms)
    text = f"rms to half the sample rate {rms}, white"
    if floor.coloured:
        standing = [
            f"{name} {low:.4g} to {high:.4g} Hz +{10 * math.log10(factor):.0f} dB"
            for name, row in zip(sensing.sensors, floor.excess, strict=True)
            for low, high, factor in zip(floor.edges[:-1], floor.edges[1:], row, strict=True)
            if factor > 1.0
        ]
        text += f" but for {', '.join(standing)}"
    return text


def _flaws_note(flaws: tuple[SensorContradiction, ...], sensing: SensorMap) -> str:
    if flaws:
        return "; ".join(flaw.text for flaw in flaws)
    if np.linalg.matrix_rank(sensing.transform) < len(sensing.sensors):
        return "agree as parts of one rigid frame"
    return "no more than the motions they see: nothing to check them by"


def _nearest_of(
    spectrum: MeasuredSpectrum,
    machine: Machine,
    mapping: Mapping[str, str] | None,
    nominal: float,
    near: Sequence[float],
) -> float:
    """The first of some drive speeds, from the nominal one on, about which a spectrum has orders; else the nominal."""
    for speed in sorted(near, key=lambda each: abs(math.log(abs(each / nominal)))):
        try:
            prepare_spectrum(spectrum, machine, mapping, None, None, speed)
        except MeasurementError:
            continue
        return speed
    return nominal


def _refuse_short(name: str, duration: float, speed: float, allowance: float = 0.0) -> float:
    """Revolutions in so many seconds; refused when there are less than three even with the allowance."""
    revolutions = duration * abs(speed) / (2.0 * math.pi)
    if revolutions * (1.0 + allowance) < MIN_REVOLUTIONS:
        rule = f"{duration:.4g} s are {revolutions:.2f} revolutions; at least {MIN_REVOLUTIONS:g} are needed"
        raise MeasurementError(name, rule=rule)
    return revolutions


def _track(
    signal: FloatArray, rate: float, nominal: float, speed: float | None, source: str
) -> tuple[SpeedTrack, list[str]]:
    """Course of the speed, and what makes a given one doubtful.

    A given mean is kept; its course still tells hum from orders, where one can be found.
    """
    if speed is None:
        return track_speed(signal, rate, nominal, source), []
    given = SpeedEstimate(abs(speed), 0.0, True)
    steady = SpeedTrack(np.array([0.0]), np.array([abs(speed)]), given)
    try:
        track = track_speed(signal, rate, speed, source)
    except MeasurementError:
        return steady, []
    found = track.estimate.speed
    if abs(found / abs(speed) - 1.0) > GIVEN_AGREES:
        told, seen = (each * 30.0 / math.pi for each in (abs(speed), found))
        return steady, [f"drive speed {told:.5g} rpm is given, but the orders in the recording are of {seen:.5g} rpm"]
    return dataclasses.replace(track, estimate=given), []
