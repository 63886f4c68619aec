"""Mounts of machines that are simulated for recordings to come: warmer or colder, and one of them loose in some."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.diagnosing.cause_families import WARMTH, mount_numbers, mounts_of
from jointplay.catalogue.plans.entry import seed_from
from jointplay.solver.machines.machine import Machine

LOOSENED = 1.0 / 3.0
"""Part of the machines of which one mount has come loose."""

LEAST_STIFF = 0.3
"""Factor on the stiffness of a mount that has, at least: a looser one is told by the low orders alone."""


def warm(machine: Machine, parameters: Mapping[str, float], label: str, number: int) -> dict[str, float]:
    """Return numbers of all mounts of a draw of a hypothesis on a day: of rubber that is softer damping is less, too.

    Parameters
    ----------
    machine : Machine
    parameters : mapping of str to float
        Of the draw, SI.
    label : str
    number : int
    """
    generator = np.random.default_rng(seed_from("mounts warm or cold", label, number))
    factor = math.exp(generator.uniform(math.log(WARMTH[0]), math.log(WARMTH[1])))
    return mount_numbers(machine, mounts_of(machine), factor, math.sqrt(factor), parameters)


def loosen(machine: Machine, parameters: Mapping[str, float], label: str, number: int) -> dict[str, float]:
    """Return numbers of the mount of a draw that has come loose, none in most; arguments as for :func:`warm`.

    How its damping goes with that is not known.
    """
    place, factor = find_loose(machine, label, number)
    power = float(np.random.default_rng(seed_from("damping of a loose mount", label, number)).uniform())
    return {} if place < 0 else mount_numbers(machine, [place], factor, factor**power, parameters)


def find_loose(machine: Machine, label: str, number: int) -> tuple[int, float]:
    """Return place and factor on the stiffness of the mount of a draw that has come loose; -1 and 1 where none has."""
    generator = np.random.default_rng(seed_from("mount come loose", label, number))
    mounts, is_loose = mounts_of(machine), generator.uniform() < LOOSENED
    which, factor = generator.uniform(), float(generator.uniform(LEAST_STIFF, 1.0))
    return (mounts[int(which * len(mounts))], factor) if mounts and is_loose else (-1, 1.0)
