"""Mounts of machines that are simulated for recordings to come: warmer or colder, and one of them loose in some."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.diagnosing.cause_families import WARMTH
from jointplay.catalogue.plans.entry import seed_from

LOOSENED = 1.0 / 3.0
"""Part of the machines of which one mount has come loose."""

LEAST_STIFF = 0.3
"""Factor on the stiffness of a mount that has, at least: where the starts of the search for such causes begin."""

_OF_A_MOUNT = re.compile(r"supports\.(\d+)\.(stiffness|damping)\.[01]")


def mounts_of(parameters: Mapping[str, float]) -> tuple[int, ...]:
    """Return the places of mounts of which some number is drawn."""
    found = (_OF_A_MOUNT.fullmatch(path) for path in parameters)
    return tuple(sorted({int(each[1]) for each in found if each}))


def warm(parameters: Mapping[str, float], number: int, when: str) -> dict[str, float]:
    """Return numbers of all mounts of a draw on a day: of rubber that is softer damping is less, too.

    Two days of a machine, "in order" and "to come", have each their own factor.
    """
    generator = np.random.default_rng(seed_from("mounts warm or cold", when, number))
    factor = math.exp(generator.uniform(math.log(WARMTH[0]), math.log(WARMTH[1])))
    return {
        path: factor ** (1.0 if found[2] == "stiffness" else 0.5) * parameters[path]
        for path in parameters
        if (found := _OF_A_MOUNT.fullmatch(path))
    }


def loosen(parameters: Mapping[str, float], number: int) -> dict[str, float]:
    """Return numbers of the mount of a draw that has come loose; none in most. How its damping goes is not known."""
    place, factor = loosened(parameters, number)
    generator = np.random.default_rng(seed_from("damping of a loose mount", number))
    power = {"stiffness": 1.0, "damping": float(generator.uniform())}
    return {
        path: factor ** power[found[2]] * parameters[path]
        for path in parameters
        if (found := _OF_A_MOUNT.fullmatch(path)) and int(found[1]) == place
    }


def loosened(parameters: Mapping[str, float], number: int) -> tuple[int, float]:
    """Return place and factor on the stiffness of the mount of a draw that has come loose; -1 and 1 where none has."""
    generator = np.random.default_rng(seed_from("mount come loose", number))
    mounts, is_loose = mounts_of(parameters), generator.uniform() < LOOSENED
    which, factor = generator.uniform(), float(generator.uniform(LEAST_STIFF, 1.0))
    return (mounts[int(which * len(mounts))], factor) if mounts and is_loose else (-1, 1.0)
