"""A machine beside its own past: what a recording differs by from recordings of the same machine in order.

Two recordings of one machine by the same sensors share its mounts, its play and the gains of the sensors, so their
levels differ by less than those of two machines do. How levels go with the speed, and how much they scatter from
machine to machine, is the catalogue's; of that scatter two days of one machine have a share, another for every level,
which recordings of the machine itself tell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointplay.catalogue.diagnosing.answer_of_baseline import LevelSince, PastShown
from jointplay.catalogue.diagnosing.baseline_levels import (
    LEAST_ENTRIES,
    LevelStatistics,
    OrderLevels,
    class_statistics,
    share_beyond,
)
from jointplay.catalogue.diagnosing.cause_families import WARMTH, mount_numbers, mounts_of
from jointplay.catalogue.diagnosing.comparison import view_of
from jointplay.catalogue.plans.entry import HEALTHY
from jointplay.catalogue.signals.feature_bands import feature_axes
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import inverse_of, on_mounts, suspension_change
from jointplay.catalogue.storage.cross_power import unpack
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import AnyComplexArray, BoolArray, FloatArray, IntArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.bands import FEATURE_ORDERS

#: What two recordings of a machine in order differ by at one speed, as a part of what machines scatter by: contacts
#: settle to another motion with every little load,
SHARE = 0.3
#: and what is added for a difference in speed, for a unit of its logarithm.
SHARE_BY_SPEED = 8.0
#: What a level of a recording repeats to, dB, however steady the machine.
REPEATS_DB = 0.02
#: Differences that the share of a level stands for, beside those that recordings of the machine itself show.
BELIEVED = 2.0
#: A level counts where the machine has this many times the power of the noise, before or now.
LEAST_SIGNAL = 4.0
#: What an order says nothing by in which hum was taken out, dB.
HIDDEN_DB = 30.0
#: Degrees of freedom of Student's distribution, by which single levels that are far off count for little.
FREEDOM = 3.0
#: Recordings of machines in order that a change is ranked among, at least.
DRAWS = 2000
#: Levels that are told: so many standard deviations off, and the farthest so many.
TOLD_FROM, MOST_TOLD = 3.0, 5
#: Stiffnesses of all mounts that are tried, from warm to cold ones: a fiftieth apart.
WARM_AND_COLD = np.linspace(*WARMTH, 11)
#: Entries whose speed is nearest to the recording's.
NEAREST = 60


@dataclass(frozen=True, eq=False)
class PastComparison:
    """A recording beside the machine's own past.

    Parameters
    ----------
    p_value : float
        Share of pairs of recordings of a machine in order that differ by as much.
    changed : tuple of LevelSince
        Levels that have changed, the farthest from what is usual first.
    expected : LevelStatistics
        How the orders of the recording were to lie by what was recorded before.
    """

    p_value: float
    changed: tuple[LevelSince, ...]
    expected: LevelStatistics

    def describe(self) -> PastShown:
        """Return it as the answer shows it."""
        return PastShown(p_value=self.p_value, changed=self.changed)


def compare_with_past(
    prepared: PreparedMeasurement, past: Sequence[PreparedMeasurement], catalogue: Catalogue
) -> PastComparison | None:
    """Say how a recording differs from recordings of the same machine in order.

    Parameters
    ----------
    prepared : PreparedMeasurement
    past : sequence of PreparedMeasurement
        Those by other sensors do not count.
    catalogue : Catalogue

    Returns
    -------
    PastComparison or None
        None where no recording of the past is by these sensors, the catalogue holds too few machines in order, or no
        level stands out of the noise.
    """
    before = [each for each in past if view_of(each) == view_of(prepared)]
    if not before:
        return None
    count = min(len(each.cuts) - 1 for each in (prepared, *before))
    levels = [OrderLevels.of(each, count) for each in (prepared, *before)]
    noise = np.max([each.noise for each in levels], axis=0)
    known = [
        class_statistics(catalogue, each.with_noise(noise), HEALTHY, _with_play(catalogue, each)) for each in levels
    ]
    now, *then = [each for each in known if each is not None]
    if len(then) < len(before):
        return None
    steadiness = _steadiness(then)
    distance = _Distance.of(now, then, steadiness)
    used = distance.usable()
    if not used.any():
        return None
    expected = distance.expected(_power(catalogue, levels[0]))
    return PastComparison(
        distance.p_value(used, _by_warmth(expected, catalogue.machine)), tuple(distance.farthest(used)), expected
    )


def expect_worn(expected: LevelStatistics, catalogue: Catalogue, label: str, rows: IntArray) -> LevelStatistics | None:
    """Return how the orders of a recording were to lie if joints have worn since.

    Parameters
    ----------
    expected : LevelStatistics
        How they were to lie otherwise.
    catalogue : Catalogue
    label : str
        Hypothesis.
    rows : ndarray of int, shape (n,)
        Entries of it that are worn as the machine seems to be.

    Returns
    -------
    LevelStatistics or None
        Moved by what these entries differ by from the same machines in order, scatter included; None where too few of
        them are there.
    """
    before = catalogue.matrix.in_order(rows)
    rows, before = rows[before >= 0], before[before >= 0]
    levels = expected.levels
    worn, sound = (class_statistics(catalogue, levels, *each) for each in ((label, rows), (HEALTHY, before)))
    if worn is None or sound is None or len(np.unique(before)) < LEAST_ENTRIES:
        return None
    days = expected.deviations[np.arange(len(rows)) * len(expected.deviations) // len(rows)]
    return replace(
        expected,
        mean=expected.mean + worn.mean - sound.mean,
        deviations=worn.deviations - sound.deviations + days,
        power=worn.power,
    )


def _with_play(catalogue: Catalogue, levels: OrderLevels) -> IntArray:
    """Rows of machines in order, of those that have play where there are such: others do not rattle."""
    rows = catalogue.matrix.rows(HEALTHY, "trusted", speed=levels.prepared.drive_speed)
    playing = rows[np.any(np.nan_to_num(catalogue.matrix.clearance(rows)) > 0.0, axis=1)]
    return playing if len(playing) >= LEAST_ENTRIES else rows


def _power(catalogue: Catalogue, levels: OrderLevels) -> AnyComplexArray:
    """Cross-powers of machines in order at nearly the recording's speed, which a change is worked out on."""
    rows = _with_play(catalogue, levels)
    off = np.log(np.abs(catalogue.matrix.table(rows).drive_speed) / levels.prepared.drive_speed)
    nearest = rows[np.sort(np.argsort(np.abs(off), kind="stable")[:NEAREST])]
    power = unpack(catalogue.matrix.packed(nearest)[:, :FEATURE_ORDERS])
    return np.asarray(power.mean(axis=0, dtype=np.complex128))


