"""A network that tells hypotheses apart: a second opinion on what the curves of the hypotheses say.

Curves take what scatters around them for a Gaussian. Where much is uncertain at once - loads that hold a joint shut,
modes of the frame, machines that differ from their file - it is not, and a network that has seen many simulated
recordings of it tells more (docs/explanation/method.md, "The second opinion").

Entries are few, but what lies between an entry and a recording - noise, gains, discrepancy, modes of the frame - costs
no simulation. So every entry is seen many times, each time through another recording. One network serves all noises.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.special import log_softmax
from threadpoolctl import threadpool_limits

from jointplay.catalogue.matching.calibration import is_held_out
from jointplay.catalogue.matching.coherence import cyclic_bands, highest_there_are, with_more_noise
from jointplay.catalogue.matching.learning import Learning, SpectraSource, rows_of, with_past
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.plans.entry import Hypothesis, Stratum
from jointplay.solver.arrays import FloatArray, IntArray

AS_FILED, DIFFERS = "as filed", "differs"
"""What a network of strata tells apart."""


@dataclass(frozen=True, eq=False)
class Network:
    """A trained perceptron with rectified linear units.

    Parameters
    ----------
    labels : tuple of str
        Hypotheses, all equally probable beforehand; or :data:`AS_FILED` and :data:`DIFFERS`.
    centre, scale : ndarray, shape (d + c,)
        Of its inputs: d features and the noise of c channels.
    weights : tuple of ndarray
        Of each layer, (inputs, outputs).
    biases : tuple of ndarray
        Of each layer, (outputs,).
    quietest, loudest : float
        Mean noise of the channels it was trained for, dB re 1 (m/s2)^2/Hz.
    past : bool
        Whether the d features are what a recording differs by from those of the machine in order, levels and
        coherences.
    """

    labels: tuple[str, ...]
    centre: FloatArray
    scale: FloatArray
    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    quietest: float
    loudest: float
    past: bool = False

    def opinion(self, sensing: Sensing, width: FloatArray) -> Opinion | None:
        """Return its opinion on recordings of some sensors and noise, in bands of some width (G,), Hz.

        Noise below what it was trained for is raised to that. None where the noise is above: nobody has trained it.
        Recordings may end below its highest bands.
        """
        noise = sensing.noise
        level = density_db(noise, width)
        lacking = self.quietest - float(np.mean(level))
        if float(np.mean(level)) > self.loudest:
            return None
        missing = noise * (10.0 ** (0.1 * max(0.0, lacking)) - 1.0)
        return Opinion(self, level + max(0.0, lacking), missing, sensing.alike, len(width))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything it is."""
        found = hashlib.sha256(repr((self.labels, self.quietest, self.loudest, *["past"] * self.past)).encode())
        for array in (self.centre, self.scale, *self.weights, *self.biases):
            found.update(np.ascontiguousarray(array, np.float64).tobytes())
        return found.hexdigest()

    def log_likelihoods(self, features: FloatArray, noise_db: FloatArray) -> FloatArray:
        """Return log likelihoods (m, hypotheses), up to a constant of each row, of features (m, d) with noise (c,)."""
        noise = np.broadcast_to(noise_db, (len(features), len(noise_db)))
        layer = (np.concatenate([features, noise], axis=1) - self.centre) / self.scale
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            layer = np.maximum(layer @ weights + biases, 0.0)
        out: FloatArray = log_softmax(layer @ self.weights[-1] + self.biases[-1], axis=1)
        return out


