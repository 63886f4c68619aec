"""Parts of a plan: what is uncertain about a machine, by itself or as said, and space-filling draws of it.

Ranges that a plan leaves open follow from the machine's own numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from scipy.special import ndtri

from jointplay.catalogue.plans.driving import EFFORT_FACTOR, driver_link, load_scale, speed_path
from jointplay.catalogue.plans.variants import LawChoice, output_load
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.fields import QuantityField, RuleError, VectorField
from jointplay.solver.machines.joints import WearingJoint
from jointplay.solver.machines.machine import Machine, has_known_effort
from jointplay.solver.machines.parts import Damper, ForceDrive, Mount, Part, Spring, TorqueDrive
from jointplay.solver.machines.units import FREQUENCY, LENGTH, RATIO

#: Width of the cells of a scrambled Sobol sequence of 30 bits; keeps draws off 0, where a normal quantile is infinite.
_CELL = 2.0**-30

_PositiveBounds = Annotated[tuple[float, float], VectorField((QuantityField(RATIO, above=0.0),) * 2)]


class Distribution(Part):
    """How one number of the machine scatters; exactly one of the fields is given, and ``zero`` or not.

    Parameters
    ----------
    uniform, loguniform : (float, float), optional
        Bounds of a uniform, or log-uniform (> 0), distribution of the number itself, SI.
    either_loguniform : (float, float), optional
        Bounds, > 0, of the log-uniform size of a number of either sign: of what there may be little or much of.
    factor_uniform, factor_loguniform : (float, float), optional
        Bounds, > 0, of a distribution of the factor on the machine's own number.
    lognormal : float, optional
        Standard deviation, > 0, of the natural logarithm of the factor on the machine's own number; its median is 1.
    zero : float, optional
        Share of all draws in which the number is 0: oil that is not there.
    """

    uniform: Annotated[tuple[float, float], VectorField((QuantityField(RATIO),) * 2)] | None = None
    loguniform: _PositiveBounds | None = None
    either_loguniform: _PositiveBounds | None = None
    factor_uniform: _PositiveBounds | None = None
    factor_loguniform: _PositiveBounds | None = None
    lognormal: Annotated[float, QuantityField(RATIO, above=0.0)] | None = None
    zero: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None

    @model_validator(mode="after")
    def _one_in_order(self) -> Self:
        kinds = tuple(name for name in type(self).model_fields if name != "zero")
        given = {name: getattr(self, name) for name in kinds if getattr(self, name) is not None}
        if len(given) != 1:
            raise RuleError(f"must give exactly one of {', '.join(kinds)}")
        for name, value in given.items():
            if isinstance(value, tuple) and value[0] > value[1]:
                raise RuleError("must be [low, high] with low <= high", (name,), list(value))
        return self

    @property
    def is_factor(self) -> bool:
        """Whether :meth:`quantile` is a factor on the machine's own number, not the number itself."""
        return self.uniform is None and self.loguniform is None and self.either_loguniform is None

    def quantile(self, u: float) -> float:
        """Number, or factor, below which the fraction `u` (in [0, 1]) of all draws lies."""
        if self.zero:
            if u < self.zero:
                return 0.0
            u = (u - self.zero) / (1.0 - self.zero)
        if self.lognormal is not None:
            deviate = float(ndtri(min(max(u, _CELL / 2), 1.0 - _CELL / 2)))
            return math.exp(self.lognormal * deviate)
        if self.either_loguniform is not None:
            return math.copysign(log_uniform(*self.either_loguniform, abs(2.0 * u - 1.0)), u - 0.5)
        logarithmic = self.loguniform or self.factor_loguniform
        if logarithmic is not None:
            return log_uniform(*logarithmic, u)
        bounds = self.uniform or self.factor_uniform
        assert bounds is not None  # one of them is given, see _one_in_order
        low, high = bounds
        return low + u * (high - low)

    def __str__(self) -> str:
        """In words: ``x 0.97 to 1.03``."""
        if self.zero:
            return f"{self.model_copy(update={'zero': None})}, 0 in {self.zero:g}"
        if self.lognormal is not None:
            return f"x exp({self.lognormal:g} N(0, 1))"
        if self.either_loguniform is not None:
            return "+-{:g} to {:g} (log)".format(*self.either_loguniform)
        bounds = self.uniform or self.loguniform or self.factor_uniform or self.factor_loguniform
        assert bounds is not None
        scale = " (log)" if self.loguniform or self.factor_loguniform else ""
        return f"{'x ' if self.is_factor else ''}{bounds[0]:g} to {bounds[1]:g}{scale}"