def _by_warmth(known: LevelStatistics, machine: Machine) -> FloatArray:
    """What colder and warmer mounts move the levels (m,) of orders by, (t, m), dB."""
    if not on_mounts(machine):
        return np.zeros((1, len(known.mean)))
    prepared = known.levels.prepared
    frequency = np.arange(1.0, FEATURE_ORDERS + 1.0) * (prepared.drive_speed / (2.0 * math.pi))
    levels = []
    for factor in WARM_AND_COLD.tolist():
        numbers = mount_numbers(machine, mounts_of(machine), factor, math.sqrt(factor))
        passed = inverse_of(suspension_change(machine, numbers, frequency))
        levels.append(known.levels.of_motion(passed @ known.power @ passed.conj().swapaxes(-1, -2)))
    return np.asarray(np.array(levels) - known.levels.of_motion(known.power)).reshape(len(WARM_AND_COLD), -1)


def _steadiness(then: Sequence[LevelStatistics]) -> FloatArray | float:
    """How many times (m,) the usual share levels of this machine differ by, as far as several recordings say.

    Each beside the others: n recordings have n - 1 differences that do not depend on each other.
    """
    if len(then) == 1:
        return 1.0
    squares = []
    for place, one in enumerate(then):
        distance = _Distance.of(one, [*then[:place], *then[place + 1 :]], 1.0)
        squares.append(np.square(distance.away / distance.spread))
    own = len(then) - 1
    return np.asarray(np.sqrt((BELIEVED + own * np.mean(squares, axis=0)) / (BELIEVED + own)))