@dataclass(frozen=True, eq=False)
class Opinion:
    """A network, asked about recordings of one noise.

    Parameters
    ----------
    network : Network
    noise_db : ndarray, shape (c,)
        Noise density of each channel, dB.
    missing : ndarray, shape (G, c)
        Noise power that is added before features are shown to it.
    alike : ndarray, shape (p,)
        Correlation of the noise of pairs of channels.
    bands : int
        Of the network; what recordings do not have of them is taken to lie as their highest one does, in standard
        deviations of what the network was shown.
    since : Opinion, optional
        Of a network that hears the machine's own past, which counts as much.
    """

    network: Network
    noise_db: FloatArray
    missing: FloatArray
    alike: FloatArray
    bands: int
    since: Opinion | None = None

    @property
    def digest(self) -> str:
        """Of the networks that are asked."""
        own = self.network.digest
        return own if self.since is None else hashlib.sha256((own + self.since.digest).encode()).hexdigest()

    def log_evidences(self, features: FloatArray, labels: Sequence[str]) -> FloatArray:
        """Return log likelihoods (m, labels), up to a constant of each row, of features (m, d).

        Those of the machine's own past stand behind those of the recording, where it is there.
        """
        columns = [self.network.labels.index(label) for label in labels]
        bands, channels = self.missing.shape
        plain = self.missing.size + 2 * bands * len(self.alike)
        if self.network.past:
            now, before = (with_more_noise(part, self.missing, self.alike) for part in np.split(features, 2, axis=1))
            shown = differences(now, before, plain)
        else:
            own = plain + 2 * len(cyclic_bands(bands).band) * channels
            shown = with_more_noise(features[:, :own], self.missing, self.alike)
        shown = self._in_all_bands(shown)
        found: FloatArray = self.network.log_likelihoods(shown, self.noise_db)[:, columns]
        return found if self.since is None else found + self.since.log_evidences(features, labels)

    def _in_all_bands(self, features: FloatArray) -> FloatArray:
        """Return features (m, d) that the network is shown, of those in the bands that there are."""
        if len(self.missing) == self.bands:
            return features
        count, channels = len(self.network.centre) - len(self.noise_db), len(self.noise_db)
        place, own = (each[:count] for each in highest_there_are(len(self.missing), self.bands, channels))
        centre, scale = self.network.centre, self.network.scale
        there, lacking = own == np.arange(count), features[:, place]
        raised = centre[:count] + scale[:count] * (lacking - centre[own]) / scale[own]
        return np.asarray(np.where(there, lacking, raised))

    def doubts(self, features: FloatArray) -> FloatArray:
        """Return by how much features (m, d) are rather of machines that differ from their file, log (m,).

        Of a network of strata.
        """
        found = self.log_evidences(features, (AS_FILED, DIFFERS))
        ratio: FloatArray = found[:, 1] - found[:, 0]
        return ratio


def differences(now: FloatArray, before: FloatArray, plain: int) -> FloatArray:
    """Return what features (n, d) of recordings differ by from those of the machines in order, levels and coherences.

    What is locked to the crank says nothing more, and is learned by heart: docs/decisions/0200.
    """
    return np.asarray(now[:, :plain] - before[:, :plain])


def density_db(noise: FloatArray, width: FloatArray) -> FloatArray:
    """Return the median density (c,) of a noise power (G, c) in bands of some width (G,), Hz; dB re 1 (m/s2)^2/Hz."""
    found: FloatArray = np.median(10.0 * np.log10(noise / width[: len(noise), None]), axis=0)
    return found


LEAST_ON_EITHER_SIDE = 2
"""Cases of a hypothesis that are learned from, and held out, at least."""

FADING = (1500, 4000)
"""Cases in all between which networks are trained in double precision: there weights are held strongly for so many
steps that some fade to numbers too small for the normal form of single precision, for which some processors take many
times longer (seen from 1986 cases on, not at 1324, where none is below 1e-25). Elsewhere single precision takes half
the time."""

CASE_ROWS = 75
"""Recordings of a case, at most, of networks that tell hypotheses apart: more say nothing new (docs/decisions/0143)."""

FULL_BAND = 5000.0
"""Bandwidth [Hz] that noise is stated over: half of 10 kHz."""

PENALTY, STRATA_PENALTY = 20_000.0, 0.5
"""On the squares of the weights: of networks that tell hypotheses apart for a single case, as what is held of weights
beforehand counts the less, the more cases say otherwise (16 000 to 24 000 was best for three machines, trusted and
robust); of networks that tell strata apart, which have thousands of cases a side, for any number of them."""

RATES = (1e-3, 1e-4)
"""Step size of the Adam optimiser in each stage: scikit-learn's own, and a tenth of it."""

BATCH = 256
"""Recordings a step."""

MEMBERS = 3
"""Networks that start from other weights and are one in the end: the mean of what their last layers say."""

NOISE = (3e-3, 1.0)
"""Sensor noise up to 5 kHz, m/s2 rms, log-uniform."""

CHANNEL_DB, TILT_DB = 2.0, 3.0
"""Standard deviation of a channel's noise about that, and of its slope a decade of frequency."""