def log_uniform(low: float, high: float, u: float) -> float:
    """Quantile `u` of the log-uniform distribution between `low` and `high`."""
    return low * math.pow(high / low, u)


def unit_draws(seed: int, dimensions: int, count: int) -> FloatArray:
    """The first `count` points of the scrambled Sobol sequence of `seed` in the unit cube.

    Row i does not depend on `count`: asking for more continues the sequence.

    Parameters
    ----------
    seed : int
        Seed of the scrambling.
    dimensions : int
        Numbers drawn at a time, >= 1.
    count : int
        Number of points.

    Returns
    -------
    ndarray, shape (count, dimensions)
        In [0, 1).

    Notes
    -----
    Owen's scrambling as left matrix scrambling with a digital shift (J. Matousek, J. Complexity 14 (1998)), by SciPy.
    Counts that are powers of two are balanced in every dimension.
    """
    from scipy.stats import qmc  # takes half a second to load, which opening a catalogue can do without

    sequence = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    exponent = max(0, math.ceil(math.log2(max(count, 1))))
    points: FloatArray = sequence.random_base2(exponent)
    return points[:count]


Auto = BeforeValidator(lambda value: None if isinstance(value, str) and value == "auto" else value)
"""Lets a file say ``auto`` for what follows from the machine: None."""
Clearance = Annotated[float, QuantityField(LENGTH, above=0.0)]
Count = Annotated[int, Field(ge=1, le=100_000, strict=True)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
NEXT_TO_NONE = 30.0
"""Part of the least play of a fit that a tight one has at least: below, the contact is a stiff spring all the time."""


class ClearanceRange(Part):
    """Radial clearance of worn joints: log-uniform from ``low`` to ``high`` [m], of one alone to ``beyond`` times that.

    It begins later where a joint's fit is wider: wear is what goes beyond it, by a quarter at least. Answers tell
    clearances up to ``high``, and "at least" from there on: what is larger has to be known to be told from two joints.
    """

    low: Clearance = 2.5e-5
    high: Clearance = 2e-3
    beyond: Annotated[float, Field(ge=1.0, le=100.0)] = 2.0

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.high > 0.1:
            raise RuleError("must not be larger than 0.1 m", ("high",), self.high)
        if not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class Fits(Part):
    """Play of the fits of joints that are not worn: log-uniform from ``low`` to ``high`` [m].

    Without them every joint has the range that the machine file says, its ``fit``. In ``tight`` of all joints there is
    next to none (log-uniform down to a thirtieth of the least play), as in a joint that is preloaded or greased. Of all
    machines the ``silent`` have none where they are not worn: ideal joints, as preloaded rolling bearings nearly are.
    """

    low: Clearance | None = None
    high: Clearance | None = None
    tight: Share = 0.1
    silent: Share = 0.25

    def bounds(self, joint: WearingJoint) -> tuple[float, float]:
        """Least and greatest play of a joint [m], tight ones aside."""
        return joint.play_as_new if self.low is None or self.high is None else (self.low, self.high)

    def quantile(self, u: float, joint: WearingJoint) -> float:
        """Play [m] below which the fraction `u` of all fits of a joint lies, in a machine that is not silent."""
        low, high = self.bounds(joint)
        if u < self.tight:
            return log_uniform(low / NEXT_TO_NONE, low, u / self.tight)
        return log_uniform(low, high, (u - self.tight) / max(1.0 - self.tight, 1e-12))

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if (self.low is None) != (self.high is None):
            missing = "low" if self.low is None else "high"
            raise RuleError("must be given with the other bound, or neither (fits are then the machine's)", (missing,))
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class DrawCounts(Part):
    """Number of draws of each hypothesis, by kind: healthy, one worn joint, two, a set of more.

    ``again`` of the healthy ones, the first, are simulated on another day, too: what a machine in order differs by from
    itself.
    """

    healthy: Count = 192
    single: Count = 192
    pair: Count = 192
    larger: Count = 192
    again: Annotated[int, Field(ge=0, le=100_000, strict=True)] = 0

    def of(self, worn: int) -> int:
        """The number for a hypothesis of so many worn joints, 1 at least."""
        return (self.single, self.pair, self.larger)[min(worn, 3) - 1]


class Wide(Part):
    """Further draws in which the machine's own data are uncertain, too: ``draws`` of them for each of the others.

    ``uncertain`` is what is uncertain besides, by path; None (``auto`` in a file) is
    :func:`~jointplay.catalogue.plans.plan_parts.default_wide`.
    """

    draws: Share = 0.0
    uncertain: Annotated[Mapping[str, Distribution] | None, Auto] = None

    def count(self, draws: int) -> int:
        """How many wide draws go with `draws` others."""
        return math.ceil(self.draws * draws - 1e-9)


class Bands(Part):
    """Bands of the stored spectra: on each of the first ``orders``, then ``per_octave``, up to ``f_max`` [Hz]."""

    orders: Annotated[int, Field(ge=1, le=1000, strict=True)] = 100
    per_octave: Annotated[int, Field(ge=1, le=96, strict=True)] = 12
    f_max: Annotated[float, QuantityField(FREQUENCY, above=0.0)] = 4000.0


#: Standard deviation of the logarithm of contact stiffness and damping. The contact law is drawn, so they need not
#: stand for it; docs/measured/catalogues.md says what was compared.
STIFFNESS_SCATTER = DAMPING_SCATTER = 0.4
#: Standard deviations of the logarithm of what every file says a little wrong: mass and inertia of a frame with all
#: that is bolted to it, and each mount: nineteen of twenty pieces of the same rubber lie within 10 % of stiffness.
TOLERANCE = {"mass": 0.025, "inertia": 0.03, "stiffness": 0.05, "damping": 0.15}
#: The same of the frame's modes, whose frequencies tests find to a per cent or two, and whose damping by a fifth.
MODE_TOLERANCE = {"frequency": 0.015, "damping": 0.2}

#: Hysteresis [s/m] of Hertzian contacts: from nearly elastic to a restitution of about a tenth at 0.1 m/s.
HYSTERESIS_RANGE = (0.3, 30.0)
#: Presliding [m] of surfaces that stick: from what stands for Coulomb's law to the micrometre that real ones give way.
PRESLIDING_RANGE = (3e-9, 1e-6)
#: Standard deviation of the logarithm of a machine's friction from day to day.
OIL_SCATTER = 0.1
#: Viscosity of oil, as a factor on what the file says: some 25 K warmer or colder, of which 14 K or so halve it; and
#: the share of joints with oil that run dry, which is what wears them.
VISCOSITY_RANGE, DRY = (0.3, 3.0), 0.2
#: Speed ripple of an order, relative; the low orders of drives that are too weak, 6 and 12 of motors with three phases.
RIPPLE = (1e-4, 1e-2)
RIPPLE_ORDERS = (1, 2, 3, 4, 6, 12)

#: Factors on drive speeds, and on those of a motor's curve.
SPEED = (0.97, 1.03)
#: Factors on a motor's torque at each speed and on the inertia of the link that it drives: what IEC 60034-1 allows of
#: slip (a fifth either way) and inertia (a tenth); and where the machine's data cannot be trusted.
EFFORT, DRIVER_INERTIA, WIDE_EFFORT = (0.8, 1.25), (0.9, 1.1), (0.7, 1.4)

#: Process load, as a part of the weight and the inertia of the moving links; and orders of what comes and goes with a
#: turn, each as a part of that: a force on one of two strokes is 1/2, 0.64, 0 and 0.21 of itself in orders 0 to 3.
LOAD = (0.01, 1.0)
LOAD_ORDERS = {1: 0.6, 2: 0.3, 3: 0.2}


def default_laws(machine: Machine) -> dict[LawChoice, float]:
    """Contact laws that are drawn, with their weights: the machine's own, and the other one of linear and Hertzian."""
    contacts = [machine.joints[joint].contact.law for joint in machine.wearing_joints]
    return {"own": 1.0, "hertz" if "linear" in contacts else "linear": 1.0}


def default_uncertain(machine: Machine, laws: Mapping[LawChoice, float]) -> dict[str, Distribution]:
    """What is not known even of a machine whose data can be trusted: speed, tolerances, and everything about contacts.

    Parameters
    ----------
    machine : Machine
    laws : mapping of str to float
        Contact laws that are drawn.

    Returns
    -------
    dict of str to Distribution
        By path, see :class:`~jointplay.catalogue.plans.parameters.MachineNumbers`.
    """
    filed = [machine.joints[joint].contact for joint in machine.wearing_joints]
    contacts = filed if "own" in laws else []  # any other law takes the place of the file's in every joint
    known = {contact.law for contact in contacts} | set(laws)
    fast = speed_path(machine)
    found = {
        **({fast: Distribution(factor_uniform=SPEED)} if fast else {}),
        **(_motor(machine, EFFORT, DRIVER_INERTIA) if has_known_effort(machine) else {}),
        "contact.friction": Distribution(uniform=(0.01, 0.15)),
        "contact.stiffness": Distribution(lognormal=STIFFNESS_SCATTER),
        "oil": Distribution(lognormal=OIL_SCATTER),
    }
    if any(getattr(joint, "pin_radius", 0.0) > 0 for joint in machine.joints.values()):
        found["pin_radius"] = Distribution(factor_uniform=(0.9, 1.1))
    if any(getattr(joint, "film", None) for joint in machine.joints.values()):
        found["film.viscosity"] = Distribution(factor_loguniform=VISCOSITY_RANGE, zero=DRY)
    if any(machine.joints[joint].contact.friction_law == "bristle" for joint in machine.wearing_joints):
        found["contact.presliding"] = Distribution(loguniform=PRESLIDING_RANGE)
    if "linear" in known:
        found["contact.damping"] = Distribution(lognormal=DAMPING_SCATTER)
    if "hertz" in known:
        found["contact.hysteresis"] = Distribution(loguniform=HYSTERESIS_RANGE)
    asked = [contact.restitution for contact in contacts if contact.restitution is not None]
    if asked:
        low, high = max(0.05, min(asked) - 0.25), min(1.0, max(asked) + 0.25)
        found["contact.restitution"] = Distribution(uniform=(low, high))
    scatter = {path: TOLERANCE[path.rpartition(".")[2]] for path in _frame_and_mounts(machine)}
    scatter |= {path: MODE_TOLERANCE[path.rpartition(".")[2]] for path in _modes(machine)}
    return found | {path: Distribution(lognormal=scatter[path]) for path in scatter}


def default_wide(machine: Machine) -> dict[str, Distribution]:
    """What else is not known of a machine whose data cannot be trusted: frame with modes, supports, load, ripple.

    Supports have one common factor each for x and y, and each mount a smaller one of its own: a single loose mount
    stays outside of all draws.

    Returns
    -------
    dict of str to Distribution
        By path, see :class:`~jointplay.catalogue.plans.parameters.MachineNumbers`.
    """
    factors = {
        "frame.mass": Distribution(factor_uniform=(0.8, 1.2)),
        "frame.inertia": Distribution(factor_uniform=(0.8, 1.2)),
        "supports.stiffness": Distribution(factor_uniform=(0.7, 1.3)),
        "supports.damping": Distribution(factor_loguniform=(0.5, 2.0)),
    }
    own = {"stiffness": Distribution(factor_uniform=(0.85, 1.15)), "damping": Distribution(factor_uniform=(0.8, 1.25))}
    found = {path: factors.get(path) or own[path.rpartition(".")[2]] for path in _frame_and_mounts(machine)}
    if any(path[9:10].isdigit() for path in found):
        found |= {f"supports.{name}.{axis}": factors[f"supports.{name}"] for name in own for axis in "xy"}
    for path, damping in _modes(machine).items():
        wide = Distribution(factor_loguniform=(0.5, min(2.0, 1.0 / damping))) if damping else None
        found[path] = wide or Distribution(factor_uniform=(0.9, 1.1))
    load = output_load(machine)
    scale = 0.0 if load is None else load_scale(machine) * (load.arm or 1.0)
    if scale > 0.0:  # a motor that gives the same torque at any speed bears no other load
        found["load"] = _either(LOAD, scale)
        for order, share in LOAD_ORDERS.items() if not isinstance(machine.drive, ForceDrive) else ():
            spread = _either(LOAD, share * scale)
            found |= {f"load.{order}.sin": spread, f"load.{order}.cos": spread}
    if has_known_effort(machine):  # it ripples as torque and inertia have it
        return found | _motor(machine, WIDE_EFFORT, WIDE_EFFORT)
    for order in RIPPLE_ORDERS:
        spread = _either(RIPPLE, 1.0 / order)
        found |= {f"ripple.{order}.sin": spread, f"ripple.{order}.cos": spread}
    return found


def _motor(machine: Machine, effort: tuple[float, float], inertia: tuple[float, float]) -> dict[str, Distribution]:
    """Factors on a motor's torque or force, and on the inertia of the link that it turns, by path."""
    # Without a curve the speed follows the torque as steeply as the resistance falls short of it.
    found = {EFFORT_FACTOR: Distribution(factor_uniform=effort if speed_path(machine) else SPEED)}
    driver = driver_link(machine)
    if isinstance(machine.drive, TorqueDrive) and driver and machine.links[driver].inertia:
        found[f"links.{driver}.inertia"] = Distribution(factor_uniform=inertia)
    return found


def _frame_and_mounts(machine: Machine) -> list[str]:
    """Short paths of the frame's numbers, as far as it moves, of mounts, and of springs and dampers by themselves."""
    frame = machine.links[machine.frame]
    if frame.fixed:
        return []
    free = {"x", "y", "theta"}.difference(frame.locked)
    moved = {"frame.mass": frame.mass and free & {"x", "y"}, "frame.inertia": frame.inertia and free & {"theta"}}
    paths = [path for path, is_held in moved.items() if is_held]
    own = [(place, each) for place, each in enumerate(machine.supports) if each.link == machine.frame]
    for name, single in (("stiffness", Spring), ("damping", Damper)):
        paths += [f"supports.{place}.{name}" for place, support in own if isinstance(support, Mount)]
        if any(isinstance(support, single) for _, support in own):
            paths.append(f"supports.{name}")
    return paths


def _modes(machine: Machine) -> dict[str, float]:
    """Paths of frequencies and damping ratios of the frame's modes; these ratios, and 0 for frequencies."""
    found: dict[str, float] = {}
    for i, mode in enumerate(machine.modes):
        found[f"modes.{i}.frequency"] = 0.0
        if mode.damping:
            found[f"modes.{i}.damping"] = mode.damping
    return found


def _either(bounds: tuple[float, float], scale: float) -> Distribution:
    low, high = (float(f"{scale * bound:.3g}") for bound in bounds)
    return Distribution(either_loguniform=(low, high))