@dataclass(frozen=True, eq=False)
class _Distance:
    """Levels (m,) of a recording less those that others of the machine lead to expect, dB.

    What is expected differs by a part (m,) of what machines scatter by, and by errors of the levels themselves, dB^2.
    """

    now: LevelStatistics
    then: tuple[LevelStatistics, ...]
    away: FloatArray
    part: FloatArray
    errors: FloatArray

    @classmethod
    def of(cls, now: LevelStatistics, then: Sequence[LevelStatistics], steadiness: FloatArray | float) -> _Distance:
        """Carry recordings to the speed of another one, and weigh them by how well each tells its levels."""
        scatter = np.maximum(now.deviations.var(axis=0), 1e-12)
        own = np.full(len(scatter), 0.5 * (steadiness * SHARE) ** 2)
        carried, parts, errors = [], [], []
        for each in then:
            apart = math.log(now.levels.prepared.drive_speed / each.levels.prepared.drive_speed)
            carried.append(each.levels.measured + now.mean - each.mean)
            parts.append(own + np.minimum(1.0, (steadiness * SHARE_BY_SPEED * apart) ** 2))
            errors.append(_errors(each))
        weights = 1.0 / (np.array(parts) * scatter + np.array(errors))
        weights /= weights.sum(axis=0)
        return cls(
            now,
            tuple(then),
            now.levels.measured - np.sum(weights * np.array(carried), axis=0),
            np.sqrt(own + np.sum(weights**2 * np.array(parts), axis=0)),
            _errors(now) + np.sum(weights**2 * np.array(errors), axis=0),
        )

    @property
    def spread(self) -> FloatArray:
        """Standard deviations (m,) where nothing has changed, dB."""
        return np.asarray(np.sqrt(self.part**2 * self.now.deviations.var(axis=0) + self.errors))

    def usable(self) -> BoolArray:
        """Levels (m,) that say something: motions where the sensors see them, where they stand out of the noise."""
        prepared, noise = self.now.levels.prepared, self.now.levels.noise
        highest = np.max([each.levels.measured for each in (self.now, *self.then)], axis=0)
        found = (10.0 ** (0.1 * highest) > (1.0 + LEAST_SIGNAL) * noise) & ~self._hum()
        if prepared.sensing.rigid_body:
            found &= np.tile(np.arange(self._channels) >= len(prepared.sensing.sensors), self.now.levels.bands)
        return np.asarray(found)

    @property
    def _channels(self) -> int:
        """Levels of a band."""
        return len(self.away) // self.now.levels.bands

    def _hum(self) -> BoolArray:
        """Levels (m,) of single orders that hum was taken out of, now or before."""
        orders = {
            round(line.frequency * 2.0 * math.pi / each.levels.prepared.drive_speed)
            for each in (self.now, *self.then)
            for line in each.levels.prepared.lines
        }
        bands = np.arange(1, self.now.levels.bands + 1)
        return np.repeat(np.isin(bands, [order for order in orders if order <= FEATURE_ORDERS]), self._channels)

    def p_value(self, used: BoolArray, warmth: FloatArray) -> float:
        """Share of pairs of recordings of a machine in order that differ by as much.

        Either at what of the shifts (t, m) by which warm and cold mounts move the first m levels explains it best.
        """
        shifts = np.zeros((len(warmth), len(self.away)))
        shifts[:, : warmth.shape[1]] = warmth
        shifts = shifts[:, used] / self.spread[used]
        generator = np.random.default_rng(0)
        spread, errors = self.spread[used], np.sqrt(self.errors[used])
        machines = self.part[used] * self.now.deviations[:, used]
        drawn = []
        known = BELIEVED + len(self.then) - 1  # degrees of freedom of each level's share
        for _ in range(math.ceil(DRAWS / len(machines))):
            share = np.sqrt(known / generator.chisquare(known, machines.shape))
            away = (share * machines + errors * generator.normal(size=machines.shape)) / spread
            drawn.append(np.min([_distance(away - shift) for shift in shifts], axis=0))
        own = min(float(_distance(self.away[used] / spread - shift)) for shift in shifts)
        return share_beyond(own, np.concatenate(drawn))

    def farthest(self, used: BoolArray) -> list[LevelSince]:
        """The levels that are farthest from what is usual."""
        prepared, spread = self.now.levels.prepared, self.spread
        sensing = prepared.sensing
        names = (*sensing.sensors, *(sensing.compared if sensing.rigid_body else ()))
        axes = feature_axes(prepared.scheme, prepared.cuts[: self.now.levels.bands + 1], names, prepared.drive_speed)
        off = np.where(used, np.abs(self.away) / spread, 0.0)
        return [
            LevelSince(
                channel=axes[place].channel,
                low_order=axes[place].low_order,
                high_order=axes[place].high_order,
                difference_db=float(self.away[place]),
                usual_db=float(spread[place]),
            )
            for place in np.argsort(-off, kind="stable")[:MOST_TOLD].tolist()
            if off[place] >= TOLD_FROM
        ]

    def expected(self, power: AnyComplexArray) -> LevelStatistics:
        """How the orders were to lie: as far as machines scatter, and as far as levels err."""
        orders = slice(0, FEATURE_ORDERS * self._channels)
        levels = self.now.levels
        first = OrderLevels(levels.prepared, levels.measured[orders], levels.noise[orders], levels.cells[orders])
        hidden = np.where(self._hum(), HIDDEN_DB**2, 0.0)
        return LevelStatistics(
            levels=first,
            mean=(levels.measured - self.away)[orders],
            deviations=(self.part * self.now.deviations)[:, orders],
            power=power,
            fitted=self.now.fitted,
            known_to=REPEATS_DB,
            further=(self.errors - _errors(self.now) + hidden)[orders],
            gain_scatter=0.0,
        )


def _errors(known: LevelStatistics) -> FloatArray:
    """Variance (m,) of the levels of one recording by themselves, dB^2."""
    return known.levels.noise_variance() + 0.5 * REPEATS_DB**2


def _distance(away: FloatArray) -> FloatArray:
    """Mean, over levels (..., m) in standard deviations, of what they say by Student's distribution."""
    return np.asarray(np.mean(np.log1p(away**2 / FREEDOM), axis=-1))
