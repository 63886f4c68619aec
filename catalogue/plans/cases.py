"""The cases that a plan asks for: points of a space-filling sequence a stratum, each of them one machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate, combinations, product
from typing import TypeAlias

import numpy as np
from scipy.special import ndtr, ndtri

from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.day_load import DAY_LOAD
from jointplay.catalogue.plans.driving import speed_path
from jointplay.catalogue.plans.entry import Entry, Hypothesis, Recipe, Stratum, seed_from
from jointplay.catalogue.plans.parameters import (
    LOAD,
    SHARED,
    MachineNumbers,
    Scatter,
    check_drawable,
    is_of_the_day,
    load_order,
    ripple_order,
)
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.plans.plan_parts import Distribution, log_uniform, unit_draws
from jointplay.catalogue.plans.variants import LawChoice, Variant, output_load
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine

TRAVEL_SHARE = 0.1
"""Largest clearance of a joint, as a part of its distance to the next joint of its links: beyond, a pin would leave its
socket or the machine would be another one."""

BEYOND_FIT = 1.25
"""Least clearance of a worn joint, as a part of the greatest play of its fit."""

Numbers: TypeAlias = Mapping[str, float]
"""Numbers of a machine by path, SI."""

_WORN = {"singles": 1, "pairs": 2, "triples": 3}


def travel(machine: Machine, joint: str) -> float:
    """Largest clearance [m] a catalogue gives a joint; infinite for a pin whose links have no other one.

    By it a link leans by as much as :data:`TRAVEL_SHARE`; so does the block of a guide, c at one end and -c at the
    other.
    """
    part = machine.joints[joint]
    if isinstance(part, SlidingJoint):
        return TRAVEL_SHARE * (part.length or 0.0) / 2
    at, links = part.at, set(part.links)
    near = (machine.joints[other] for other in machine.turning_joints if other != joint)
    distances = (math.dist(at, other.at) for other in near if links & set(other.links) and other.at != at)
    return TRAVEL_SHARE * min(distances, default=math.inf)


def hypotheses_of(plan: Plan, machine: Machine) -> tuple[Hypothesis, ...]:
    """The hypotheses of a plan for a machine: healthy, singles, pairs, triples, then chosen sets.

    Raises
    ------
    PlanError
        A set that names a joint which cannot wear; two hypotheses of one name.
    """
    wearing = tuple(sorted(machine.wearing_joints))
    found: dict[Hypothesis, None] = {}
    for family in plan.hypotheses:
        if family == "healthy":
            found[Hypothesis.of(())] = None
        else:
            found |= dict.fromkeys(Hypothesis.of(worn) for worn in combinations(wearing, _WORN[family]))
    for i, chosen in enumerate(plan.sets):
        for joint in chosen:
            if joint not in wearing:
                rule = f"is no joint of machine {machine.name} that can wear; these are {', '.join(wearing)}"
                raise PlanError("plan", f"sets.{i}", joint, rule)
        found[Hypothesis.of(chosen)] = None
    _check_labels(found, machine.name)
    return tuple(found)


def _check_labels(hypotheses: Iterable[Hypothesis], machine: str) -> None:
    """Refuse two hypotheses of one name, as of the joints A and B and of a joint whose name is A+B."""
    known: dict[str, tuple[str, ...]] = {}
    for hypothesis in hypotheses:
        if known.setdefault(hypothesis.label, hypothesis.joints) != hypothesis.joints:
            rule = f"names two hypotheses of machine {machine}: rename a joint"
            raise PlanError("plan", "hypotheses", hypothesis.label, rule)


@dataclass(frozen=True)
class Sequence:
    """One space-filling sequence of draws.

    Parameters
    ----------
    hypothesis : Hypothesis
    stratum : {"trusted", "wide"}
    speed : float
        Factor on the drive speed.
    load : float
        Of the process, N or N m; 0 for what the machine file has.
    count : int
        Draws.
    again : bool
        Whether these are machines in order that the plan has already, on another day.
    """

    hypothesis: Hypothesis
    stratum: Stratum
    speed: float
    load: float
    count: int
    again: bool = False


def sequences_of(plan: Plan, machine: Machine) -> Iterator[Sequence]:
    """All sequences of a plan for a machine."""
    loads = [0.0] if plan.loads is None else [load.size for load in plan.loads]
    differs = any(map(is_of_the_day, plan.spread(machine, "trusted")))  # otherwise another day is the same case
    for hypothesis in hypotheses_of(plan, machine):
        count = plan.draws.of(len(hypothesis.joints)) if hypothesis.is_faulty else plan.draws.healthy
        again = min(count, plan.draws.again) if differs and not hypothesis.is_faulty else 0
        strata: tuple[Stratum, ...] = ("trusted", "wide")
        for stratum in strata:
            for is_again, asked in ((False, count), (True, again)):
                number = plan.wide.count(asked) if stratum == "wide" else asked
                if is_again and stratum == "wide":
                    number = min(number, (plan.wide.count(count) + 1) // 2)
                if number:
                    days = product(plan.speeds, loads)
                    yield from (Sequence(hypothesis, stratum, *day, number, is_again) for day in days)


Change: TypeAlias = Callable[[str, int, LawChoice, Numbers], Numbers]
"""Makes the numbers of a case of its label, draw, contact law and what the plan draws."""


def entries_of(plan: Plan, machine: Machine, change: Change | None = None, *, alike: float = 0.0) -> tuple[Entry, ...]:
    """Every case of a plan for a machine: by hypothesis, stratum, speed, load, then by draw.

    Its numbers may be changed. Contacts of a machine's joints are as much alike, by the correlation of their normal
    scores, each still as likely as the plan says.

    Draw i of a stratum is point i of one space-filling sequence over clearances, contact law and all that is
    uncertain: one machine, the same in order and with any joints worn, at every speed and load, but for what is of the
    day (:func:`~jointplay.catalogue.plans.parameters.is_of_the_day`). Every other wide draw is of a machine that is in
    one hypothesis alone. None depends on what else the plan asks for. So a plan with more draws or hypotheses contains
    the cases of the smaller one, and any number of first draws covers everything evenly.

    Raises
    ------
    PlanError
        A path of `uncertain` that the machine does not have or cannot vary; a set with a joint that it does not
        have; a machine without a constant drive speed or limit cycle; speeds of a motor without a curve; loads of a
        machine that has no output link, or of another kind than that takes.
    """
    plan = plan.resolve(machine)
    if plan.speeds != (1.0,) and speed_path(machine) is None:
        rule = f"must be [1]: what machine {machine.name} turns at, which has no motor curve, is said by its load"
        raise PlanError("plan", "speeds", list(plan.speeds), rule)
    _check_loads(plan, machine)
    strata: tuple[Stratum, ...] = ("trusted", "wide") if plan.wide.draws else ("trusted",)
    for stratum in strata:
        check_drawable(machine, frozenset(plan.spread(machine, stratum)))
    drawing = _Drawing(plan, machine, plan.recipe(machine), change or _leave, alike)
    return tuple(entry for sequence in sequences_of(plan, machine) for entry in drawing.entries(sequence))


def _leave(label: str, draw: int, law: LawChoice, numbers: Numbers) -> Numbers:
    del label, draw, law
    return numbers


def _check_loads(plan: Plan, machine: Machine) -> None:
    """Refuse loads that the output link of a machine does not take."""
    output = output_load(machine)
    for i, load in enumerate(plan.loads or ()):
        kind = "force" if load.torque is None else "torque"
        if output is None:
            rule = f"nothing but the driven link of machine {machine.name} moves on its frame: no output takes a load"
            raise PlanError("plan", f"loads.{i}", str(load), rule)
        if (kind == "torque") != bool(output.arm):
            rule = f"the output of machine {machine.name}, link {output.link}, "
            rule += "turns on the frame: give a torque" if output.arm else "slides on the frame: give a force"
            raise PlanError("plan", f"loads.{i}.{kind}", str(load), rule)


def load_shares(machine: Machine) -> dict[str, float]:
    """Return what share of a load on the output of a machine each number has by which it is drawn, by path.

    The sum over these of share times number is the load of a case, N or N m: the shares are those of a unit vector.
    """
    output = output_load(machine)
    if output is None:
        return {}
    targets = MachineNumbers(Variant("own", (), output.link, ()).machine(machine)).targets(LOAD)
    return {target.path: target.share for target in targets}


@dataclass
class _Drawing:
    """Turns points of the unit cube into cases."""

    plan: Plan
    machine: Machine
    recipe: Recipe
    change: Change
    alike: float
    scatters: dict[tuple[Variant, tuple[str, ...]], Scatter] = field(default_factory=dict)

    def entries(self, sequence: Sequence) -> Iterator[Entry]:
        plan, hypothesis, stratum = self.plan, sequence.hypothesis, sequence.stratum
        able = sorted(self.machine.wearing_joints)
        spread = plan.spread(self.machine, stratum)
        laws = plan.law_weights(self.machine)
        # Coordinates: play of fits, wear, contact law, silence, then what is uncertain in alphabetical order, contacts
        # joint by joint.
        fixed = 2 * len(able) + 2
        columns = fixed + sum(len(able) if path in SHARED else 1 for path in spread)
        draws, points = self._machines(sequence, columns)
        # By chance alone: the same coordinates of two sequences are not independent.
        today = np.random.default_rng(self._seed_of_the_day(sequence)).random((sequence.count, columns + 1))
        _change_the_day(points[:, fixed:], today[:, fixed:], spread, len(able))
        if self.alike:
            self._make_alike(points[:, fixed:], spread, len(able), stratum, draws)
        ranges = {joint: self._range(joint, len(hypothesis.joints)) for joint in hypothesis.joints}
        variants = {law: self._variant(spread, law, is_loaded=sequence.load != 0.0) for law in laws}
        scatters = {law: self._scatter(variant, spread, laws) for law, variant in variants.items()}
        low, high = DAY_LOAD
        loads = sequence.load * (low + (high - low) * today[:, -1])
        outputs = {law: self._outputs(variant) for law, variant in variants.items()} if sequence.load else {}
        for place, (draw, point) in enumerate(zip(draws, points.tolist(), strict=True)):
            is_silent = point[fixed - 1] < plan.fits.silent
            ideal = [joint for joint in able if joint not in ranges] if is_silent else []
            sizes = {}
            for column, joint in enumerate(able):
                if joint in ranges:
                    sizes[joint] = log_uniform(*ranges[joint], point[len(able) + column])
                elif joint not in ideal:
                    sizes[joint] = plan.fits.quantile(point[column], self.machine.joints[joint])
            joints = tuple(sorted(sizes))
            law = _choice(laws, point[fixed - 2])
            parameters = scatters[law].parameters(point[fixed:], sequence.speed)
            for path, share in outputs.get(law, ()):
                parameters[path] = parameters.get(path, 0.0) + share * float(loads[place])
            yield Entry.of(
                self.machine,
                self.recipe,
                hypothesis=hypothesis,
                joints=joints,
                clearances=tuple(sizes[joint] for joint in joints),
                parameters=self.change(hypothesis.label, draw, law, _without(ideal, parameters)),
                draw=draw,
                stratum=stratum,
                speed=sequence.speed,
                variant=variants[law],
                guarded=plan.guard > 0 and draw % plan.guard == 0,
            )

    def _machines(self, sequence: Sequence, columns: int) -> tuple[range, FloatArray]:
        """Numbers (n,) and points (n, columns) of the machines of a sequence.

        Those of wide draws have so much of their own that answers need more of them than the machines in order are:
        every other one is in no other hypothesis.
        """
        seed, count = self.plan.seed, sequence.count
        if sequence.stratum == "trusted":
            return range(count), unit_draws(seed_from(seed, sequence.stratum), columns, count)
        if sequence.again:
            return range(0, 2 * count, 2), unit_draws(seed_from(seed, sequence.stratum), columns, count)
        points = np.empty((count, columns))
        points[0::2] = unit_draws(seed_from(seed, sequence.stratum), columns, (count + 1) // 2)
        points[1::2] = unit_draws(seed_from(seed, sequence.hypothesis.label, "wide"), columns, count // 2)
        return range(count), points

    def _make_alike(
        self, points: FloatArray, spread: Mapping[str, Distribution], joints: int, stratum: Stratum, draws: range
    ) -> None:
        """Give the joints of the machine of each draw, in points (n, columns) of what is uncertain, like contacts."""
        for path, chosen in _columns(spread, joints):
            if path in SHARED and path.startswith("contact."):
                common = unit_draws(seed_from(self.plan.seed, stratum, "alike", path), 1, draws.stop)[draws]
                own = math.sqrt(1.0 - self.alike) * _score(points[:, chosen])
                points[:, chosen] = ndtr(math.sqrt(self.alike) * _score(common) + own)

    def _seed_of_the_day(self, sequence: Sequence) -> int:
        day = (float(sequence.speed), sequence.load, sequence.again)
        return seed_from(self.plan.seed, sequence.hypothesis.label, sequence.stratum, *day)

    def _outputs(self, variant: Variant) -> list[tuple[str, float]]:
        """Paths of the numbers of the process load, and the share that each has of it."""
        targets = MachineNumbers(variant.machine(self.machine)).targets(LOAD)
        return [(target.path, target.share) for target in targets]

    def _range(self, joint: str, worn: int) -> tuple[float, float]:
        """Least and largest clearance of a joint that wears, alone or together with others, m."""
        bounds = self.plan.clearance
        low = max(bounds.low, BEYOND_FIT * self.plan.fits.bounds(self.machine.joints[joint])[1])
        # Draws of several worn joints have too much to fill as it is.
        high = bounds.high * (bounds.beyond if worn == 1 else 1.0)
        return low, max(min(high, travel(self.machine, joint)), 2.0 * low)

    def _variant(self, spread: Mapping[str, Distribution], law: LawChoice, *, is_loaded: bool) -> Variant:
        orders = {order for order in map(ripple_order, spread) if order is not None}
        waves = {order for order in map(load_order, spread) if order is not None}
        load = output_load(self.machine) if is_loaded or LOAD in spread or waves else None
        return Variant(law, tuple(sorted(orders)), load.link if load else "", tuple(sorted(waves)) if load else ())

    def _scatter(self, variant: Variant, spread: Mapping[str, Distribution], laws: Iterable[LawChoice]) -> Scatter:
        """What is drawn for a variant; numbers that only contacts of another law have are left out, others refused."""
        key = (variant, tuple(spread))
        if key not in self.scatters:
            numbers = MachineNumbers(variant.machine(self.machine))
            others = [MachineNumbers(replace(variant, law=law).machine(self.machine)) for law in laws]
            missing = [path for path in spread if path in SHARED and not _has(numbers, path)]
            left_out = [path for path in missing if any(_has(other, path) for other in others)]
            self.scatters[key] = Scatter(numbers, spread, left_out)
        return self.scatters[key]


def _columns(spread: Mapping[str, Distribution], joints: int) -> Iterator[tuple[str, slice]]:
    """Coordinates of what is uncertain, by path."""
    first = 0
    for path in sorted(spread):
        yield path, slice(first, first := first + (joints if path in SHARED else 1))


def _score(points: FloatArray) -> FloatArray:
    """Normal scores of coordinates."""
    return np.asarray(ndtri(np.clip(points, 1e-9, 1.0 - 1e-9)))


def _change_the_day(points: FloatArray, today: FloatArray, spread: Mapping[str, Distribution], joints: int) -> None:
    """Draw, in points (n, columns) of what is uncertain, what is not of the machine but of the day."""
    for path, chosen in _columns(spread, joints):
        if is_of_the_day(path):
            # A joint without oil has none on any day.
            zero, own = spread[path].zero or 0.0, points[:, chosen]
            points[:, chosen] = np.where(own < zero, own, zero + (1.0 - zero) * today[:, chosen])


def _without(joints: Iterable[str], parameters: Mapping[str, float]) -> dict[str, float]:
    """The parameters that are of no contact of these joints."""
    contacts = tuple(f"joints.{joint}." for joint in joints)
    return {path: value for path, value in parameters.items() if not path.startswith(contacts)}


def _has(numbers: MachineNumbers, path: str) -> bool:
    try:
        return bool(numbers.targets(path))
    except PlanError:
        return False


def _choice(weights: Mapping[LawChoice, float], u: float) -> LawChoice:
    """The law that a coordinate stands for: each has a part of the unit interval as large as its weight."""
    total = sum(weights.values())
    laws = list(weights)
    for law, end in zip(laws, accumulate(weights.values()), strict=True):
        if u * total < end:
            return law
    return laws[-1]
