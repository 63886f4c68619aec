"""The catalogue browser: what does a worn joint look like against a machine in order?"""

from __future__ import annotations

from typing import Any, cast, get_args
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.errors import BadFieldError
from jointplay.app.figures.pictures import machine_picture
from jointplay.app.http.handlers import is_fragment, note, problem_from, templates
from jointplay.app.jobs.quality_cards import joint_cells, quality_line
from jointplay.app.jobs.tasks import BaselineFile
from jointplay.app.pages import browsing
from jointplay.app.pages.page_forms import messages_of, quantity_of
from jointplay.app.routes.pages import KNOWN_ASSETS, REFUSALS, context
from jointplay.app.routes.try_pages import WEAR
from jointplay.app.rows import NAMES, length, micrometres, order
from jointplay.app.service import Service, of_request
from jointplay.app.shelves.catalogues import Offer
from jointplay.app.storage.assets import Assets
from jointplay.solver.machines.drawing import machine_svg
from jointplay.solver.machines.units import LENGTH
from jointplay.solver.spectra.spectrum import Quantity, Scaling, frame_units, value_units

router = APIRouter(prefix="/catalogues")

FIELDS = ("hypothesis", "clearance", "quantity", "scaling", "asset")
USUAL = {"clearance": "200", "quantity": "acceleration", "scaling": "rms", "asset": ""}
LARGEST = 0.1
CHOICES = {"quantity": get_args(Quantity), "scaling": get_args(Scaling)}


@router.get("")
async def catalogues(request: Request) -> Response:
    """List the catalogues."""
    service = of_request(request)
    drawn = await run_in_threadpool(drawings, service)
    damaged = await run_in_threadpool(service.shelf.damages)
    members = await context(request, title="Catalogues: jointplay", drawings=drawn, damaged=damaged)
    return templates.TemplateResponse(request, "catalogues.html", members)


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
    chosen = {**USUAL, "hypothesis": usual(offer), **{field: said for field, said in given.items() if said}}
    members = {"catalogue": offer.description, "chosen": chosen, "entry": None, "summary": None, "choices": CHOICES}
    members["baselines"] = await run_in_threadpool(with_baseline, service, offer)
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
    card = offer.description.quality
    members["quality"] = [
        {"summary": quality_line(part).replace("m/s2", "m/s²"), "joints": joint_cells(part)} for part in card.noises
    ] if card else []  # fmt: skip
    members["response"] = await service.draw_response(offer.machine, phase=True)
    whole = await context(request, **members, title=f"{offer.description.name}: jointplay")
    return templates.TemplateResponse(request, "catalogue.html", whole, status, headers)


def drawings(service: Service) -> dict[str, str]:
    """Return the drawings of machines by catalogue; each machine once, because names within a drawing are its own."""
    offers = {offer.machine.content_key: offer for offer in reversed(service.shelf.offers())}
    return {offer.description.name: machine_svg(offer.machine) for offer in offers.values()}


def usual(offer: Offer) -> str:
    """Return the hypothesis to begin with: the first worn joint."""
    names = offer.description.hypotheses
    return next((name for name in names if name in offer.machine.wearing_joints), names[0] if names else "")


def with_baseline(service: Service, offer: Offer) -> list[str]:
    """Return the assets that are a catalogue's machine and have a recording of it in order."""
    assets = Assets(service.store.database).page(None, KNOWN_ASSETS, damaged=[])
    return [each.external_id for each in assets if each.machine == offer.machine.name and each.in_order]


def baseline_of(service: Service, offer: Offer, asset: str) -> BaselineFile | None:
    """Return the recording of an asset in order; None for no asset.

    Raises
    ------
    BadFieldError, UnknownAssetError
        For an asset that is none, another machine, or has no baseline.
    """
    row = service.questions.asset_of(asset or None, offer.machine.name)
    if row is None:
        return None
    found = service.questions.baselines_of(row, None)
    if not found:
        raise BadFieldError(f"asset: {asset[:80]}: has no baseline", field="asset")
    return service.questions.files_of(row.external_id, found[:1])[0]


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
    baseline = await run_in_threadpool(baseline_of, service, offer, chosen["asset"])
    found = await service.pool.run(browsing.nearest, *place, hypothesis, clearance, quantity, scaling, baseline)
    sizes = found["clearances_um"]
    what = ", ".join(f"{joint} at {micrometres(size)} µm" for joint, size in sizes.items()) or hypothesis
    return {
        "title": f"{what}, against a machine in order",
        "name": what,
        "key": found["key"],
        "speed": f"{found['speed_rpm']:.5g} rpm",
        "again": urlencode(
            {"catalogue": offer.description.name, "speed": f"{found['speed_rpm']:.5g}"}
            | {f"{WEAR}{joint}": f"{size:.4g}" for joint, size in sizes.items()}
        ),
        "healthy_entries": found["healthy_entries"],
        "family": [length(each["clearance_um"]) for each in found["family"]],
        "baseline": chosen["asset"] if found["baseline"] else "",
        "refused": found["refused"],
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
    value = quantity_of(text, "clearance", "clearance", LENGTH, "um")
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
    # What one machine in order has as well is no sign of wear: a difference counts from the nine of ten on.
    outside = [
        max(level - high, 0.0) + min(level - low, 0.0)
        for level, low, high in zip(levels, found["low"][channel], found["high"][channel], strict=True)
    ]
    strongest = max(range(len(outside)), key=lambda index: abs(outside[index]))
    far = f"{outside[strongest]:+.1f} dB".replace("-", "−")
    at = f"order {order(found['orders'][strongest])}"
    baseline = found["baseline"].get(channel)
    members = found["family"]
    return {
        "title": NAMES[channel],
        "summary": (
            f"Level by order of {NAMES[channel]}, of this entry and of machines in order; it is farthest from nine of"
            f" ten of them at {at}, by {far}."
        ),
        "most": f"{far} at {at}" if outside[strongest] else "as nine of ten of them",
        "data": {
            "label": f"dB re 1 {unit}",
            "orders": found["orders"],
            "upper": found["high"][channel],
            "lower": found["low"][channel],
            "lines": [
                {"name": "in order", "look": "matched", "levels": healthy},
                *(
                    {
                        "name": length(each["clearance_um"]),
                        "look": "rival",
                        "share": index / max(len(members) - 1, 1),
                        "levels": each["levels"][channel],
                    }
                    for index, each in enumerate(members)
                ),
                {"name": "this entry", "look": "measured", "levels": levels},
                *([{"name": "baseline", "look": "joint-2", "levels": baseline}] if baseline else []),
            ],
        },
    }
