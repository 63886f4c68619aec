"""Levels of the low orders as sensors of unknown gain see them, and how they scatter in machines that are in order."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.signals.feature_bands import join_bands
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.cross_power import unpack
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import AnyComplexArray, BoolArray, FloatArray, IntArray
from jointplay.solver.spectra.bands import FEATURE_ORDERS, LEAST_POWER

#: Decibels of a relative change of power by one.
DECIBELS = 10.0 / np.log(10.0)
#: Standard deviation of the logarithm of a sensor's gain, before anything was measured.
GAIN_SCATTER = 0.03
#: What a level of a model is not better known to than [dB]: two simulators that share no code agree to 0.2 to 0.5 dB
#: on the low orders of healthy machines, gains aside.
MODEL_DB = 0.4
#: A level counts where the signal has this many times the power of the noise,
LEAST_SIGNAL = 4.0
#: where the play of fits shifts it by no more than this, and scatters no more than this [dB].
MOST_SHIFT_DB = 3.0
MOST_SCATTER_DB = 2.0
#: and not this much below the strongest of its channel [dB]: what is left of an order there says more of play, of a
#: sensor's angle and of how evenly the drive turns than of the frame.
WEAKEST_DB = 40.0
#: Fewest entries that say how a machine in order scatters.
LEAST_ENTRIES = 20
#: Parts of the entries, each judged by what the others scatter.
FOLDS = 4


@dataclass(frozen=True, eq=False)
class OrderLevels:
    """Levels of orders 1 to 20 of a recording: of its sensors, and of the frame's motions where these see them all.

    The motions follow from the sensors, but a gain that is off mixes them, so both are compared. Where more bands are
    asked for, third octaves follow.

    Parameters
    ----------
    prepared : PreparedMeasurement
    measured : (m,) array
        dB, noise included; band by band, the channels of a band side by side.
    noise : (m,) array
        Power of the recording's noise.
    cells : (m,) array
        Independent cells the noise was averaged over: half its degrees of freedom.
    bands : int
        Feature bands, the first 20 of which are the orders.
    """

    prepared: PreparedMeasurement
    measured: FloatArray
    noise: FloatArray
    cells: FloatArray
    bands: int = FEATURE_ORDERS

    @classmethod
    def of(cls, prepared: PreparedMeasurement, count: int = FEATURE_ORDERS) -> OrderLevels:
        """Levels of a recording in its first so many feature bands."""
        sensing, bands, cuts = prepared.sensing, prepared.sensor_bands, prepared.cuts[: count + 1]
        edges = bands.scheme.edges_hz(prepared.drive_speed)[list(cuts)]
        own = prepared.floor.band_power(edges, sensing.derivatives)
        noise = np.hstack([own, join_bands(prepared.noise_power, cuts)]) if sensing.rigid_body else own
        power = np.add.reduceat(bands.power[: cuts[-1]], cuts[:-1], axis=0)
        if prepared.hum_power is not None:
            # What may be hum counts as noise, as if there were so much in any case.
            hum, own_view = join_bands(prepared.hum_power[:, None], cuts)[:, 0], np.eye(power.shape[-1])
            views = np.vstack([own_view, sensing.channels]) if sensing.rigid_body else own_view
            power = power + hum[:, None, None] * own_view
            noise = noise + np.outer(hum, np.sum(views**2, axis=1))
        seen = [np.diagonal(power, axis1=-2, axis2=-1).real]
        if sensing.rigid_body:
            seen.append(np.einsum("ci,bij,cj->bc", sensing.channels, power.real, sensing.channels))
        cells = 0.5 * np.repeat(join_bands(bands.degrees_of_freedom[:, None], cuts), noise.shape[1], axis=1)
        measured = DECIBELS * np.log(np.maximum(np.hstack(seen), LEAST_POWER))
        return cls(prepared, measured.ravel(), np.maximum(noise, LEAST_POWER).ravel(), cells.ravel(), len(cuts) - 1)

    @property
    def name(self) -> str:
        """Of the recording."""
        return self.prepared.name

    @property
    def sensors(self) -> int:
        """Number of sensors."""
        return len(self.prepared.sensing.sensors)

    def of_motion(self, power: AnyComplexArray, gains: FloatArray | None = None) -> FloatArray:
        """Levels (..., m) that these sensors would report of a frame's cross-powers (..., B, 3, 3), noise added."""
        sensing = self.prepared.sensing
        transform = sensing.transform if gains is None else gains[:, None] * sensing.transform
        mix = np.vstack([transform, sensing.channels @ transform]) if sensing.rigid_body else transform
        orders = np.asarray(power)[..., : self.bands, :, :].real
        # What each channel takes of the nine cross-powers: a product of matrices costs a fifth of the sum over both.
        squared = (mix[:, :, None] * mix[:, None, :]).reshape(len(mix), -1)
        seen = orders.reshape(*orders.shape[:-2], -1) @ squared.T
        total = np.maximum(seen.reshape(*seen.shape[:-2], -1), 0.0) + self.noise
        levels: FloatArray = DECIBELS * np.log(total)
        return levels

    def with_noise(self, noise: FloatArray) -> OrderLevels:
        """Levels as they were with the noise (m,) of another recording, no less than their own."""
        clean = np.maximum(10.0 ** (0.1 * self.measured) - self.noise, 0.0)
        return replace(self, measured=DECIBELS * np.log(clean + noise), noise=noise)

    def noise_variance(self) -> FloatArray:
        """Variance (m,) of the levels by the recording's noise, dB^2."""
        total = 10.0 ** (0.1 * self.measured)
        clean = np.maximum(total - self.noise, 0.0)
        variance: FloatArray = DECIBELS**2 * (self.noise**2 + 2.0 * clean * self.noise) / (self.cells * total**2)
        return variance


