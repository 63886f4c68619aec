"""The catalogue browser: what does a worn joint look like against a machine in order?"""

from __future__ import annotations

from typing import Any, cast, get_args

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.errors import BadFieldError
from jointplay.app.figures.pictures import machine_picture
from jointplay.app.http.handlers import is_fragment, note, problem_from, templates
from jointplay.app.pages import browsing
from jointplay.app.pages.page_forms import messages_of, plain_number
from jointplay.app.routes.pages import REFUSALS, context
from jointplay.app.rows import NAMES, micrometres, order
from jointplay.app.service import Service, of_request
from jointplay.app.shelves.catalogues import Offer
from jointplay.solver.errors import UnitError
from jointplay.solver.machines.units import LENGTH, to_si
from jointplay.solver.spectra.spectrum import Quantity, Scaling, frame_units, value_units

router = APIRouter(prefix="/catalogues")

FIELDS = ("hypothesis", "clearance", "quantity", "scaling")
USUAL = {"clearance": "200", "quantity": "acceleration", "scaling": "rms"}
LARGEST = 0.1
CHOICES = {"quantity": get_args(Quantity), "scaling": get_args(Scaling)}


@router.get("")
async def catalogues(request: Request) -> Response:
    """List the catalogues."""
    return templates.TemplateResponse(request, "catalogues.html", await context(request, title="Catalogues: jointplay"))


@router.get("/{name}")
async def catalogue(request: Request, name: str) -> Response:
    """Show an entry of a catalogue beside a machine in order."""
    service = of_request(request)
    given = {field: request.query_params.get(field, "").strip() for field in FIELDS}
    try:
        offer = await run_in_threadpool(service.shelf.find, name)
    except REFUSALS as error:
        problem = problem_from(error)
        note(request, problem)
        summary = {"title": problem.title, "detail": problem.detail}
        members = await context(request, summary=summary)
        return templates.TemplateResponse(request, "catalogues.html", members, problem.status)
    chosen = {field: given[field] or USUAL.get(field) or usual(offer) for field in FIELDS}
    members = {"catalogue": offer.description, "chosen": chosen, "entry": None, "summary": None, "choices": CHOICES}
    status, headers = 200, {}
    try:
        members |= {"entry": await show_nearest(service, offer, chosen), "messages": {}}
    except REFUSALS as error:
        problem = problem_from(error)
        note(request, problem)
        messages = messages_of(problem, FIELDS)
        if not messages:
            members["summary"] = {"title": problem.title, "detail": problem.detail}
        members["messages"] = messages
        status, headers = problem.status, dict(problem.headers)
    if is_fragment(request):
        return templates.TemplateResponse(
            request, "entry_fragment.html", {**members, "fields": FIELDS}, status, headers
        )
    members["response"] = await service.draw_response(offer.machine, phase=True)
    whole = await context(request, **members, title=f"{offer.description.name}: jointplay")
    return templates.TemplateResponse(request, "catalogue.html", whole, status, headers)


def usual(offer: Offer) -> str:
    """Return the hypothesis to begin with: the first worn joint."""
    names = offer.description.hypotheses
    return next((name for name in names if name in offer.machine.wearing_joints), names[0] if names else "")


async def show_nearest(service: Service, offer: Offer, chosen: dict[str, str]) -> dict[str, Any]:
    """Return what the page shows of the nearest entry.

    Raises
    ------
    BadFieldError
        For a hypothesis, quantity or scaling that is not there, or a clearance that is none.
    """
    hypothesis = chosen["hypothesis"]
    if hypothesis not in offer.description.hypotheses:
        raise BadFieldError(f"hypothesis: {hypothesis[:80]}: this catalogue has none of this name", field="hypothesis")
    clearance = clearance_of(chosen["clearance"])
    asked = tuple(chosen[field] for field in CHOICES)
    for (field, known), value in zip(CHOICES.items(), asked, strict=True):
        if value not in known:
            raise BadFieldError(f"{field}: {value[:80]}: must be one of {', '.join(known)}", field=field)
    quantity, scaling = cast(tuple[Quantity, Scaling], asked)
    place = str(offer.path), offer.stamp
    found = await service.pool.run(browsing.nearest, *place, hypothesis, clearance, quantity, scaling)
    sizes = found["clearances_um"]
    what = ", ".join(f"{joint} at {micrometres(size)} µm" for joint, size in sizes.items()) or hypothesis
    return {
        "title": f"{what}, against healthy",
        "name": what,
        "key": found["key"],
        "speed": f"{found['speed_rpm']:.5g} rpm",
        "healthy_entries": found["healthy_entries"],
        "drawing": machine_picture(offer.machine, dict.fromkeys(sizes, 1.0)),
        "charts": [chart(found, channel, reference(channel, quantity, scaling)) for channel in NAMES],
    }


def clearance_of(text: str) -> float:
    """Return a clearance in m; a number without a unit is in micrometres.

    Raises
    ------
    BadFieldError
        For a text that is no length greater than 0 and at most 100 mm.
    """
    try:
        value = float(to_si(f"{text} um" if plain_number(text) else text, LENGTH))
    except UnitError as error:
        raise BadFieldError(f"clearance: {text[:80]}: {error}", field="clearance") from None
    if not 0 < value <= LARGEST:
        raise BadFieldError(f"clearance: {text[:80]}: must be greater than 0 and at most 100 mm", field="clearance")
    return value


def reference(channel: str, quantity: Quantity, scaling: Scaling) -> str:
    """Return the unit that levels in dB relate to."""
    unit = value_units(frame_units([channel], quantity), scaling)[0]
    return unit.removesuffix(" rms").replace("s2", "s²").replace("^2", "²")


def chart(found: dict[str, Any], channel: str, unit: str) -> dict[str, Any]:
    """Return one chart: its data for the script and its content in words for those who do not see it."""
    levels, healthy = found["levels"][channel], found["healthy"][channel]
    differences = [level - sound for level, sound in zip(levels, healthy, strict=True)]
    strongest = max(range(len(differences)), key=lambda index: abs(differences[index]))
    return {
        "title": NAMES[channel],
        "summary": (
            f"Level by order of {NAMES[channel]}, of this entry and of the healthy machine; they differ most at order"
            f" {order(found['orders'][strongest])}, by {differences[strongest]:+.1f} dB."
        ),
        "most": f"{differences[strongest]:+.1f} dB at order {order(found['orders'][strongest])}",
        "data": {
            "label": f"dB re 1 {unit}",
            "orders": found["orders"],
            "upper": found["high"][channel],
            "lower": found["low"][channel],
            "lines": [
                {"name": "healthy", "look": "matched", "levels": healthy},
                {"name": "this entry", "look": "measured", "levels": levels},
            ],
        },
    }
