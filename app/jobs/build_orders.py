"""From a request to a build in the queue: everything that can be refused is refused before."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jointplay.app.errors import BadFieldError, BuildOpenError, UnknownMachineError
from jointplay.app.schemas.builds import BuildRequest
from jointplay.app.storage.build_queue import ENDED, BuildQueue, BuildRow
from jointplay.app.storage.machine_store import MachineStore
from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.plan import Plan, parse_plan, preset
from jointplay.catalogue.plans.plan_check import check_plan
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.solver.machines.machine import Machine, parse_machine


def order(queue: BuildQueue, machines: MachineStore, folder: Path, wanted: BuildRequest) -> BuildRow:
    """Put a build into the queue.

    Parameters
    ----------
    queue : BuildQueue
    machines : MachineStore
    folder : Path
        Where the catalogues are.
    wanted : BuildRequest

    Raises
    ------
    BadFieldError
        There is no such machine or plan, or the plan does not fit the machine.
    CatalogueMismatchError
        The catalogue is there, but of another machine, or made otherwise.
    """
    machine = machine_of(machines, wanted.machine)
    plan = plan_of(wanted.plan, machine)
    return place_order(queue, folder, machine, plan, wanted.catalogue, wanted.workers)


def order_again(queue: BuildQueue, folder: Path, key: str) -> BuildRow:
    """Put the same build into the queue once more; it goes on with what the catalogue holds.

    Raises
    ------
    UnknownBuildError
        When there is none of this id.
    BuildOpenError
        When it has not ended.
    CatalogueMismatchError
        The catalogue is another one by now.
    """
    row = queue.find(key)
    if row.state not in ENDED:
        raise BuildOpenError(f"build {key}: is {row.state}, and goes on by itself")
    return place_order(queue, folder, parse_machine(row.machine), parse_plan(row.plan), row.catalogue, row.workers)


def place_order(
    queue: BuildQueue, folder: Path, machine: Machine, plan: Plan, catalogue: str, workers: int | None
) -> BuildRow:
    """Put a build into the queue, if its catalogue can take it."""
    if CatalogueDirectory(folder).manifest.is_file():
        rule = "this service serves one catalogue alone; set JOINTPLAY_CATALOGUES to a folder of catalogues"
        raise BadFieldError(f"catalogue: {catalogue}: {rule}", field="catalogue")
    layout = CatalogueDirectory(folder / catalogue)
    if layout.manifest.is_file():
        Manifest.read(layout).check_accepts(machine, plan.resolve(machine), Path(catalogue))
    content = json.loads(machine.canonical_json())
    return queue.add(content, plan.content, plan.hash, catalogue, workers)


def machine_of(machines: MachineStore, name: str) -> Machine:
    """Return the machine of a name, as a catalogue holds it."""
    try:
        return machines.find(name).without_clearances()
    except UnknownMachineError as error:
        raise BadFieldError(str(error), field="machine") from None


def plan_of(given: Mapping[str, Any] | str, machine: Machine) -> Plan:
    """Return a shipped plan, or the one that is given, if it fits the machine."""
    try:
        # By name alone: a text never is a path here.
        plan = preset(given) if isinstance(given, str) else parse_plan(given)
        check_plan(plan, machine)
    except PlanError as error:
        text = str(error)
        raise BadFieldError(text if text.startswith("plan: ") else f"plan: {text}", field="plan") from None
    return plan
