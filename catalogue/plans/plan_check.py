"""A plan before it is built: whether it fits a machine, and in words what it asks for."""

from __future__ import annotations

import math

from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.cases import entries_of, sequences_of
from jointplay.catalogue.plans.day_load import DAY_LOAD
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.plans.plan_parts import SPEED, DrawCounts
from jointplay.solver.cases.answers import check_band
from jointplay.solver.cases.causes import check_record
from jointplay.solver.errors import SettingsError, SolverError
from jointplay.solver.machines.machine import Machine, has_known_effort
from jointplay.solver.spectra.sensor import rigid_body, sensor_transform

MOST_CASES = 2_000_000
"""Of one plan: a builder holds the list of them, some kilobytes each."""

_ONCE = DrawCounts(healthy=1, single=1, pair=1, larger=1)


def check_plan(plan: Plan, machine: Machine, source: str = "plan") -> None:
    """Refuse a plan that does not fit a machine, by one draw of each of its sequences.

    Parameters
    ----------
    plan : Plan
    machine : Machine
    source : str
        What messages call the plan: a file's name.

    Raises
    ------
    PlanError
        As :func:`jointplay.catalogue.plans.cases.entries_of`, with all of it: file, dotted path in the plan, what
        stands there, rule.
    """
    plan = plan.resolve(machine)
    _check_response(plan, machine)
    try:
        _check_size(plan, machine)
        entries_of(plan.model_copy(update={"draws": _ONCE}), machine)
    except PlanError as error:
        raise _place(error, plan, source) from None


def _check_size(plan: Plan, machine: Machine) -> None:
    """Refuse what no build can hold: the same set twice, cases without number, a case without end."""
    known: dict[frozenset[str], int] = {}
    for place, chosen in enumerate(plan.sets):
        first = known.setdefault(frozenset(chosen), place)
        if first != place:
            raise PlanError("plan", f"sets.{place}", list(chosen), f"is the same set as sets.{first}")
    cases = sum(sequence.count for sequence in sequences_of(plan, machine))
    if cases > MOST_CASES:
        raise PlanError("plan", "draws", None, f"make {cases} cases of all hypotheses; at most {MOST_CASES} are built")
    recipe, slowest = plan.recipe(machine), min(plan.speeds)
    duration = recipe.revolutions * 2 * math.pi / (slowest * abs(recipe.nominal_drive_speed))
    try:
        check_record(recipe.sample_rate, duration)
    except SettingsError as error:
        path = "revolutions" if recipe.revolutions == plan.revolutions else "seconds"
        raise PlanError("plan", path, getattr(plan, path), str(error)) from None


def _check_response(plan: Plan, machine: Machine) -> None:
    """Refuse a frequency response that says less than the plan's entries hold."""
    if machine.response is None:
        return
    transform = sensor_transform(
        [sensor.at for sensor in machine.sensors], [sensor.direction for sensor in machine.sensors],
        machine.links[machine.frame].cg,
    )  # fmt: skip
    if not rigid_body(transform).observable:
        rule = "a catalogue needs three sensors or more, from which x, y and theta of the frame follow"
        raise PlanError(machine.name, "response.sensors", ", ".join(machine.response.sensors), rule)
    recipe = plan.recipe(machine)
    try:
        for speed in plan.speeds:
            check_band(machine, recipe.sample_rate, SPEED[0] * speed * recipe.nominal_drive_speed)
    except SolverError as error:
        raise PlanError(machine.name, "response.frequency", None, str(error)) from None


def _place(error: PlanError, plan: Plan, source: str) -> PlanError:
    """The error where it is in the plan; a wide draw takes a number from either of two lists."""
    path, value = error.path, error.value
    drawn = path.removeprefix("uncertain.")
    if drawn != path:
        trusted, wide = plan.uncertain or {}, plan.wide.uncertain or {}
        path = path if drawn in trusted else f"wide.{path}"
        value = trusted.get(drawn, wide.get(drawn))
    return PlanError(source if error.source == "plan" else error.source, path, value, error.rule)


