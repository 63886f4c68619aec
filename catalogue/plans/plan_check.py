"""Whether a plan fits a machine, found before anything of it is shown or computed."""

from __future__ import annotations

from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.plans.plan_parts import Draws
from jointplay.solver.machines.machine import Machine

_ONCE = Draws(healthy=1, single=1, pair=1, larger=1)


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
    plan = plan.resolved(machine)
    try:
        entries_of(plan.model_copy(update={"draws": _ONCE}), machine)
    except PlanError as error:
        raise _placed(error, plan, source) from None


def _placed(error: PlanError, plan: Plan, source: str) -> PlanError:
    """The error where it is in the plan; a wide draw takes a number from either of two lists."""
    path, value = error.path, error.value
    drawn = path.removeprefix("uncertain.")
    if drawn != path:
        trusted, wide = plan.uncertain or {}, plan.wide.uncertain or {}
        path = path if drawn in trusted else f"wide.{path}"
        value = trusted.get(drawn, wide.get(drawn))
    return PlanError(source if error.source == "plan" else error.source, path, value, error.rule)
