"""Networks of a catalogue, some for each mode and stored speed, kept as files.

Training takes a minute, so it belongs to building a catalogue, and no diagnosis waits for it; and networks are for one
set of sensors: those of the machine's file.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointplay.catalogue import FEATURES_VERSION, MATCHER_VERSION
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.matching.learning import Learning, SpectraSource
from jointplay.catalogue.matching.modelfile import read_network, write_network
from jointplay.catalogue.matching.modes import Mode
from jointplay.catalogue.matching.network import Network, NetworkTraining, Opinion
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.plans.entry import content_digest
from jointplay.catalogue.signals.sensors import choose_channels, free_motions
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine

MODES: tuple[Mode, ...] = ("trusted", "robust")

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Networks:
    """Networks for a recording, each where it is there.

    Parameters
    ----------
    hypotheses : Network, optional
        That tells hypotheses apart by the recording.
    since : Network, optional
        That does by how it differs from the machine's own past.
    strata : Network, optional
        That says whether the machine differs from its file.
    """

    hypotheses: Network | None = None
    since: Network | None = None
    strata: Network | None = None

    def opinions(self, sensing: Sensing, width: FloatArray) -> tuple[Opinion | None, Opinion | None]:
        """Return what they say of hypotheses, and of strata, for recordings of some noise in bands (G,), Hz.

        What recordings of a noise that nobody has trained say is left to the curves.
        """
        own, since, strata = (
            None if each is None else each.opinion(sensing, width)
            for each in (self.hypotheses, self.since, self.strata)
        )
        return None if own is None else replace(own, since=since), strata


class NetworkShelf:
    """Networks of one state of a catalogue; safe to share between threads.

    Parameters
    ----------
    matrix : SpectraSource
    own : Sensing or None
        What all sensors of the machine see, with any noise; None where they see nothing: then there are no networks.
    folder : Path, optional
        Where networks are kept; without it they live as long as the shelf.
    training : NetworkTraining, optional
        Less than is trained otherwise.
    remembers : bool
        Whether machines in order are there on two days that differ as those of worn ones do; no network is trained
        beside a machine's past otherwise.
    """

    def __init__(
        self,
        matrix: SpectraSource,
        own: Sensing | None,
        folder: Path | None,
        training: NetworkTraining | None = None,
        *,
        remembers: bool = True,
    ) -> None:
        self._matrix, self._folder, self._training = matrix, folder, training or NetworkTraining()
        self._own, self._remembers = own, remembers
        self._arrangement = None if own is None else arrangement(own)
        self._lock = threading.Lock()
        self._known: dict[str, Network] = {}
        self._enough: dict[tuple[Learning, float | None], bool] = {}

    @classmethod
    def of(cls, catalogue: Catalogue) -> NetworkShelf:
        """Return the shelf of a catalogue, with files in its folder."""
        matrix, plan = catalogue.matrix, catalogue.plan
        # Under several loads a machine in order has another one on its other day, a worn one has not always.
        remembers = plan.draws.again > 0 and plan.loads is None
        own = own_sensing(catalogue.machine, matrix.cuts)
        return cls(matrix, own, catalogue.layout.networks, remembers=remembers)

    def missing(self, most: int | None = None) -> Iterator[tuple[Learning, float]]:
        """Yield mode and drive speed (rad/s) of every network that there should be, and is not.

        Parameters
        ----------
        most : int, optional
            Entries of a hypothesis that are learned from, at most, as for :meth:`Learning.of`.
        """
        for mode in MODES:
            learning = Learning.of(mode, most=most)
            others = [replace(learning, subject="since")]
            if mode == "trusted":
                others.append(replace(learning, subject="strata"))
            for each in (learning, *others):
                for factor in self._matrix.speeds:
                    speed = factor * self._matrix.nominal_speed
                    if self._applies(each, speed) and self._find(self._key(each, speed)) is None:
                        yield each, speed

    def train(
        self, learning: Learning, speed: float, progress: Progress | None = None, *, lasting: bool = False
    ) -> None:
        """Train a network and keep it: where the folder cannot be written, for this shelf alone.

        Parameters
        ----------
        learning : Learning
        speed : float
            Drive speed, rad/s.
        progress : callable, optional
            Called with the number of steps done and their total.
        lasting : bool
            A network that cannot be written is an error.

        Raises
        ------
        CatalogueFileError
            The folder cannot be written, and it has to be.
        """
        assert self._own is not None
        whole, key = _whole(learning), self._key(learning, speed)
        trained = self._training.train(self._matrix, self._own, whole, speed=speed, progress=progress)
        if self._folder is not None:
            try:
                write_network(self._folder, key, trained)
            except CatalogueFileError:
                if lasting:
                    raise
        with self._lock:
            self._known[key] = trained

    def applies(self, sensing: Sensing, learning: Learning, speed: float | None) -> bool:
        """Whether there should be a network for a recording: its sensors are the machine's, and cases are enough.

        It may end below the highest bands, but has to have half of them.
        """
        own = self._own
        if own is None or sensing.cuts != own.cuts[: len(sensing.cuts)] or 2 * sensing.bands < own.bands:
            return False
        return arrangement(sensing, own.cuts) == self._arrangement and self._applies(learning, speed)

    def get(self, sensing: Sensing, learning: Learning, speed: float | None) -> Network | None:
        """Return the network for a recording; None where there is none.

        Parameters
        ----------
        sensing : Sensing
            Of the recording; its noise does not matter.
        learning : Learning
            Hypotheses that it leaves out are left in: a network answers for those it is asked of.
        speed : float, optional
            Drive speed, rad/s.
        """
        if not self.applies(sensing, learning, speed):
            return None
        return self._find(self._key(learning, speed))

    def every(self, sensing: Sensing, learning: Learning, speed: float | None) -> Networks:
        """Return all networks for a recording, arguments as for :meth:`get`."""
        since, strata = replace(learning, subject="since"), replace(learning, subject="strata")
        return Networks(
            self.get(sensing, learning, speed),
            self.get(sensing, since, speed) if sensing.past else None,
            self.get(sensing, strata, speed) if learning.mode == "trusted" else None,
        )

    def _find(self, key: str) -> Network | None:
        with self._lock:
            if key not in self._known and self._folder is not None:
                kept = read_network(self._folder, key)
                if kept is not None:
                    self._known[key] = kept
                    with suppress(OSError):  # where files go that have not been used for long
                        os.utime(self._folder / f"{key}.npz")
            return self._known.get(key)

    def _applies(self, learning: Learning, speed: float | None) -> bool:
        if self._own is None or (learning.subject == "since" and not self._remembers):
            return False
        # Counting the cases of all hypotheses takes longer than an answer by a model that is known.
        asked = (_whole(learning), self._place(speed))
        if asked not in self._enough:
            self._enough[asked] = self._training.enough(self._matrix, asked[0], speed)
        return self._enough[asked]

    def _place(self, speed: float | None) -> float | None:
        return None if speed is None else self._matrix.nearest_speed(speed)

    def _key(self, learning: Learning, speed: float | None) -> str:
        asked = [self._arrangement, repr(_whole(learning)), learning.reach, repr(self._training), self._place(speed)]
        if learning.subject != "hypotheses":
            asked.append(learning.subject)
        if len(self._matrix.speeds) > 1:
            asked.append("individuals")  # are held out at all speeds at once
        return f"{self._matrix.id[:12]}-{content_digest([self._matrix.id, FEATURES_VERSION, MATCHER_VERSION, *asked])}"


def own_sensing(machine: Machine, cuts: tuple[int, ...]) -> Sensing | None:
    """Return what all sensors of a machine see of an entry, with some noise; None where they see nothing."""
    if not machine.sensors or not free_motions(machine):
        return None
    transform, _, channels = choose_channels(machine, [sensor.name for sensor in machine.sensors])
    return Sensing(transform, channels, cuts, np.ones((len(cuts) - 1, len(channels))), np.ones(len(cuts) - 1))


def arrangement(sensing: Sensing, cuts: tuple[int, ...] | None = None) -> str:
    """Return what two sets of sensors have in common whose compared channels see the same, in its bands or in others.

    The order of the sensors does not matter where motions of the frame are compared, and does where the sensors are.
    """
    rows: FloatArray = np.concatenate([sensing.transform, sensing.channels.T], axis=1)
    if not np.array_equal(sensing.channels, np.eye(len(rows))):
        rows = rows[np.lexsort(np.round(rows, 9).T)]
    return content_digest([cuts or sensing.cuts, sensing.phases, (np.round(rows, 9) + 0.0).tolist()])


def _whole(learning: Learning) -> Learning:
    whole = Learning.of(learning.mode, most=None if learning.reach == Learning.reach else learning.reach)
    return replace(whole, subject=learning.subject)