def plan_lines(plan: Plan, machine: Machine) -> tuple[str, ...]:
    """What a plan asks for, line by line.

    Parameters
    ----------
    plan : Plan
    machine : Machine

    Returns
    -------
    tuple of str
        Name and hash, hypotheses with their draws, ranges, laws, what is uncertain, how cases are computed.

    Raises
    ------
    PlanError
        The plan does not fit the machine.
    """
    plan = plan.resolve(machine)
    recipe = plan.recipe(machine)
    kinds: dict[str, list[str]] = {}
    cases = {"trusted": 0, "wide": 0}
    for sequence in sequences_of(plan, machine):
        worn = len(sequence.hypothesis.joints)
        kind = ("", "single", "pair", "triple")[worn] if worn < 4 else f"{worn} joints"
        kind = kind or sequence.hypothesis.label
        labels = kinds.setdefault(kind, [])
        if sequence.hypothesis.label not in labels:
            labels.append(sequence.hypothesis.label)
        cases[sequence.stratum] += sequence.count
    hypotheses = ", ".join(kind if labels == [kind] else f"{len(labels)} of a {kind}" for kind, labels in kinds.items())
    counts = plan.draws.model_dump(exclude={"again"})
    draws = ", ".join(f"{name} {count}" for name, count in counts.items())
    if again := min(plan.draws.again, plan.draws.healthy):
        draws += f"; {again} of the healthy ones on another day, too"
    laws = ", ".join(f"{law} {weight:g}" for law, weight in (plan.laws or {}).items())
    lines = [
        f"plan {plan.name}, {plan.hash[:12]}: {sum(cases.values())} cases "
        f"({cases['trusted']} trusted, {cases['wide']} wide)",
        f"hypotheses: {hypotheses}",
        f"draws: {draws}",
        f"clearance: worn {_um(plan.clearance.low, plan.clearance.high)} "
        f"(one alone to {plan.clearance.beyond:g} times that), fits {_fits(plan, machine)}, next to none in "
        f"{100 * plan.fits.tight:g} % of them, none at all in {100 * plan.fits.silent:g} % of the machines",
        f"contact laws: {laws}",
        f"uncertain: {_list_cases(plan, machine, wide=False)}",
    ]
    if plan.wide.draws:
        lines.append(f"uncertain in the wide draws, too: {_list_cases(plan, machine, wide=True)}")
    nominal = recipe.nominal_drive_speed * 30.0 / math.pi
    lines.append(f"drive: {', '.join(f'{nominal * factor:.6g}' for factor in plan.speeds)} rpm")
    if plan.speeds != (1.0,):
        lines.append(f"speeds: {', '.join(f'x {speed:g}' for speed in plan.speeds)}")
    if plan.loads is not None:
        low, high = DAY_LOAD
        lines.append(f"loads: {', '.join(map(str, plan.loads))}, each x {low:g} to {high:g}")
    guard = f"; one draw in {plan.guard} again at standard" if plan.guard and plan.accuracy != "standard" else ""
    signal = f"{recipe.sample_rate:g} Hz, {recipe.revolutions:g} revolutions"
    lines.append(f"computed: {plan.accuracy}{guard}; {signal}; seed {plan.seed}")
    if has_known_effort(machine):
        lines.append("assumed: each case has one limit cycle; of several, the one that its start leads to is recorded")
    return tuple(lines)


def _list_cases(plan: Plan, machine: Machine, *, wide: bool) -> str:
    trusted = plan.spread(machine, "trusted")
    shown = trusted
    if wide:
        shown = {path: spread for path, spread in plan.spread(machine, "wide").items() if trusted.get(path) != spread}
    return ", ".join(f"{path} {spread}" for path, spread in shown.items()) or "nothing"


def _fits(plan: Plan, machine: Machine) -> str:
    """Play of the joints that are not worn: one range, or that of each joint."""
    ranges = {name: _um(*plan.fits.bounds(machine.joints[name])) for name in sorted(machine.wearing_joints)}
    if len(set(ranges.values())) == 1:
        return next(iter(ranges.values()))
    return ", ".join(f"{name} {text}" for name, text in ranges.items())


def _um(low: float, high: float) -> str:
    return f"{1e6 * low:g}-{1e6 * high:g} um"
