"""What the pages of machines show: what each is, who uses it, what was put there before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from jointplay.app.figures.machine_account import drive_of
from jointplay.app.jobs.tasks import MachineLook
from jointplay.app.shelves.catalogues import Offer
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.machine_store import MachineVersion
from jointplay.app.words import spell_moment
from jointplay.solver.machines.drawing import machine_svg
from jointplay.solver.machines.machine import Machine

SOURCE = "machine"
"""What messages call the text on the page; it need not be said there."""

START = """name: my machine
links:                                  # the first link is the frame, which carries the sensors
  bed:   {mass: 40, inertia: 1.5, cg: [0.1, 0]}        # kg, kg m2 about cg, m
  crank: {mass: 0.5, inertia: 1.0e-3, cg: [0.03, 0.1]}
joints:
  O: {kind: turning, links: [crank, bed], at: [0, 0.1], pin_radius: 10 mm}
drive: {kind: rotation, joint: O, speed: 300 rpm}
supports:
  - {kind: mount, link: bed, at: [-0.1, -0.1], stiffness: [2.0e5, 4.0e5], damping: [200, 300]}
  - {kind: mount, link: bed, at: [0.3, -0.1], stiffness: [2.0e5, 4.0e5], damping: [200, 300]}
sensors:
  - {name: left-y, at: [-0.1, 0], direction: [0, 1]}
  - {name: right-x, at: [0.3, 0], direction: [1, 0]}
"""
"""What a new machine file begins with."""


@lru_cache(maxsize=256)
def drawing_of(machine: Machine) -> str:
    """Return the drawing of a machine."""
    return machine_svg(machine)


def card(
    name: str, machine: Machine, shipped: bool, offers: Sequence[Offer], assets: Sequence[AssetRow]
) -> dict[str, Any]:
    """Return what the list shows of a machine."""
    return {
        "name": name,
        "title": machine.name,
        "shipped": shipped,
        "drawing": drawing_of(machine),
        "links": len(machine.links),
        "joints": ", ".join(machine.joints),
        "drive": drive_of(machine),
        "sensors": len(machine.sensors),
        **users_of(machine, offers, assets),
    }


def users_of(machine: Machine, offers: Sequence[Offer], assets: Sequence[AssetRow]) -> dict[str, Any]:
    """Return which catalogues hold a machine, or another of its name, and which assets are one."""
    key = machine.without_clearances().content_key
    same_name = [offer for offer in offers if offer.machine.name == machine.name]
    catalogues = [offer.description.name for offer in offers if offer.machine.content_key == key]
    return {
        "catalogues": catalogues,
        "others": [each.description.name for each in same_name if each.description.name not in catalogues],
        "assets": [asset.external_id for asset in assets if asset.machine == machine.name],
    }


def version_row(version: MachineVersion, current: str) -> dict[str, Any]:
    """Return what the table of versions shows of one."""
    return {
        "number": version.number,
        "saved": f"{spell_moment(version.saved_at)} UTC" if version.saved_at is not None else "–",
        "current": version.content_key == current,
    }


def look_view(look: MachineLook) -> dict[str, Any]:
    """Return what stands beside the text of a machine file: its drawing, why it is refused, what is made of it."""
    problem = look.refusal
    place: Mapping[str, Any] = next(iter(problem.errors), {}) if problem is not None else {}
    line, said = place.get("line"), "" if problem is None else problem.detail
    return {
        "drawing": look.drawing,
        "line": line,
        "refusal": said.removeprefix(f"{SOURCE}: ").removeprefix(f"line {line}: "),
        "account": None if look.account is None else account_view(look.account, look.drive),
    }


def account_view(account: Mapping[str, Any], drive: str) -> dict[str, Any]:
    """Return what the program makes of a machine, in words."""
    held = [*account["coordinates"], *account["closures"]]
    freedoms, integrated = account["degrees_of_freedom"], account["integrated_degrees_of_freedom"]
    return {
        "facts": [
            ("Links", ", ".join(account["links"])),
            ("Joints", ", ".join([*account["turning_joints"], *account["sliding_joints"]])),
            ("Drive", drive),
            ("Degrees of freedom", f"{freedoms}, of which {integrated} are integrated"),
            ("Modelled", f"{len(held)} of {account['unknowns_3n_2j']} unknowns{': ' if held else ''}{', '.join(held)}"),
        ],
        "joints": [
            {
                "name": name,
                "as_new": "{:g} to {:g} µm".format(*joint["play_as_new_um"]),
                "limit": f"{joint['worn_out_from_um']:g} µm",
                "given": joint["limit"] != "default",
            }
            for name, joint in account["joints"].items()
        ],
        "modes": [
            {
                "motion": mode["motion"],
                "frequency": f"{mode['frequency_hz']:.3g} Hz" if mode["frequency_hz"] else "does not swing",
                "damping": f"{mode['damping_ratio']:.2g}",
            }
            for mode in account["suspension_modes"]
        ],
        "left_out": [f"{out['what']}: {out['why']}" for out in account["left_out"]],
        "notes": account["notes"],
    }
