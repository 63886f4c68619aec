"""Mounts of machines that are simulated for recordings to come: warmer or colder, and one of them loose in some."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from jointplay.catalogue.diagnosing.cause_families import WARMTH
from jointplay.catalogue.plans.entry import seed_from
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Mount

LOOSENED = 1.0 / 3.0
"""Part of the machines of which one mount has come loose."""

LEAST_STIFF = 0.3
"""Factor on the stiffness of a mount that has, at least: a looser one is told by the low orders alone."""


def mounts_of(machine: Machine) -> tuple[int, ...]:
    """Return the places of mounts among the supports of a machine."""
    return tuple(place for place, support in enumerate(machine.supports) if isinstance(support, Mount))


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
    found: dict[str, float] = {}
    for place in mounts_of(machine):
        found |= _changed(machine, parameters, place, factor, math.sqrt(factor))
    return found


def loosen(machine: Machine, parameters: Mapping[str, float], label: str, number: int) -> dict[str, float]:
    """Return numbers of the mount of a draw that has come loose, none in most; arguments as for :func:`warm`.

    How its damping goes with that is not known.
    """
    place, factor = find_loose(machine, label, number)
    power = float(np.random.default_rng(seed_from("damping of a loose mount", label, number)).uniform())
    return {} if place < 0 else dict(_changed(machine, parameters, place, factor, factor**power))


def find_loose(machine: Machine, label: str, number: int) -> tuple[int, float]:
    """Return place and factor on the stiffness of the mount of a draw that has come loose; -1 and 1 where none has."""
    generator = np.random.default_rng(seed_from("mount come loose", label, number))
    mounts, is_loose = mounts_of(machine), generator.uniform() < LOOSENED
    which, factor = generator.uniform(), float(generator.uniform(LEAST_STIFF, 1.0))
    return (mounts[int(which * len(mounts))], factor) if mounts and is_loose else (-1, 1.0)


def _changed(
    machine: Machine, parameters: Mapping[str, float], place: int, stiff: float, damped: float
) -> Iterator[tuple[str, float]]:
    """Numbers of a mount by path, with factors on stiffness and damping."""
    mount = machine.supports[place]
    assert isinstance(mount, Mount)
    for name, factor, filed in (("stiffness", stiff, mount.stiffness), ("damping", damped, mount.damping)):
        for axis in (0, 1):
            path = f"supports.{place}.{name}.{axis}"
            yield path, factor * parameters.get(path, filed[axis])
