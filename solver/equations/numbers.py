"""Numbers of a machine as a model sees them: folded constants, or symbols where a batch varies them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.joints import Joint, SlidingJoint
from jointplay.solver.machines.machine import Machine

Number = ca.SX | float

#: Numbers of a clearance joint. They are lane parameters, because they differ from case to case; but for what the
#: machine file has as 0 and no case changes: friction, say, then costs nothing.
CONTACT_NUMBERS = (
    "clearance", "stiffness", "damping", "restitution", "hysteresis", "friction", "viscous", "friction_velocity",
    "presliding", "pin_radius", "viscosity",
)  # fmt: skip

#: Where numbers stand that are not of the ``contact``.
_PLACES = {"clearance": "", "pin_radius": "", "viscosity": "film."}


def contact_numbers(joint: Joint) -> dict[str, float]:
    """Contact numbers that a joint has, by name: those of its laws, of a pin its radius and its oil; clearance is 0."""
    names = (name for name in CONTACT_NUMBERS if name not in ("pin_radius", "viscosity") and joint.contact.has(name))
    values = {name: getattr(joint.contact, name, 0.0) or 0.0 for name in names}
    if isinstance(joint, SlidingJoint):
        return values
    oil = {} if joint.film is None else {"viscosity": joint.film.viscosity}
    return values | {"pin_radius": joint.pin_radius} | oil


def contact_paths(machine: Machine, joint: str) -> list[str]:
    """Paths of the contact numbers of a joint that are lane parameters whether or not a case changes them."""
    values = {**contact_numbers(machine.joints[joint]), "clearance": 1.0}
    return [contact_path(joint, name) for name in CONTACT_NUMBERS if values.get(name)]


def contact_path(joint: str, number: str) -> str:
    """Path of a number of a clearance joint: ``joints.A.contact.stiffness``, ``joints.A.clearance``."""
    return f"joints.{joint}.{_PLACES.get(number, 'contact.')}{number}"


class Numbers:
    """Symbols for the numbers that vary from case to case.

    Parameters
    ----------
    varying : iterable of str
        Machine-file paths that become lane parameters. Every other number is folded into the equations.
    """

    def __init__(self, varying: Iterable[str]) -> None:
        self._symbols: dict[str, ca.SX] = {path: ca.SX.sym(path) for path in dict.fromkeys(varying)}
        self._nominal: dict[str, float] = {}

    def __call__(self, path: str, value: float) -> Number:
        """The symbol of `path` where it varies, else `value`; the nominal value is remembered either way."""
        self._nominal[path] = float(value)
        return self._symbols.get(path, float(value))

    def varies(self, path: str) -> bool:
        """Whether `path` is a lane parameter."""
        return path in self._symbols

    @property
    def paths(self) -> tuple[str, ...]:
        """Lane parameters in kernel order."""
        return tuple(self._symbols)

    @property
    def nominal(self) -> dict[str, float]:
        """Value in the machine file of every number asked for so far."""
        return dict(self._nominal)

    @property
    def vector(self) -> ca.SX:
        """Column of the lane parameters, shape (p, 1)."""
        return ca.vertcat(*self._symbols.values()) if self._symbols else ca.SX(0, 1)

    def unused(self) -> tuple[str, ...]:
        """Paths declared as varying that no equation asked for: a misspelt or meaningless path."""
        return tuple(path for path in self._symbols if path not in self._nominal)


@lru_cache(maxsize=1024)
def _sizes(function: ca.Function) -> tuple[list[int], list[tuple[int, int]]]:
    """How many numbers every argument of a function has, and the shapes of its results; asking takes 1 us each."""
    shapes = [function.size_out(i) for i in range(function.n_out())]
    for i, (rows, columns) in enumerate(shapes):
        if function.nnz_out(i) != rows * columns:
            raise ValueError(f"{function.name()}: output {i} is not dense")
    return [function.nnz_in(i) for i in range(function.n_in())], shapes


def evaluate(function: ca.Function, *arguments: ArrayLike) -> list[FloatArray]:
    """Call a function with dense arguments and outputs.

    Parameters
    ----------
    function : casadi.Function
        Such as those of :class:`~jointplay.solver.equations.model.ModelFunctions`.
    arguments : array_like
        Vectors or numbers.

    Returns
    -------
    list of (rows, columns) arrays

    Notes
    -----
    By way of its buffers: CasADi's own conversion of arguments and results takes 60 us, this 20, most functions 1.
    """
    buffer: Any
    buffer, call = function.buffer()
    needed, shapes = _sizes(function)
    given = [np.ascontiguousarray(argument, dtype=np.float64) for argument in arguments]
    found = [np.zeros(shape, order="F") for shape in shapes]
    for i, (argument, count) in enumerate(zip(given, needed, strict=False)):
        if argument.size != count:
            raise ValueError(f"{function.name()}: argument {i} has {argument.size} numbers, not {count}")
        if count:
            buffer.set_arg(i, argument.data)
    for i, result in enumerate(found):
        if result.size:
            buffer.set_res(i, result.reshape(-1, order="F").data)
    call()
    return found
