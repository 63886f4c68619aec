"""Numbers of a machine by path: what stands in the file, and what a draw puts in its place."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.driving import speed_path
from jointplay.catalogue.plans.plan_parts import Distribution
from jointplay.catalogue.plans.variants import output_load
from jointplay.solver.cases.groups import SHORTHANDS
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import nearest
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import RotationDrive

SHARED = SHORTHANDS
"""Short paths that stand for a number of every joint that can wear; each joint draws its own."""

LOAD = "load"
"""Short path of the process load of a machine's output link, N or N m."""

OIL = "oil"
"""Short path of the friction of all joints that can wear, which is a little more or less with the oil of the day."""

_USUAL = re.compile(
    r"drive\.(speed|effort_factor)|supports\.\d+\.(stiffness|damping)(\.[01])?|joints\..*\.(contact\..*|pin_radius|film\.viscosity)"
)
"""Numbers that every machine's equations hold."""

_RIPPLE = re.compile(r"ripple\.([1-9][0-9]{0,2})\.(sin|cos)")
_LOAD_ORDER = re.compile(r"load\.([1-9][0-9]{0,2})\.(sin|cos)")
_ONE_MOUNT = re.compile(r"supports\.\d+\.(stiffness|damping)")
_SUPPORTS = {
    f"supports.{name}{'.' + axis if axis else ''}": re.compile(rf"supports\.\d+\.{name}{ending}")
    for name in ("stiffness", "damping")
    for axis, ending in (("x", r"\.0"), ("y", r"\.1"), ("", ""))
}


def check_ground(machine: Machine) -> None:
    """Refuse ground that does not come round with the drive at every speed that is drawn.

    Raises
    ------
    PlanError
        Names the first motion of an anchor that is not of a whole order.
    """
    for i, support in enumerate(machine.supports):
        for k, part in enumerate(support.motion):
            if part.order is None or part.order != round(part.order):
                rule = "a catalogue needs ground that stands, or moves with a whole order of the drive"
                raise PlanError(machine.name, f"supports.{i}.motion.{k}", None, rule)


_OF_THE_DAY = re.compile(r"oil|drive\.(speed|effort_factor|speed_factor)|load(\..+)?|(.*\.)?film\.viscosity")


def is_of_the_day(path: str) -> bool:
    """Whether what is drawn by a path is another from one recording of a machine to the next.

    So are its speed within what is drawn of it, its process load, and the oil, which is as warm as the day; all else
    belongs to the machine.
    """
    return _OF_THE_DAY.fullmatch(path) is not None


def ripple_order(path: str) -> int | None:
    """The order of a short path ``ripple.2.sin``; None for any other path."""
    match = _RIPPLE.fullmatch(path)
    return int(match[1]) if match else None


def load_order(path: str) -> int | None:
    """The order of a short path ``load.2.sin``; None for any other path."""
    match = _LOAD_ORDER.fullmatch(path)
    return int(match[1]) if match else None


@dataclass(frozen=True)
class ParameterTarget:
    """One number that a path of a plan stands for: its path in the machine file, its value there, its share."""

    path: str
    nominal: float
    share: float = 1.0


class MachineNumbers:
    """Every number of a machine by its dotted path (``supports.0.stiffness.1``), and short paths for several.

    ``contact.friction`` and its like mean all joints that can wear, as far as they have such a number, ``oil`` their
    friction together; ``frame.mass``, ``frame.inertia`` the frame; ``supports.stiffness.x`` (``y``; without either,
    of springs) and ``supports.damping.x`` all supports by one factor, ``supports.0.stiffness`` both directions of a
    mount; ``load`` the process load, ``load.1.sin`` and ``load.1.cos`` a term of it over the drive's angle,
    ``ripple.1.sin`` and ``ripple.1.cos`` a term of the drive's ripple, where the variant of the machine has them.

    Parameters
    ----------
    machine : Machine
    """

    def __init__(self, machine: Machine) -> None:
        self._machine, self._name = machine, machine.name
        self.wearing = tuple(sorted(machine.wearing_joints))
        self.by_path: dict[str, float] = dict(_numbers(machine.model_dump(), ""))
        self.speed_path = speed_path(machine)

    def targets(self, path: str) -> tuple[ParameterTarget, ...]:
        """The numbers that `path` of a plan stands for.

        Raises
        ------
        PlanError
            The machine has no such number.
        """
        listed = self._short(path) or ([(path, 1.0)] if path in self.by_path else [])
        if not listed:
            short = [*SHARED, "frame.mass", "frame.inertia", *_SUPPORTS, LOAD, "ripple.1.sin", "ripple.1.cos"]
            rule = f"is not a number of machine {self._name}{nearest(path, [*short, *self.by_path])}"
            raise PlanError("plan", f"uncertain.{path}", None, rule)
        return tuple(ParameterTarget(full, self.by_path[full], share) for full, share in listed)

    def nominal(self, path: str) -> float:
        """The value of a number in the machine file, of several that a short path means the first; 0 without any."""
        try:
            return self.targets(path)[0].nominal
        except PlanError:
            return 0.0

    def _short(self, path: str) -> list[tuple[str, float]]:
        order = ripple_order(path)
        if path in SHARED:
            listed = [(f"joints.{joint}.{path}", 1.0) for joint in self.wearing if self._has(joint, path)]
        elif path == OIL:
            listed = [(f"joints.{joint}.contact.friction", 1.0) for joint in self.wearing]
        elif path in ("frame.mass", "frame.inertia"):
            listed = [(f"links.{self._machine.frame}.{path.partition('.')[2]}", 1.0)]
        elif path in _SUPPORTS:
            listed = [(full, 1.0) for full in self.by_path if _SUPPORTS[path].fullmatch(full)]
        elif order is not None and isinstance(self._machine.drive, RotationDrive):
            terms = [i for i, term in enumerate(self._machine.drive.ripple) if term.order == order]
            listed = [(f"drive.ripple.{terms[-1 - path.endswith('sin')]}.amplitude", 1.0)] if len(terms) > 1 else []
        elif _ONE_MOUNT.fullmatch(path) and path not in self.by_path:
            listed = [(f"{path}.{k}", 1.0) for k in range(2)]
        elif path == LOAD or load_order(path) is not None:
            listed = self._load(load_order(path), is_sine=path.endswith("sin"))
        else:
            listed = []
        return [(full, share) for full, share in listed if full in self.by_path]

    def _has(self, joint: str, path: str) -> bool:
        return self._machine.joints[joint].contact.has(path.rpartition(".")[2])

    def _load(self, order: int | None, *, is_sine: bool) -> list[tuple[str, float]]:
        load = output_load(self._machine)
        # The last ones: a variant's stand behind the machine's own.
        places = [i for i, each in enumerate(self._machine.loads) if each.order == order]
        if load is None or len(places) < (1 if order is None else 2):
            return []
        path = f"loads.{places[-1 - (order is not None and is_sine)]}"
        if load.arm:
            return [(f"{path}.torque", 1.0)]
        return [(f"{path}.force.{k}", share) for k, share in enumerate(load.direction) if share]


