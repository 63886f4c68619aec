"""``jointplay machines``: what ships with the program."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from jointplay.app.commands.parameters import json_option, print_json
from jointplay.app.figures.machine_account import drive_of
from jointplay.app.tables import table

if TYPE_CHECKING:
    from jointplay.solver.machines.machine import Machine


@click.command("machines")
@click.argument("name", required=False)
@json_option
def command(name: str | None, as_json: bool) -> None:
    """List the machines that ship with the program, or print machine NAME, shipped or a file.

    With --json all that it leaves out is filled in, and a frequency response stands in place of the file that has it.
    """
    from jointplay.solver.machines.machine import load_machine, machine_text, shipped_machine, shipped_machine_names

    if name is not None:
        if as_json:
            print_json(json.loads(load_machine(name).canonical_json()))
        else:
            click.echo(machine_text(name), nl=False)
        return
    machines = {each: shipped_machine(each) for each in shipped_machine_names()}
    if as_json:
        print_json([brief(each, machine) for each, machine in machines.items()])
        return
    rows = [
        (
            each,
            str(len(machine.links)),
            " ".join(machine.turning_joints),
            " ".join(machine.sliding_joints) or "-",
            drive_of(machine),
        )
        for each, machine in machines.items()
    ]
    click.echo(table(("machine", "links", "turning joints", "sliding joints", "drive"), rows, frozenset({1})))


def brief(name: str, machine: Machine) -> dict[str, object]:
    """Return what the list says about a machine."""
    return {
        "name": name,
        "content_key": machine.content_key,
        "links": len(machine.links),
        "turning_joints": list(machine.turning_joints),
        "sliding_joints": list(machine.sliding_joints),
        "sensors": [sensor.name for sensor in machine.sensors],
    }
