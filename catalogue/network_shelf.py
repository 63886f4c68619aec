"""Networks of a catalogue, one for each mode and stored speed: trained once, kept as files.

Training takes a minute, so networks are for one set of sensors: those of the machine's file, recorded up to the end of
the bands. Recordings by fewer sensors, or at a lower sample rate, are answered by the curves alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from catalogue.keys import content_digest
from catalogue.learning import Learning
from catalogue.matching import FloatArray
from catalogue.modelfile import read_network, write_model
from catalogue.network import Network
from catalogue.network_training import NetworkTraining
from catalogue.observation import Sensing
from catalogue.sensors import compared_channels, free_motions
from catalogue.spectra import Spectra
from catalogue.store import Catalogue
from solver.machines.machine import Machine

__all__ = ["NetworkShelf"]

Progress = Callable[[int, int], None]


class NetworkShelf:
    """Networks of one state of a catalogue; safe to share between threads.

    Parameters
    ----------
    matrix : Spectra
    own : Sensing or None
        What all sensors of the machine see, with any noise; None where they see nothing: then there are no networks.
    folder : Path, optional
        Where networks are kept; they are trained anew for every shelf without it.
    training : NetworkTraining, optional
    """

    def __init__(
        self, matrix: Spectra, own: Sensing | None, folder: Path | None, training: NetworkTraining | None = None
    ) -> None:
        self._matrix, self._folder, self._training = matrix, folder, training or NetworkTraining()
        self.own = own
        self._lock = threading.Lock()
        self._known: dict[str, Network] = {}

    @classmethod
    def of(cls, catalogue: Catalogue, *, kept: bool = True) -> NetworkShelf:
        """Return the shelf of a catalogue, with files in its folder or without."""
        matrix = catalogue.matrix
        own = own_sensing(catalogue.machine, matrix.cuts)
        return cls(matrix, own, catalogue.layout.networks if kept else None)

    def wanted(self) -> Iterator[tuple[Learning, float]]:
        """Yield mode and drive speed (rad/s) of every network the catalogue should have, and has not."""
        for mode in ("trusted", "robust"):
            learning = Learning.of(mode)
            for factor in self._matrix.speeds:
                speed = factor * self._matrix.nominal_speed
                if self._applies(learning, speed) and not self._is_kept(self._key(learning, speed)):
                    yield learning, speed

    def get(
        self, sensing: Sensing | None, learning: Learning, speed: float | None, progress: Progress | None = None
    ) -> Network | None:
        """Return the network for a recording, trained if there is none yet; None where there is to be none.

        Parameters
        ----------
        sensing : Sensing
            Of the recording; its noise does not matter.
        learning : Learning
            Hypotheses that it leaves out are left in: a network answers for those it is asked of.
        speed : float, optional
            Drive speed, rad/s.
        progress : callable, optional
            Called with the number of steps done and their total, while one is trained.
        """
        own = self.own
        if (
            own is None
            or sensing is None
            or arrangement(sensing) != arrangement(own)
            or not self._applies(learning, speed)
        ):
            return None
        key = self._key(learning, speed)
        # One at a time: who comes second finds it trained.
        with self._lock:
            if key not in self._known:
                found = None if self._folder is None else read_network(self._folder, key)
                if found is None:
                    found = self._training.train(self._matrix, own, _whole(learning), speed=speed, progress=progress)
                    if self._folder is not None and write_model(self._folder, key, found):
                        self._forget_others()
                self._known[key] = found
            return self._known[key]

    def _applies(self, learning: Learning, speed: float | None) -> bool:
        return self.own is not None and self._training.enough(self._matrix, _whole(learning), speed)

    def _key(self, learning: Learning, speed: float | None) -> str:
        assert self.own is not None
        speeds = np.array(self._matrix.speeds)
        nearest = int(np.abs(speeds - abs((speed or 0.0) / self._matrix.nominal_speed)).argmin()) if speed else 0
        asked = [arrangement(self.own), repr(_whole(learning)), learning.reach, repr(self._training), nearest]
        return f"{self._matrix.id[:12]}-{content_digest([self._matrix.id, *asked])}"

    def _is_kept(self, key: str) -> bool:
        return self._folder is not None and read_network(self._folder, key) is not None

    def _forget_others(self) -> None:
        """Remove networks of other states of the catalogue."""
        assert self._folder is not None
        for file in self._folder.glob("*.npz"):
            if not file.name.startswith(self._matrix.id[:12]):
                file.unlink(missing_ok=True)


def own_sensing(machine: Machine, cuts: tuple[int, ...]) -> Sensing | None:
    """Return what all sensors of a machine see of an entry, with some noise; None where they see nothing."""
    if not machine.sensors or not free_motions(machine):
        return None
    transform, _, channels = compared_channels(machine, [sensor.name for sensor in machine.sensors])
    return Sensing(transform, channels, cuts, np.ones((len(cuts) - 1, len(channels))), np.ones(len(cuts) - 1))


def arrangement(sensing: Sensing) -> str:
    """Return what two sets of sensors have in common whose compared channels see the same, in whatever order."""
    rows: FloatArray = np.concatenate([sensing.transform, sensing.channels.T], axis=1)
    if sensing.channels.shape[0] == sensing.channels.shape[1]:
        ordered = rows  # sensors are compared themselves: then their order is that of the features
    else:
        ordered = rows[np.lexsort(rows.T)]
    return content_digest([sensing.cuts, np.round(ordered, 9).tolist()])


def _whole(learning: Learning) -> Learning:
    return Learning.of(learning.mode, most=None if learning.reach == Learning.reach else learning.reach)
