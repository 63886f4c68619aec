"""Plans: which hypotheses, clearances, speeds and draws a catalogue holds, and how finely each case is computed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from catalogue.draws import Distribution, log_uniform, rounded_levels, unit_draws
from catalogue.entry import Entry, Hypothesis, Recipe
from catalogue.errors import PlanError
from catalogue.keys import content_digest, seed_from
from catalogue.parameters import MachineNumbers, nominal_drive_speed
from solver.errors import MachineError
from solver.machines.fields import Quantity, RuleError, Title, nearest
from solver.machines.machine import Machine
from solver.machines.parts import Part
from solver.machines.refusals import first_error
from solver.machines.units import FREQUENCY, LENGTH, RATIO, TIME
from solver.machines.yamlfile import read_tree
from solver.spectra.sampling import PASS

__all__ = ["Plan", "load_plan", "parse_plan", "preset", "preset_names", "preset_text", "resolve_plan"]

Clearance = Annotated[float, Quantity(LENGTH, above=0.0)]
Count = Annotated[int, Field(ge=1, le=100_000, strict=True)]
Family = Literal["healthy", "singles", "pairs", "as-new"]

DEFAULT_UNCERTAIN: Mapping[str, Distribution] = {
    "drive.speed": Distribution(factor_uniform=(0.97, 1.03)),
    "contact.friction": Distribution(uniform=(0.01, 0.15)),
    "contact.stiffness": Distribution(lognormal=0.6),
    "contact.damping": Distribution(lognormal=1.2),
}
"""What is uncertain about a machine unless a plan says otherwise. Contact numbers scatter widely because they stand for
the contact law, too: real contacts are neither linear nor evenly damped (docs/diagnosis.md, section 5)."""


class ClearanceRange(Part):
    """Log-spaced levels of radial clearance: ``count`` of them from ``low`` to ``high`` [m], both included.

    With ``jitter`` (0 to 1) every draw lies off its level, uniformly within this fraction of the distance to the
    neighbours (in the logarithm); 1 fills the range without gaps, and overshoots its ends by half a distance.
    """

    low: Clearance = 1e-5
    high: Clearance = 1e-3
    count: Annotated[int, Field(ge=1, le=1000, strict=True)] = 24
    jitter: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.high > 0.1:
            raise RuleError("must not be larger than 0.1 m", ("high",), self.high)
        if not (self.low < self.high or (self.low == self.high and self.count == 1)):
            raise RuleError("must be greater than low", ("high",), self.high)
        return self

    @property
    def levels(self) -> tuple[float, ...]:
        """The levels [m], rising."""
        return rounded_levels(self.low, self.high, self.count)

    @property
    def spacing(self) -> float:
        """Distance of two levels in the natural logarithm; 0 for a single one."""
        return math.log(self.high / self.low) / (self.count - 1) if self.count > 1 else 0.0

    def moved(self, level: float, u: float) -> float:
        """The clearance drawn at `level` by the number `u` in [0, 1)."""
        return level * math.exp(self.jitter * self.spacing * (u - 0.5)) if self.jitter else level


class PairGrid(Part):
    """Levels a joint and draws a cell for pairs of worn joints; the range is that of the singles."""

    count: Annotated[int, Field(ge=1, le=100, strict=True)] = 10
    draws: Count = 4


class AsNewFits(Part):
    """As-new machine: every turning joint has a clearance, log-uniform between ``low`` and ``high`` [m]."""

    low: Clearance = 3e-6
    high: Clearance = 2e-5
    draws: Count = 96

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if not self.low < self.high:
            raise RuleError("must be greater than low", ("high",), self.high)
        return self


class Bands(Part):
    """Bands of the stored spectra: on each of the first ``orders``, then ``per_octave``, up to ``f_max`` [Hz]."""

    orders: Annotated[int, Field(ge=1, le=1000, strict=True)] = 40
    per_octave: Annotated[int, Field(ge=1, le=96, strict=True)] = 12
    f_max: Annotated[float, Quantity(FREQUENCY, above=0.0)] = 4000.0


class Plan(Part):
    """Which cases a catalogue holds.

    Parameters
    ----------
    name : str
        For people.
    hypotheses : tuple of {"healthy", "singles", "pairs", "as-new"}
        Families of hypotheses: no clearance at all; one worn turning joint; two of them; small play in every joint.
    clearance : ClearanceRange
        Levels of the worn joint of a single.
    draws : int
        Draws of the uncertain numbers at each level of a single.
    healthy_draws : int
        Draws of the healthy machine.
    pairs : PairGrid
        Levels and draws of pairs.
    as_new : AsNewFits
        Fits and draws of the as-new machine.
    speeds : tuple of float
        Factors on the machine's drive speed; every case is drawn at every one of them.
    seed : int
        Seed of all draws.
    uncertain : mapping of str to Distribution
        What is uncertain, by path in the machine file; ``contact.friction`` and its like mean all turning joints.
    accuracy : {"draft", "standard", "reference"}
        Accuracy of the simulation. For a catalogue, draws are worth more than small steps.
    sample_rate : float
        Of the simulated acceleration [Hz].
    revolutions : float
        Drive revolutions after the transient, at least.
    seconds : float
        Time after the transient at the machine's own drive speed [s], at least.
    bands : Bands
        Bands of the stored spectra.
    """

    name: Title = "unnamed"
    hypotheses: tuple[Family, ...] = ("healthy", "singles")
    clearance: ClearanceRange = ClearanceRange()
    draws: Count = 8
    healthy_draws: Count = 96
    pairs: PairGrid = PairGrid()
    as_new: AsNewFits = AsNewFits()
    speeds: tuple[Annotated[float, Quantity(RATIO, above=0.0)], ...] = (1.0,)
    seed: Annotated[int, Field(ge=0, le=2**63 - 1, strict=True)] = 1
    uncertain: Mapping[str, Distribution] = Field(default_factory=lambda: dict(DEFAULT_UNCERTAIN))
    accuracy: Literal["draft", "standard", "reference"] = "draft"
    sample_rate: Annotated[float, Quantity(FREQUENCY, above=0.0)] = 10_000.0
    revolutions: Annotated[float, Field(ge=3.0, le=1e5)] = 5.0
    seconds: Annotated[float, Quantity(TIME, at_least=0.0)] = 2.5
    bands: Bands = Bands()

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for name in ("hypotheses", "speeds"):
            values = getattr(self, name)
            if not values or len(set(values)) != len(values):
                raise RuleError("must name at least one, and each once", (name,), list(values))
        highest = self.bands.f_max * max(self.speeds)
        if not self.sample_rate >= highest / PASS:
            rule = f"must be at least {highest / PASS:g} Hz: bands reach {highest:g} Hz at the highest speed"
            raise RuleError(rule, ("sample_rate",), self.sample_rate)
        return self

    @property
    def content(self) -> dict[str, Any]:
        """All of the plan as plain data, as it is stored; :func:`parse_plan` reads it back."""
        content: dict[str, Any] = self.model_dump(mode="json", exclude_none=True)
        return content

    @property
    def hash(self) -> str:
        """SHA-256 of everything but the name: two plans with the same hash ask for the same cases."""
        return content_digest({key: value for key, value in self.content.items() if key != "name"})

    def recipe(self, machine: Machine) -> Recipe:
        """How the entries of this plan are simulated and estimated for `machine`.

        Raises
        ------
        PlanError
            The machine has no drive that turns at a constant speed, so its spectra have no orders.
        """
        speed = nominal_drive_speed(machine)
        revolutions = max(self.revolutions, math.ceil(self.seconds * abs(speed) / (2 * math.pi) - 1e-9))
        return Recipe(
            accuracy=self.accuracy,
            sample_rate=self.sample_rate,
            revolutions=float(revolutions),
            orders=self.bands.orders,
            per_octave=self.bands.per_octave,
            f_max=self.bands.f_max,
            nominal_drive_speed=speed,
        )

    def entries(self, machine: Machine) -> tuple[Entry, ...]:
        """Every case of this plan for `machine`, grouped by hypothesis, rising in clearance, then by draw.

        The draws of a case follow from the plan's seed, the hypothesis, its levels and the number of the draw alone;
        so a plan with more draws, levels or hypotheses contains the cases of the smaller one.

        Raises
        ------
        PlanError
            A path of `uncertain` that the machine does not have; a machine without a constant drive speed.
        """
        recipe, numbers = self.recipe(machine), MachineNumbers(machine)
        entries: list[Entry] = []
        for family in self.hypotheses:
            for joints, levels, draws in self._cells(family, tuple(sorted(machine.turning_joints))):
                hypothesis = Hypothesis.as_new() if family == "as-new" else Hypothesis.of(joints)
                for speed in self.speeds:
                    entries += self._drawn(machine, recipe, numbers, hypothesis, joints, levels, speed, draws)
        check_labels({entry.hypothesis for entry in entries}, machine.name)
        return tuple({entry.key: entry for entry in entries}.values())  # without scatter, draws repeat

    def _cells(
        self, family: Family, turning: tuple[str, ...]
    ) -> Iterator[tuple[tuple[str, ...], tuple[float, ...], int]]:
        """Joints, their levels and the number of draws of every cell of a family; joints in alphabetical order."""
        if family == "healthy":
            yield (), (), self.healthy_draws
        elif family == "singles":
            for joint, level in product(turning, self.clearance.levels):
                yield (joint,), (level,), self.draws
        elif family == "pairs":
            levels = rounded_levels(self.clearance.low, self.clearance.high, self.pairs.count)
            for index, first in enumerate(turning):
                for second, low, high in product(turning[index + 1 :], levels, levels):
                    yield (first, second), (low, high), self.pairs.draws
        elif turning:
            yield turning, (), self.as_new.draws

    def _drawn(
        self,
        machine: Machine,
        recipe: Recipe,
        numbers: MachineNumbers,
        hypothesis: Hypothesis,
        joints: tuple[str, ...],
        levels: tuple[float, ...],
        speed: float,
        draws: int,
    ) -> Iterator[Entry]:
        paths = sorted(self.uncertain)
        seed = seed_from(self.seed, hypothesis.label, levels, float(speed))
        # The first numbers of a point move the clearances, used or not: switching the jitter on changes nothing else.
        points = unit_draws(seed, max(1, len(joints) + len(paths)), draws)
        for draw, point in enumerate(points.tolist()):
            moves, rest = point[: len(joints)], point[len(joints) :]
            if not levels:
                clearances = tuple(log_uniform(self.as_new.low, self.as_new.high, u) for u in moves)
            else:
                clearances = tuple(self.clearance.moved(c, u) for c, u in zip(levels, moves, strict=True))
            quantiles = {path: self.uncertain[path].quantile(u) for path, u in zip(paths, rest, strict=False)}
            yield Entry.of(
                machine,
                recipe,
                hypothesis=hypothesis,
                joints=joints,
                clearances=clearances,
                parameters=numbers.drawn(self.uncertain, quantiles, speed),
                draw=draw,
            )


def check_labels(hypotheses: Iterable[Hypothesis], machine: str) -> None:
    """Refuse two hypotheses of one name, as of the joints A and B and of a joint whose name is A+B.

    Raises
    ------
    PlanError
        Names them.
    """
    known: dict[str, tuple[str, ...]] = {}
    for hypothesis in hypotheses:
        if known.setdefault(hypothesis.label, hypothesis.joints) != hypothesis.joints:
            rule = f"names two hypotheses of machine {machine}: rename a joint"
            raise PlanError("plan", "hypotheses", hypothesis.label, rule)


def parse_plan(content: str | Mapping[str, object], source: str = "plan") -> Plan:
    """Read a plan from YAML or JSON text, or from a tree that was read already.

    Parameters
    ----------
    content : str or mapping
        The plan; what it leaves out has the defaults of :class:`Plan`.
    source : str
        What messages call it: a file's name.

    Raises
    ------
    PlanError
        For the first thing that is wrong: file, dotted path, value, rule in one line.
    """
    try:
        tree = read_tree(content, source) if isinstance(content, str) else dict(content)
        return Plan.model_validate(tree)
    except MachineError as error:
        raise PlanError(source, error.path, error.value, error.rule) from None
    except ValidationError as error:
        first = first_error(error, tree, source)
        raise PlanError(source, first.path, first.value, first.rule.replace("Input should be", "must be")) from None


def load_plan(path: str | Path) -> Plan:
    """Read a plan file (YAML or JSON).

    Raises
    ------
    PlanError
        When the file cannot be read, or as :func:`parse_plan`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise PlanError(str(path), "", None, f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise PlanError(str(path), "", None, "is not a text file in UTF-8") from None
    return parse_plan(text, str(path))


def preset_names() -> tuple[str, ...]:
    """Names of the plans that come with the program, from the smallest to the largest."""
    return ("quick", "standard", "thorough")


def preset_text(name: str) -> str:
    """A shipped plan as the text of its file.

    Raises
    ------
    PlanError
        When there is none of that name.
    """
    if name not in preset_names():
        raise PlanError("", "", name, f"is not a shipped plan{nearest(name, preset_names())}")
    return (resources.files("catalogue") / "plans" / f"{name}.yaml").read_text(encoding="utf-8")


def preset(name: str) -> Plan:
    """A shipped plan.

    Raises
    ------
    PlanError
        When there is none of that name.
    """
    return parse_plan(preset_text(name), f"{name}.yaml")


def resolve_plan(name_or_path: str | Path) -> Plan:
    """A shipped plan by its name, or a plan file by its path; an existing file wins.

    Raises
    ------
    PlanError
        When it is neither, or as :func:`parse_plan`.
    """
    text = str(name_or_path)
    if text in preset_names() and not Path(text).is_file():
        return preset(text)
    if not Path(text).exists():
        raise PlanError("", "", text, f"is neither a file nor a shipped plan{nearest(text, preset_names())}")
    return load_plan(text)