def check_drawable(machine: Machine, paths: frozenset[str]) -> None:
    """Refuse numbers that stand in the machine file, but in no equation: angles, orders, points of tables.

    Raises
    ------
    PlanError
        Names the first of them.
    """
    numbers = MachineNumbers(machine)
    doubtful = tuple(sorted(path for path in paths if path in numbers.by_path and not _USUAL.fullmatch(path)))
    if doubtful:
        _check_held(machine, doubtful)


@lru_cache(maxsize=256)
def _check_held(machine: Machine, paths: tuple[str, ...]) -> None:
    try:
        build_model(machine, machine.wearing_joints, paths)
    except MachineError as error:
        raise PlanError("plan", f"uncertain.{error.path}", None, error.rule) from None


class Scatter:
    """What is uncertain about one variant of a machine, resolved once for all draws.

    Parameters
    ----------
    numbers : MachineNumbers
        Of the variant.
    spread : mapping of str to Distribution
        What is drawn, by path.
    left_out : collection of str, optional
        Paths that this variant does not have, though another one has.

    Raises
    ------
    PlanError
        A path that is no number of the machine.
    """

    def __init__(
        self, numbers: MachineNumbers, spread: Mapping[str, Distribution], left_out: Iterable[str] = ()
    ) -> None:
        skipped = set(left_out)
        self._speed_path = numbers.speed_path or ""
        self._speed = numbers.by_path.get(self._speed_path, 1.0)
        self._drawn: list[tuple[int, Callable[[float], float], bool, str, float, float]] = []
        first = 0
        for path in sorted(spread):
            # A joint's column is its own in every variant, whatever numbers its contact law and the other joints have.
            own = [f"joints.{joint}.{path}" for joint in numbers.wearing] if path in SHARED else []
            if path not in skipped:
                for target in numbers.targets(path):
                    column = first + (own.index(target.path) if own else 0)
                    drawn = spread[path]
                    numbers_of = (target.path, target.nominal, target.share)
                    self._drawn.append((column, drawn.quantile, drawn.is_factor, *numbers_of))
            first += len(own) or 1

    def parameters(self, point: list[float], speed: float) -> dict[str, float]:
        """What one draw changes in the machine.

        Parameters
        ----------
        point : list of float
            Coordinates in the unit cube, in alphabetical order of the paths: one a path, of contacts one a joint, in
            alphabetical order, too.
        speed : float
            Factor on the drive speed, besides the drawn one.

        Returns
        -------
        dict of str to float
            Numbers by path, SI.
        """
        parameters: dict[str, float] = {}
        for column, quantile, is_factor, path, nominal, share in self._drawn:
            # Factors of a number multiply: of all mounts, and of one of them.
            parameters[path] = quantile(point[column]) * (parameters.get(path, nominal) if is_factor else share)
        if speed != 1.0:
            parameters[self._speed_path] = parameters.get(self._speed_path, self._speed) * speed
        return parameters


def _numbers(value: object, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, float(value)
        return
    items: Iterable[tuple[object, object]] = ()
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, (list, tuple)):
        items = enumerate(value)
    for name, item in items:
        yield from _numbers(item, f"{path}.{name}" if path else str(name))
