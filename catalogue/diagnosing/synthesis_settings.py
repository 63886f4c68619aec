"""Settings of an analysis by synthesis, and the recording it is made for."""

from __future__ import annotations

from dataclasses import dataclass

from jointplay.catalogue.matching.observation import Sensing
from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True)
class Synthesis:
    """Settings of the search.

    Parameters
    ----------
    cases : int
        How many may be simulated, of all hypotheses: two generations at least are.
    certain : float
        Nothing is simulated where one hypothesis alone is in the candidate set and has more probability than this.
    hypotheses : int
        How many are simulated, the most probable first.
    least : float
        Probability below which none is.
    size, elite : int
        Cases of a hypothesis in each generation, and how many of all its cases are kept.
    level_db : float
        Standard deviation of the levels that no simulation explains.
    degrees_of_freedom : float
        Of the Student-t score of a level: a few odd bands, as chaotic motion has them, do not decide.
    seed : int
        Of everything drawn.
    """

    cases: int = 240
    certain: float = 0.9
    hypotheses: int = 3
    least: float = 1e-3
    size: int = 16
    elite: int = 6
    level_db: float = 1.0
    degrees_of_freedom: float = 8.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a recording is compared by.

    Parameters
    ----------
    feature : ndarray, shape (d,)
        Levels, dB.
    sensing : Sensing
        What its sensors see of a motion of the frame.
    drive_speed : float
        Measured, rad/s, > 0.
    """

    feature: FloatArray
    sensing: Sensing
    drive_speed: float