LENGTHS = (2.0, 10.0)
"""Seconds of a recording, log-uniform; five revolutions at least."""


@dataclass(frozen=True)
class NetworkTraining:
    """How much is trained: what ships with the program; tests take less.

    Parameters
    ----------
    rows : int
        Recordings in all, at most, every hypothesis having the same share.
    blocks : int
        Different noises and lengths among them.
    layers : tuple of int
        Units of the hidden layers; 256 and 128 of them know no more (docs/decisions/0112).
    epochs, strata_epochs : tuple of int
        Passes over all recordings in each stage, of networks that tell hypotheses or strata apart.
    least_cases : int
        Cases of worn joints, each hypothesis, below which a network learns less than curves know.
    """

    rows: int = 200_000
    blocks: int = 80
    layers: tuple[int, ...] = (128, 64)
    epochs: tuple[int, ...] = (4, 2)
    strata_epochs: tuple[int, ...] = (2, 2)
    least_cases: int = 180

    def enough(self, matrix: SpectraSource, learning: Learning, speed: float | None) -> bool:
        """Whether there are cases enough: of worn joints to learn from, of every hypothesis to calibrate on."""
        counts = []
        classes = _classes(matrix, learning, speed)
        for known, rows in classes:
            apart = int(np.sum(is_held_out(matrix.individuals(rows))))
            if min(apart, len(rows) - apart) < LEAST_ON_EITHER_SIDE:
                return False
            if known.joints:
                counts.append(len(rows))
        return len(classes) > 1 and min(counts, default=0) >= self.least_cases

    def train(
        self,
        matrix: SpectraSource,
        sensing: Sensing,
        learning: Learning,
        *,
        speed: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Network:
        """Train a network on all but the cases that calibration holds out.

        Parameters
        ----------
        matrix : SpectraSource
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
        total = self.blocks + 10 * MEMBERS
        with threadpool_limits(limits=1, user_api="blas"):
            sensing = replace(sensing, past=learning.subject == "since")
            pools = _pools(matrix, learning, speed)
            cases = len(np.unique(np.concatenate([rows for pool in pools for rows in pool])))
            count, penalty, epochs = min(self.rows, CASE_ROWS * cases), PENALTY / cases, self.epochs
            if learning.subject == "strata":
                count, penalty, epochs = self.rows, STRATA_PENALTY, self.strata_epochs
            inputs, index, noise = self._recordings(
                matrix, sensing, learning, pools, count, lambda done: tell(done, total)
            )
            centre, scale = inputs.mean(axis=0), inputs.std(axis=0) + 1e-6
            # In place: of a machine with forty bands they are 0.6 GB.
            inputs -= centre
            inputs /= scale
            if FADING[0] <= cases < FADING[1]:
                inputs = inputs.astype(np.float64)
            classifier = self._fit(inputs, index, penalty, epochs, lambda s: tell(self.blocks + 10 * s, total))
        labels = tuple(known.label for known in matrix.hypotheses if known.label not in learning.without)
        if learning.subject == "strata":
            labels = (AS_FILED, DIFFERS)
        weights, biases = ([np.asarray(each, np.float64) for each in part] for part in classifier)
        if len(labels) == 2:
            # One output, the second hypothesis against the first.
            weights[-1], biases[-1] = np.c_[0.0 * weights[-1], weights[-1]], np.r_[0.0 * biases[-1], biases[-1]]
        wide = (centre.astype(np.float64), scale.astype(np.float64))
        return Network(labels, *wide, tuple(weights), tuple(biases), *noise, past=sensing.past)

    def _recordings(
        self,
        matrix: SpectraSource,
        sensing: Sensing,
        learning: Learning,
        pools: Sequence[Sequence[IntArray]],
        count: int,
        tell: Callable[[int], None],
    ) -> tuple[FloatArray, IntArray, tuple[float, float]]:
        """Of `count` recordings inputs (n, d + c), class (n,), and the least and largest mean noise, dB."""
        edges_hz = np.array(matrix.edges) * abs(matrix.nominal_speed) / (2.0 * math.pi)
        width = np.diff(edges_hz)[: sensing.bands]
        middle = np.sqrt(np.maximum(edges_hz[:-1], 0.5 * edges_hz[1]) * edges_hz[1:])[: sensing.bands]
        shortest = max(LENGTHS[0], 5.0 * 2.0 * math.pi / abs(matrix.nominal_speed))
        quiet_db, loud_db = (10.0 * math.log10(each**2 / FULL_BAND) for each in NOISE)
        own_db = 10.0 * np.log10(np.sum(sensing.channels**2, axis=1))
        share = max(1, count // self.blocks // len(pools[0]))
        generator = np.random.default_rng(learning.seed)
        inputs, index = [], []
        for block in range(self.blocks):
            # Noises and lengths in equal steps, so that none is left out.
            level = quiet_db + (loud_db - quiet_db) * (block + generator.uniform()) / self.blocks
            slope = TILT_DB * generator.normal() * np.log10(middle / np.median(middle))
            channels = own_db + CHANNEL_DB * generator.normal(size=len(own_db))
            density = 10.0 ** (0.1 * (level + slope[:, None] + channels))
            seconds = shortest * (LENGTHS[1] / LENGTHS[0]) ** generator.uniform()
            freedom = 2.0 * np.maximum(1.0, seconds * width)
            seen = replace(sensing, noise=density * width[:, None], degrees_of_freedom=freedom)
            for number, rows in enumerate(pools[block % 2]):
                some = generator.choice(rows, share, replace=share > len(rows))
                copies = np.ones(len(some), np.int64)
                seed = (learning.seed, block, number)
                past = matrix.packed(matrix.in_order(some)) if seen.past else None
                features, _ = observe(
                    matrix.packed(some), seen, learning.discrepancy, copies, seed, edges_hz, past=past
                )
                if past is not None:
                    now, before = np.split(features, 2, axis=1)
                    features = differences(now, before, sensing.plain_count)
                noise = np.broadcast_to(density_db(seen.noise, width), (len(features), len(own_db)))
                inputs.append(np.concatenate([features, noise], axis=1).astype(np.float32))
                index.append(np.full(len(features), number % 2 if learning.subject == "strata" else number))
            tell(block + 1)
        mean = float(np.mean(own_db))
        return np.concatenate(inputs), np.concatenate(index), (quiet_db + mean, loud_db + mean)

    def _fit(
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
        for member in range(MEMBERS):
            size = min(BATCH, len(inputs))
            trained = MLPClassifier(self.layers, alpha=penalty, batch_size=size, random_state=member, warm_start=True)
            for passes, rate in zip(epochs, RATES, strict=True):
                trained.set_params(max_iter=passes, learning_rate_init=rate)
                with warnings.catch_warnings():
                    # The number of passes is chosen, not left to a rule of convergence.
                    warnings.simplefilter("ignore", ConvergenceWarning)
                    trained.fit(inputs, index)
            members.append(trained)
            tell(member + 1)
        weights = [block_diag(*each) for each in zip(*(trained.coefs_ for trained in members), strict=True)]
        weights[0] = np.hstack([trained.coefs_[0] for trained in members])
        weights[-1] = np.vstack([trained.coefs_[-1] for trained in members]) / MEMBERS
        biases = [np.concatenate(each) for each in zip(*(trained.intercepts_ for trained in members), strict=True)]
        biases[-1] = np.mean([trained.intercepts_[-1] for trained in members], axis=0)
        return weights, biases


def _pools(matrix: SpectraSource, learning: Learning, speed: float | None) -> list[list[IntArray]]:
    """Rows of each class that recordings are made of by turns.

    Machines whose own data differ show what a fault looks like whatever they are: every other block is of them.
    """
    learning = replace(learning, most=learning.reach)
    return [
        [rows[~is_held_out(matrix.individuals(rows))] for _, rows in _classes(matrix, each, speed)]
        for each in (learning, replace(learning, mode="robust"))
    ]


def _classes(matrix: SpectraSource, learning: Learning, speed: float | None) -> list[tuple[Hypothesis, IntArray]]:
    """Rows of each class: a hypothesis; or of machines as filed and of others by turns, for each hypothesis."""
    found = []
    for known in matrix.hypotheses:
        if known.label in learning.without:
            continue
        if learning.subject != "strata":
            rows = rows_of(matrix, known.label, learning, speed)
            found.append((known, with_past(matrix, rows) if learning.subject == "since" else rows))
            continue
        strata: tuple[Stratum, ...] = ("trusted", "wide")
        found += [(known, matrix.rows(known.label, each, draws=learning.most, speed=speed)) for each in strata]
    return found
