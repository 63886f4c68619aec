"""What recordings of a machine in order have told of it, as cases of it are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jointplay.catalogue.plans.entry import seed_from
from jointplay.catalogue.plans.variants import LawChoice
from jointplay.solver.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class ToldNumbers:
    """Numbers of a machine as recordings of it have told them, by a normal law.

    Parameters
    ----------
    paths : tuple of str
    mean : ndarray, shape (p,)
        SI, or of the logarithm.
    covariance : ndarray, shape (p, p)
    logarithmic : ndarray of bool, shape (p,)
        Of which numbers.
    contacts : ToldContacts, optional
    """

    paths: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray
    logarithmic: BoolArray
    contacts: ToldContacts | None = None

    @property
    def error(self) -> FloatArray:
        """Standard deviations, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def _root(self) -> FloatArray:
        """Of the correlation; what is wholly alike, or certain, makes it singular."""
        scale = np.where(self.error > 0.0, self.error, 1.0)
        alike = self.covariance / np.outer(scale, scale)
        return np.asarray(np.linalg.cholesky(alike + 1e-9 * np.eye(len(alike))))

    def draw(self, number: int, of: str = "numbers") -> dict[str, float]:
        """Return numbers by path, SI, of the machine of a draw; those of one thing do not go with those of another."""
        normal = np.random.default_rng(seed_from(f"{of} as told", number)).normal(size=len(self.paths))
        drawn = self.mean + self.error * (self._root @ normal)
        drawn[self.logarithmic] = np.exp(drawn[self.logarithmic])
        return dict(zip(self.paths, drawn.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class ToldContacts:
    """Contacts of a machine as recordings of it have told them: of all its joints together.

    Parameters
    ----------
    laws : mapping of str to float
        How probable each contact law is.
    numbers : mapping of str to ToldNumbers
        By law, by short paths (``contact.stiffness``): geometric means over the joints.
    """

    laws: Mapping[LawChoice, float]
    numbers: Mapping[LawChoice, ToldNumbers]

    def draw(self, law: LawChoice, number: int, drawn: Mapping[str, float]) -> dict[str, float]:
        """Return numbers of the contacts of the machine of a draw, by path, SI: joints differ as they were drawn to."""
        found: dict[str, float] = {}
        for path, mean in self.numbers[law].draw(number, "contacts").items():
            own = of_joints(drawn, path)
            factor = mean / geometric_mean(own)
            found |= {name: factor * value for name, value in own.items()}
        return found


def of_joints(parameters: Mapping[str, float], path: str) -> dict[str, float]:
    """Return the numbers that a short path of contacts stands for, by path; empty where joints have none."""
    return {name: value for name, value in parameters.items() if name.endswith(f".{path}")}


def geometric_mean(own: Mapping[str, float]) -> float:
    """Of numbers > 0."""
    return math.exp(math.fsum(map(math.log, own.values())) / len(own))
