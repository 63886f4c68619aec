"""How a network learns a catalogue: simulated recordings of all noises and lengths, in any number.

Entries are few, but what lies between an entry and a recording - noise, gains, discrepancy, modes of the frame - costs
no simulation. So every entry is seen many times, each time through another recording. One network serves all noises.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from jointplay.catalogue.matching.calibration import held_out
from jointplay.catalogue.matching.learning import Learning, rows_of
from jointplay.catalogue.matching.network import AS_FILED, DIFFERS, Network, density_db
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.matching.spectra import Spectra
from jointplay.catalogue.plans.entry import Hypothesis, Stratum
from jointplay.solver.arrays import FloatArray, IntArray

LEAST_ON_EITHER_SIDE = 2
"""Cases of a hypothesis that are learned from, and held out, at least."""

FEW_CASES = 4000
"""Cases in all below which networks are trained in double precision: strongly held weights fade, to numbers too small
for the normal form of single precision, and processors take many times longer for those (832 cases: 104 s a network,
and 29 in double precision; 24 064 cases: 24 and 36)."""

FULL_BAND = 5000.0
"""Bandwidth [Hz] that noise is stated over: half of 10 kHz."""


@dataclass(frozen=True)
class NetworkTraining:
    """Settings of the training.

    Parameters
    ----------
    rows : int
        Recordings in all, every hypothesis having the same share.
    blocks : int
        Different noises and lengths among them.
    layers : tuple of int
        Units of the hidden layers.
    penalty : float
        On the squares of the weights of networks that tell hypotheses apart, for a single case: what is held of weights
        beforehand counts the less, the more cases say otherwise. One number is best for catalogues of 4000 cases and of
        20 000, trusted and not (docs/decisions/0120).
    epochs, rates : tuple
        Passes over all recordings, and step size of the Adam optimiser, of each stage.
    strata_penalty, strata_epochs
        The same of networks that tell strata apart; the penalty for any number of cases.
    batch : int
        Recordings a step.
    members : int
        Networks that start from other weights and are one in the end: the mean of what their last layers say.
    noise : tuple of float
        Sensor noise up to 5 kHz, m/s2 rms, log-uniform.
    channel_db, tilt_db : float
        Standard deviation of a channel's noise about that, and of its slope a decade of frequency.
    lengths : tuple of float
        Seconds, log-uniform; five revolutions at least.
    least_cases : int
        Cases of worn joints, each hypothesis, below which a network learns less than curves know.
    """

    rows: int = 200_000
    blocks: int = 80
    layers: tuple[int, ...] = (128, 64)
    penalty: float = 20_000.0
    epochs: tuple[int, ...] = (4, 2)
    rates: tuple[float, ...] = (1e-3, 1e-4)
    strata_penalty: float = 0.5
    strata_epochs: tuple[int, ...] = (2, 2)
    batch: int = 256
    members: int = 3
    noise: tuple[float, float] = (3e-3, 1.0)
    channel_db: float = 2.0
    tilt_db: float = 3.0
    lengths: tuple[float, float] = (2.0, 10.0)
    least_cases: int = 180
    version: str = "4"

    def enough(self, matrix: Spectra, learning: Learning, speed: float | None) -> bool:
        """Whether there are cases enough: of worn joints to learn from, of every hypothesis to calibrate on."""
        counts = []
        classes = _classes(matrix, learning, speed)
        for known, rows in classes:
            apart = int(np.sum(held_out(rows)))
            if min(apart, len(rows) - apart) < LEAST_ON_EITHER_SIDE:
                return False
            if known.joints:
                counts.append(len(rows))
        return len(classes) > 1 and min(counts, default=0) >= self.least_cases

    def train(
        self,
        matrix: Spectra,
        sensing: Sensing,
        learning: Learning,
        *,
        speed: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Network:
        """Train a network on all but the cases that calibration holds out.

        Parameters
        ----------
        matrix : Spectra
        sensing : Sensing
            Its noise and length do not matter.
        learning : Learning
        speed : float, optional
            Drive speed, rad/s: which of the stored speeds is learned.
        progress : callable, optional
            Called with the number of steps done and their total.

        Notes
        -----
        D. E. Rumelhart, G. E. Hinton, R. J. Williams, Nature 323 (1986) 533; D. P. Kingma, J. Ba, ICLR 2015 (Adam); by
        scikit-learn. On one thread, so that the same computer trains the same network again.
        """
        tell = progress or (lambda done, total: None)
        total = self.blocks + 10 * self.members
        with threadpool_limits(limits=1, user_api="blas"):
            pools = _pools(matrix, learning, speed)
            inputs, index, noise = self._recordings(matrix, sensing, learning, pools, lambda done: tell(done, total))
            centre, scale = inputs.mean(axis=0), inputs.std(axis=0) + 1e-6
            cases = len(np.unique(np.concatenate([rows for pool in pools for rows in pool])))
            penalty, epochs = self.penalty / cases, self.epochs
            if learning.subject == "strata":
                penalty, epochs = self.strata_penalty, self.strata_epochs
            # In place: of a machine with forty bands they are 0.6 GB.
            inputs -= centre
            inputs /= scale
            if cases < FEW_CASES:
                inputs = inputs.astype(np.float64)
            classifier = self._fitted(inputs, index, penalty, epochs, lambda s: tell(self.blocks + 10 * s, total))
        labels = tuple(known.label for known in matrix.hypotheses if known.label not in learning.without)
        if learning.subject == "strata":
            labels = (AS_FILED, DIFFERS)
        weights, biases = ([np.asarray(each, np.float64) for each in part] for part in classifier)
        if len(labels) == 2:
            # One output, the second hypothesis against the first.
            weights[-1], biases[-1] = np.c_[0.0 * weights[-1], weights[-1]], np.r_[0.0 * biases[-1], biases[-1]]
        wide = (centre.astype(np.float64), scale.astype(np.float64))
        return Network(labels, *wide, tuple(weights), tuple(biases), *noise)

    def _recordings(
        self,
        matrix: Spectra,
        sensing: Sensing,
        learning: Learning,
        pools: Sequence[Sequence[IntArray]],
        tell: Callable[[int], None],
    ) -> tuple[FloatArray, IntArray, tuple[float, float]]:
        """Inputs (n, d + c), class (n,), and the least and largest mean noise, dB."""
        edges_hz = np.array(matrix.edges) * abs(matrix.nominal_speed) / (2.0 * math.pi)
        width = np.diff(edges_hz)[: sensing.bands]
        middle = np.sqrt(np.maximum(edges_hz[:-1], 0.5 * edges_hz[1]) * edges_hz[1:])[: sensing.bands]
        shortest = max(self.lengths[0], 5.0 * 2.0 * math.pi / abs(matrix.nominal_speed))
        quiet_db, loud_db = (10.0 * math.log10(each**2 / FULL_BAND) for each in self.noise)
        own_db = 10.0 * np.log10(np.sum(sensing.channels**2, axis=1))
        share = max(1, self.rows // self.blocks // len(pools[0]))
        generator = np.random.default_rng(learning.seed)
        inputs, index = [], []
        for block in range(self.blocks):
            # Noises and lengths in equal steps, so that none is left out.
            level = quiet_db + (loud_db - quiet_db) * (block + generator.uniform()) / self.blocks
            slope = self.tilt_db * generator.normal() * np.log10(middle / np.median(middle))
            channels = own_db + self.channel_db * generator.normal(size=len(own_db))
            density = 10.0 ** (0.1 * (level + slope[:, None] + channels))
            seconds = shortest * (self.lengths[1] / self.lengths[0]) ** generator.uniform()
            freedom = 2.0 * np.maximum(1.0, seconds * width)
            seen = replace(sensing, noise=density * width[:, None], degrees_of_freedom=freedom)
            for number, rows in enumerate(pools[block % 2]):
                some = generator.choice(rows, share, replace=share > len(rows))
                copies = np.ones(len(some), np.int64)
                seed = (learning.seed, block, number)
                features, _ = observe(matrix.packed(some), seen, learning.discrepancy, copies, seed, edges_hz)
                noise = np.broadcast_to(density_db(seen.noise, width), (len(features), len(own_db)))
                inputs.append(np.concatenate([features, noise], axis=1).astype(np.float32))
                index.append(np.full(len(features), number % 2 if learning.subject == "strata" else number))
            tell(block + 1)
        mean = float(np.mean(own_db))
        return np.concatenate(inputs), np.concatenate(index), (quiet_db + mean, loud_db + mean)

    def _fitted(
        self,
        inputs: FloatArray,
        index: IntArray,
        penalty: float,
        epochs: Sequence[int],
        tell: Callable[[int], None],
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """Weights and biases, layer by layer, of all members as one network."""
        # Here, not above: the import takes a second, and only the training needs it.
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPClassifier

        members = []
        for member in range(self.members):
            size = min(self.batch, len(inputs))
            trained = MLPClassifier(self.layers, alpha=penalty, batch_size=size, random_state=member, warm_start=True)
            for passes, rate in zip(epochs, self.rates, strict=True):
                trained.set_params(max_iter=passes, learning_rate_init=rate)
                with warnings.catch_warnings():
                    # The number of passes is chosen, not left to a rule of convergence.
                    warnings.simplefilter("ignore", ConvergenceWarning)
                    trained.fit(inputs, index)
            members.append(trained)
            tell(member + 1)
        weights = [block_diag(*each) for each in zip(*(trained.coefs_ for trained in members), strict=True)]
        weights[0] = np.hstack([trained.coefs_[0] for trained in members])
        weights[-1] = np.vstack([trained.coefs_[-1] for trained in members]) / self.members
        biases = [np.concatenate(each) for each in zip(*(trained.intercepts_ for trained in members), strict=True)]
        biases[-1] = np.mean([trained.intercepts_[-1] for trained in members], axis=0)
        return weights, biases


def _pools(matrix: Spectra, learning: Learning, speed: float | None) -> list[list[IntArray]]:
    """Rows of each class that recordings are made of by turns.

    Machines whose own data differ show what a fault looks like whatever they are: every other block is of them.
    """
    learning = replace(learning, most=learning.reach)
    return [
        [rows[~held_out(rows)] for _, rows in _classes(matrix, each, speed)]
        for each in (learning, replace(learning, mode="robust"))
    ]


def _classes(matrix: Spectra, learning: Learning, speed: float | None) -> list[tuple[Hypothesis, IntArray]]:
    """Rows of each class: a hypothesis; or of machines as filed and of others by turns, for each hypothesis."""
    found = []
    for known in matrix.hypotheses:
        if known.label in learning.without:
            continue
        if learning.subject == "hypotheses":
            found.append((known, rows_of(matrix, known.label, learning, speed)))
            continue
        strata: tuple[Stratum, ...] = ("trusted", "wide")
        found += [(known, matrix.rows(known.label, each, draws=learning.most, speed=speed)) for each in strata]
    return found
