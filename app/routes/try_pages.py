"""The pages for whoever has no recording yet: one that is simulated, or that ships with the program."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import BadFieldError
from jointplay.app.http.handlers import note, problem_from, templates
from jointplay.app.http.validation import validate
from jointplay.app.pages.page_forms import messages_of, plain_form, quantity_of
from jointplay.app.problems import Problem
from jointplay.app.routes.pages import REFUSALS, context
from jointplay.app.schemas.virtual import BuiltInRequest, VirtualRequest
from jointplay.app.service import of_request
from jointplay.app.shelves.built_in import recordings_of
from jointplay.app.shelves.catalogues import Offer
from jointplay.app.storage.rows import MeasurementRow
from jointplay.solver.machines.units import ACCELERATION, ANGULAR_SPEED, LENGTH, to_si

router = APIRouter(prefix="/try")

WEAR = "wear-"
"""Beginning of the field of a joint's clearance."""

FIELDS = ("catalogue", "wear", "speed", "noise", "revolutions", "seed", "name")
PLACES = {"clearances_um": "wear", "drive_speed_rpm": "speed", "sensor_noise_m_s2": "noise"}
"""Fields of the page for those of the HTTP interface."""


@router.get("")
async def form(request: Request) -> Response:
    """Show the form that asks for a virtual recording, and the recordings that are there."""
    return await show(request, dict(request.query_params))


@router.post("")
async def simulate(request: Request) -> Response:
    """Simulate a recording, and go on to what was understood of it."""
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        row = await of_request(request).add_virtual(read_wanted(given))
    except REFUSALS as error:
        return await show(request, given, problem_from(error))
    return understood(row, given["catalogue"])


@router.post("/built-in")
async def take_built_in(request: Request) -> Response:
    """Store a recording that ships with the program, and go on to what was understood of it."""
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        wanted = validate(BuiltInRequest, {"name": given.get("name", "")})
        row = await of_request(request).add_built_in(wanted.name)
    except REFUSALS as error:
        return await show(request, given, problem_from(error))
    return understood(row, given.get("catalogue", ""))


def understood(row: MeasurementRow, catalogue: str) -> Response:
    """Lead to what was understood of a recording."""
    asked = urlencode({"measurement": row.id, "catalogue": catalogue})
    return RedirectResponse(f"/confirm?{asked}", status_code=303)


def read_wanted(given: dict[str, str]) -> VirtualRequest:
    """Return what the form asks for; numbers without a unit are in that of their field.

    Raises
    ------
    BadFieldError
        For a field that is no number, or measures something else.
    RequestValidationError
        For one that breaks a rule of the HTTP interface.
    """
    members: dict[str, Any] = {"catalogue": given.get("catalogue", "")}
    if not members["catalogue"]:
        raise BadFieldError("choose a catalogue", field="catalogue")
    members["clearances_um"] = {
        name.removeprefix(WEAR): quantity_of(value, f"wear of {name.removeprefix(WEAR)}", "wear", LENGTH, "um") * 1e6
        for name, value in given.items()
        if name.startswith(WEAR)
    }
    if "speed" in given:
        members["drive_speed_rpm"] = quantity_of(given["speed"], "speed", "speed", ANGULAR_SPEED, "rpm") / to_si(
            "1 rpm", ANGULAR_SPEED
        )
    if "noise" in given:
        members["sensor_noise_m_s2"] = quantity_of(given["noise"], "noise", "noise", ACCELERATION, "m/s2")
    for name in ("revolutions", "seed"):
        if name in given:
            if not given[name].isdecimal():
                raise BadFieldError(f"{name}: {given[name][:80]}: must be a whole number", field=name)
            members[name] = int(given[name])
    return validate(VirtualRequest, members)


async def show(request: Request, given: dict[str, str], problem: Problem | None = None) -> Response:
    """Return the page, and what was wrong."""
    service = of_request(request)
    offers = await run_in_threadpool(service.shelf.offers)
    named = [each for each in offers if given.get("catalogue") in (each.description.id, each.description.name)]
    offer = next(iter(named or offers), None)
    members: dict[str, Any] = {"offer": None if offer is None else offer_view(offer, given), "given": given}
    members["title"] = "Try it: jointplay"
    if problem is None:
        return templates.TemplateResponse(request, "try.html", await context(request, **members))
    note(request, problem)
    fields = [PLACES.get(entry["field"].partition(".")[0], entry["field"]) for entry in problem.errors]
    members["messages"] = {field: problem.detail for field in fields if field in FIELDS} or messages_of(problem, FIELDS)
    members["summary"] = None if members["messages"] else {"title": problem.title, "detail": problem.detail}
    whole = await context(request, **members)
    return templates.TemplateResponse(request, "try.html", whole, problem.status, dict(problem.headers))


def offer_view(offer: Offer, given: dict[str, str]) -> dict[str, Any]:
    """Return what the page shows of the catalogue that a recording is to be tried on."""
    nominal = offer.description.nominal_speed_rpm
    return {
        "name": offer.description.name,
        "machine": offer.machine.name,
        "joints": [
            {
                "name": name,
                "field": f"{WEAR}{name}",
                "value": given.get(f"{WEAR}{name}", ""),
                "as_new": "{:g} to {:g}".format(*(1e6 * end for end in offer.machine.joints[name].play_as_new)),
            }
            for name in offer.machine.wearing_joints
        ],
        "speed": "" if nominal is None else f"{nominal:.5g}",
        "built_in": recordings_of(offer.machine),
    }
