"""Plans: which hypotheses, clearances, speeds and draws a catalogue holds, and how finely each case is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.day_load import DayLoad
from jointplay.catalogue.plans.driving import nominal_drive_speed
from jointplay.catalogue.plans.entry import Recipe, Stratum, content_digest
from jointplay.catalogue.plans.parameters import check_ground
from jointplay.catalogue.plans.plan_parts import (
    Auto,
    Bands,
    ClearanceRange,
    Distribution,
    DrawCounts,
    Fits,
    Wide,
    default_laws,
    default_uncertain,
    default_wide,
)
from jointplay.catalogue.plans.variants import LawChoice
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import Name, QuantityField, RuleError, Title, nearest
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Part
from jointplay.solver.machines.refusals import first_error
from jointplay.solver.machines.units import FREQUENCY, RATIO, TIME
from jointplay.solver.machines.yamlfile import read_text, read_tree
from jointplay.solver.spectra.sampling import PASS

Family = Literal["healthy", "singles", "pairs", "triples"]


class Plan(Part):
    """Which cases a catalogue holds.

    Parameters
    ----------
    name : str
        For people.
    hypotheses : tuple of {"healthy", "singles", "pairs", "triples"}
        Families of hypotheses: no worn joint; one; two; three. Joints that are not worn have the play of their fits.
    sets : tuple of tuple of str
        Further hypotheses: chosen sets of worn joints.
    draws : DrawCounts
        Draws of each hypothesis.
    clearance : ClearanceRange
        Of worn joints.
    fits : Fits
        Play of the joints that are not worn.
    uncertain : mapping of str to Distribution, optional
        What is uncertain even of a machine whose data can be trusted, by path in the machine file or short path
        (:class:`~jointplay.catalogue.plans.parameters.MachineNumbers`); None, or "auto" in a file, is
        :func:`~jointplay.catalogue.plans.plan_parts.default_uncertain`.
    laws : mapping of {"own", "linear", "hertz"} to float, optional
        Weights of the contact laws that are drawn; None, or "auto" in a file, is
        :func:`~jointplay.catalogue.plans.plan_parts.default_laws`.
    wide : Wide
        Draws of a machine whose own data are uncertain, too.
    speeds : tuple of float
        Factors on the machine's drive speed; every hypothesis is drawn at every one of them.
    loads : tuple of DayLoad, optional
        Loads of the process, as conditions of the day; every hypothesis is drawn at every one of them and of the
        speeds. None: only what the machine file has.
    guard : int
        One draw in so many is computed again at accuracy "standard", and the difference kept; 0 for none.
    seed : int
        Seed of all draws.
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
    sets: tuple[Annotated[tuple[Name, ...], Field(min_length=1)], ...] = ()
    draws: DrawCounts = DrawCounts()
    clearance: ClearanceRange = ClearanceRange()
    fits: Fits = Fits()
    uncertain: Annotated[Mapping[str, Distribution] | None, Auto] = None
    laws: Annotated[Mapping[LawChoice, Annotated[float, QuantityField(RATIO, above=0.0)]] | None, Auto] = None
    wide: Wide = Wide()
    speeds: tuple[Annotated[float, QuantityField(RATIO, above=0.0)], ...] = (1.0,)
    loads: tuple[DayLoad, ...] | None = None
    guard: Annotated[int, Field(ge=0, le=1_000_000, strict=True)] = 50
    seed: Annotated[int, Field(ge=0, le=2**63 - 1, strict=True)] = 1
    accuracy: Literal["draft", "standard", "reference"] = "draft"
    sample_rate: Annotated[float, QuantityField(FREQUENCY, above=0.0)] = 10_000.0
    revolutions: Annotated[float, Field(ge=3.0, le=1e5)] = 5.0
    seconds: Annotated[float, QuantityField(TIME, at_least=0.0)] = 1.0
    bands: Bands = Bands()

    @model_validator(mode="after")
    def _whole(self) -> Self:
        given: dict[str, Sequence[object]] = {"hypotheses": self.hypotheses, "speeds": self.speeds}
        if self.loads is not None:
            given["loads"] = [load.size for load in self.loads]
        for name, values in given.items():
            if not values or len(set(values)) != len(values):
                raise RuleError("must name at least one, and each once", (name,), list(values))
        for i, chosen in enumerate(self.sets):
            if len(set(chosen)) != len(chosen):
                raise RuleError("must name each joint once", ("sets", i), list(chosen))
        for where, drawn in ((("uncertain",), self.uncertain), (("wide", "uncertain"), self.wide.uncertain)):
            for path, law in (drawn or {}).items():
                if law.zero and not path.endswith("film.viscosity"):
                    raise RuleError(
                        "is for film.viscosity alone, of joints that run dry", (*where, path, "zero"), law.zero
                    )
        if self.laws is not None and not self.laws:
            raise RuleError("must name at least one", ("laws",), {})
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
            The machine has no drive that turns at a constant speed, so its spectra have no orders; or it stands on
            ground that moves otherwise.
        """
        check_ground(machine)
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

    def resolve(self, machine: Machine) -> Plan:
        """The plan with what it leaves to the machine ("auto") written out; what a catalogue stores."""
        laws = self.law_weights(machine)
        wide = self.wide
        if wide.uncertain is None:
            wide = wide.model_copy(update={"uncertain": default_wide(machine) if wide.draws else {}})
        uncertain = default_uncertain(machine, laws) if self.uncertain is None else self.uncertain
        return self.model_copy(update={"laws": laws, "uncertain": uncertain, "wide": wide})

    def difference(self, other: Plan, machine: Machine) -> str:
        """What is drawn differently in two plans for a machine, so that their draws do not mix; empty if nothing is."""
        ours, theirs = self.resolve(machine), other.resolve(machine)
        if ours.clearance != theirs.clearance:
            return "clearance"
        if ours.fits != theirs.fits:
            return "fits"
        if ours.laws != theirs.laws:
            return "laws"
        strata: tuple[Stratum, ...] = ("trusted", "wide") if ours.wide.draws and theirs.wide.draws else ("trusted",)
        for stratum in strata:
            first, second = ours.spread(machine, stratum), theirs.spread(machine, stratum)
            for path in sorted({*first, *second}):
                if first.get(path) != second.get(path):
                    return f"{'wide.' if stratum == 'wide' else ''}uncertain.{path}"
        return ""

    def law_weights(self, machine: Machine) -> Mapping[LawChoice, float]:
        """Weights of the contact laws that are drawn."""
        return default_laws(machine) if self.laws is None else self.laws

    def spread(self, machine: Machine, stratum: Stratum) -> dict[str, Distribution]:
        """What is uncertain in a stratum, by path."""
        plan = self.resolve(machine)
        assert plan.uncertain is not None
        assert plan.wide.uncertain is not None
        return {**plan.uncertain, **plan.wide.uncertain} if stratum == "wide" else dict(plan.uncertain)


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
    return (resources.files("jointplay.catalogue") / "plans" / f"{name}.yaml").read_text(encoding="utf-8")


def preset(name: str) -> Plan:
    """A shipped plan.

    Raises
    ------
    PlanError
        When there is none of that name.
    """
    return parse_plan(preset_text(name), f"{name}.yaml")


def load_plan(name_or_path: str | Path) -> Plan:
    """Read a shipped plan by its name, or a plan file (YAML or JSON) by its path; an existing file wins.

    Raises
    ------
    PlanError
        When it is neither, when the file cannot be read, or as :func:`parse_plan`.
    """
    names, name = preset_names(), str(name_or_path)
    if name in names and not Path(name).is_file():
        return preset(name)
    try:
        text = read_text(name, "plan", names)
    except MachineError as error:
        raise PlanError(name, "", None, error.rule) from None
    return parse_plan(text, name)