@dataclass(frozen=True, eq=False)
class LevelStatistics:
    """How the levels of machines in order lie at the speed of a recording.

    Parameters
    ----------
    levels : OrderLevels
    mean : (m,) array
        dB.
    deviations : (n, m) array
        Of entries from the mean at their own speed, dB.
    power : (K, 3, 3) array
        Cross-powers of the frame in orders 1 to K, or K feature bands, averaged over entries.
    fitted : int
        Numbers that the mean has of every level.
    known_to : float
        What a level is not better known to, dB.
    further : (m,) array
        Variance of the mean by what is no scatter of machines, dB^2.
    gain_scatter : float
        Standard deviation of the logarithm of a sensor's gain.
    """

    levels: OrderLevels
    mean: FloatArray
    deviations: FloatArray
    power: AnyComplexArray
    fitted: int = 3
    known_to: float = MODEL_DB
    further: FloatArray | float = 0.0
    gain_scatter: float = GAIN_SCATTER

    @property
    def error_variance(self) -> FloatArray:
        """Variance (m,) by noise and model, dB^2.

        Sensors and motions are two views of the same errors: each counts as if there were as many independent levels
        as motions.
        """
        sensing = self.levels.prepared.sensing
        views = 1.0 + len(sensing.sensors) / len(sensing.compared) if sensing.rigid_body else 1.0
        variance: FloatArray = views * (self.levels.noise_variance() + self.further + self.known_to**2)
        return variance

    def usable(self, nominal: FloatArray) -> BoolArray:
        """Levels (m,) that say something of frame and supports; `nominal` is of the simulated healthy machine."""
        measured = self.levels.measured
        power = 10.0 ** (0.1 * measured)
        strongest = measured.reshape(FEATURE_ORDERS, -1).max(axis=0)
        found: BoolArray = (
            (measured > np.tile(strongest - WEAKEST_DB, FEATURE_ORDERS))
            & (power > LEAST_SIGNAL * self.levels.noise)
            & (10.0 ** (0.1 * nominal) > LEAST_SIGNAL * self.levels.noise)
            & (np.abs(self.mean - nominal) < MOST_SHIFT_DB)
            & (self.deviations.std(axis=0) < MOST_SCATTER_DB)
        )
        return found

    def covariance(self, used: BoolArray, rows: BoolArray | None = None) -> FloatArray:
        """Covariance of used levels: what machines in order scatter by, the noise, and what no model is free of."""
        found = self.deviations[:, used] if rows is None else self.deviations[rows][:, used]
        scatter = found.T @ found / max(1, len(found) - self.fitted)
        own = len(found) / (len(found) + scatter.shape[0])
        shrunk = own * scatter + (1.0 - own) * np.diag(np.diag(scatter))
        return np.asarray(shrunk + np.diag(self.error_variance[used]))

    def distances(self, used: BoolArray, more: FloatArray) -> FloatArray:
        """Squared distances (n,) of recordings of machines in order, each by what others scatter.

        Parameters
        ----------
        used : (m,) bool array
        more : (u, u) array
            Covariance by numbers and gains that were fitted, zero where none were.
        """
        generator = np.random.default_rng(0)
        fold = np.arange(len(self.deviations)) % FOLDS
        spread = np.sqrt(self.error_variance[used])
        found = []
        for part in range(FOLDS):
            weight = np.linalg.inv(self.covariance(used, fold != part) + more)
            drawn = self.deviations[fold == part][:, used]
            drawn = drawn + spread * generator.normal(size=drawn.shape)
            found.append(np.sum((drawn @ weight) * drawn, axis=1))
        return np.concatenate(found)

    def p_value(self, distance: float, used: BoolArray, more: FloatArray) -> float:
        """Share of recordings of machines in order that lie further off than a squared distance; as `distances`."""
        return share_beyond(distance, self.distances(used, more))


def share_beyond(distance: float, others: FloatArray) -> float:
    """Share of distances that are as large, itself among them."""
    return float((1 + np.sum(others >= distance)) / (1 + len(others)))


def class_statistics(
    catalogue: Catalogue, levels: OrderLevels, label: str, rows: IntArray | None = None, *, as_filed: bool = False
) -> LevelStatistics | None:
    """Statistics of the trusted entries of a hypothesis, or of some of its rows; None where there are too few.

    Of machines whose frame and supports have the tolerances that entries draw, or are exactly `as_filed`.
    """
    matrix, prepared = catalogue.matrix, levels.prepared
    rows = matrix.rows(label, "trusted", speed=prepared.drive_speed) if rows is None else rows
    if len(rows) < LEAST_ENTRIES:
        return None
    power = unpack(matrix.packed(rows)[:, : levels.bands])  # feature bands, the first of which are the orders
    seen = levels.of_motion(power)
    # Levels change smoothly with the speed, which the recording tells: what is left is scatter.
    off = np.log(np.abs(matrix.table(rows).drive_speed) / prepared.drive_speed)
    smooth = np.column_stack([np.ones(len(rows)), off, off**2])
    if as_filed:
        # Tolerances are small: what they change is linear in them.
        filed, own = MachineNumbers(catalogue.machine).by_path, (f"links.{catalogue.machine.frame}.", "supports.")
        off_file = [
            np.log(values / filed[name])
            for name, values in matrix.table(rows).parameters.items()
            if name.startswith(own) and filed.get(name, 0.0) > 0.0 and (values > 0.0).all()
        ]
        smooth = np.column_stack([smooth, *off_file])
    weights, _, rank, _ = np.linalg.lstsq(smooth, seen, rcond=None)
    mean = power.mean(axis=0, dtype=np.complex128)
    return LevelStatistics(levels, weights[0], seen - smooth @ weights, mean, int(rank))
