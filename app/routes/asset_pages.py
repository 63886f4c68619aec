"""The pages of assets: machines that stand somewhere, and the past of each."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from sqlalchemy import select
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import BadFieldError
from jointplay.app.figures.pictures import machine_picture
from jointplay.app.http import paging
from jointplay.app.http.gate import name_of
from jointplay.app.http.handlers import note, problem_from, templates
from jointplay.app.http.validation import validate
from jointplay.app.pages.history import history, measured
from jointplay.app.pages.page_forms import messages_of, number_of, plain_form
from jointplay.app.pages.standing import STATES, show_standing
from jointplay.app.pages.wear_state import show_state
from jointplay.app.problems import Problem
from jointplay.app.routes.assets import check_baseline, check_limits, list_assets
from jointplay.app.routes.pages import REFUSALS, context
from jointplay.app.rows import joint_colours
from jointplay.app.schemas.assets import Acknowledgement, AssetIn, AssetName, Looking
from jointplay.app.schemas.resources import DiagnosisRequest
from jointplay.app.scopes import Scope
from jointplay.app.service import Service, of_request
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.assets import Assets, asked, diagnoses_of, measurements_of
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.repairs import is_between, repairs_of
from jointplay.app.storage.rows import Damaged, DiagnosisRow, MeasurementRow, now
from jointplay.app.storage.standings import Standings, moments_of, turn_of
from jointplay.app.words import colour_sentence, spell_moment

router = APIRouter(prefix="/assets")

LIMIT, BASELINE, WITH = "limit-", "baseline-", "with-"
DAYS = ("silent_after_days", "warn_within_days")
TOGETHER = ("measurements", "catalogue", "effort")
LISTED = ("external_id", "machine", "notes")
FIELDS = ("notes", "baselines", "measurements", "catalogue", "limits_um", *DAYS)
"""What has a place for messages on the page with the list, and on that of an asset."""
SHOWN = 200


@router.get("")
async def assets(request: Request) -> Response:
    """Show the assets, those first that need somebody, and the form that notes a new one."""
    try:
        return await show_list(request, request.query_params.get("cursor"), {}, looking=looked_for(request))
    except REFUSALS as error:
        return await show_list(request, None, {}, problem_from(error))


@router.post("")
async def add(request: Request) -> Response:
    """Note a new asset, and go to its page."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        for name, rule in (("external_id", "give it a name"), ("machine", "choose a machine")):
            if name not in given:
                raise BadFieldError(rule, field=name)
        name, wanted = check_form(given)
        await run_in_threadpool(Assets(service.store.database).put, name, wanted, only_new=True)
    except REFUSALS as error:
        return await show_list(request, None, given, problem_from(error))
    return RedirectResponse(f"/assets/{name}", status_code=303)


@router.get("/{external_id}")
async def asset(request: Request, external_id: str) -> Response:
    """Show an asset and its past."""
    try:
        return await show_asset(request, external_id, request.query_params.get("cursor"))
    except REFUSALS as error:
        return await show_list(request, None, {}, problem_from(error))


@router.get("/{external_id}/state")
async def state(request: Request, external_id: str) -> Response:
    """Show the state of wear of an asset; its page asks for it when it is there."""
    service = of_request(request)
    try:
        row = await run_in_threadpool(Assets(service.store.database).asset, external_id)
        found = await run_in_threadpool(Findings(service.store.database).of_asset, row, SHOWN)
        shown = show_state(await service.follow(external_id), found)
        members = {"asset": asset_item(row), "state": shown}
    except REFUSALS as error:
        return await show_list(request, None, {}, problem_from(error))
    return await answer_page(request, "state.html", members | {"title": f"{external_id}: jointplay"}, None)


@router.post("/{external_id}")
async def change(request: Request, external_id: str) -> Response:
    """Change the notes and the baseline of an asset; its machine stays."""
    service = of_request(request)
    found = Assets(service.store.database)
    given: dict[str, str] = {}
    try:
        row = await run_in_threadpool(found.asset, external_id)
        given.update(await plain_form(request))
        _, wanted = check_form({**given, "external_id": external_id, "machine": row.machine})
        await run_in_threadpool(check_limits, service, external_id, wanted)
        await run_in_threadpool(check_baseline, service, wanted)
        await run_in_threadpool(found.put, external_id, wanted)
    except REFUSALS as error:
        return await show_refusal(request, external_id, given, problem_from(error))
    return RedirectResponse(f"/assets/{external_id}", status_code=303)


async def show_refusal(request: Request, external_id: str, given: dict[str, str] | None, problem: Problem) -> Response:
    """Show why something is refused on the page of the asset, or on the list where there is none of this id."""
    try:
        return await show_asset(request, external_id, None, given, problem)
    except REFUSALS:
        return await show_list(request, None, {}, problem)


@router.post("/{external_id}/acknowledgement")
async def acknowledge(request: Request, external_id: str) -> Response:
    """Note that somebody has seen how an asset stands, or let it need somebody again."""
    standings = Standings(of_request(request).store.database)
    try:
        await run_in_threadpool(Assets(of_request(request).store.database).asset, external_id)
        given = await plain_form(request)
        if given.pop("again", ""):
            await run_in_threadpool(standings.forget_acknowledgement, external_id)
        else:
            seen = validate(Acknowledgement, given)
            by = name_of(request)
            await run_in_threadpool(standings.acknowledge, external_id, seen.state, by, seen.note)
    except REFUSALS as error:
        return await show_refusal(request, external_id, None, problem_from(error))
    return RedirectResponse(f"/assets/{external_id}", status_code=303)


@router.post("/{external_id}/together")
async def together(request: Request, external_id: str) -> Response:
    """Diagnose some recordings of an asset together, and go to the answer."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        keys = [name.removeprefix(WITH) for name in given if name.startswith(WITH)]
        if not keys:
            raise BadFieldError("choose recordings", field="measurements")
        said = {name: given[name] for name in TOGETHER[1:] if name in given}
        asked: dict[str, Any] = {"asset": external_id, "measurements": keys[::-1], **said}  # the first first
        row = await service.diagnose(validate(DiagnosisRequest, asked))
    except REFUSALS as error:
        return await show_refusal(request, external_id, given, problem_from(error))
    return RedirectResponse(f"/diagnoses/{row.id}", status_code=303)


def check_form(given: dict[str, str]) -> tuple[str, AssetIn]:
    """Return the name of an asset and what a form says of it, by the rules of the HTTP interface."""
    name = validate(AssetName, {"external_id": given["external_id"]}).external_id
    said: dict[str, Any] = {}
    limits: dict[str, float] = {}
    baselines: list[str] = []
    for field, value in given.items():
        if field.startswith(LIMIT):
            limits[field.removeprefix(LIMIT)] = number_of(value, "limits_um", f"limit of {field.removeprefix(LIMIT)}")
        elif field.startswith(BASELINE):
            baselines.append(field.removeprefix(BASELINE))
        elif field in DAYS:
            said[field] = number_of(value, field)
        elif field != "external_id":
            said[field] = value
    return name, validate(AssetIn, said | {"limits_um": limits, "baselines": baselines})


def looked_for(request: Request) -> dict[str, str]:
    """Return what a list is asked to show alone."""
    given = {name: request.query_params.get(name, "") for name in ("state", "search")}
    return validate(Looking, {name: value for name, value in given.items() if value}).model_dump(exclude_defaults=True)


async def show_list(
    request: Request,
    cursor: str | None,
    given: dict[str, str],
    problem: Problem | None = None,
    looking: dict[str, str] | None = None,
) -> Response:
    """Return the page with the list and the form, and with what was wrong."""
    service = of_request(request)
    size = service.settings.page_size
    wanted = looking or {}
    only = (wanted.get("state"), wanted.get("search"))
    rows, damaged, following = await run_in_threadpool(list_assets, service, "urgent", cursor, size, *only)
    counts = await run_in_threadpool(Assets(service.store.database).counts)
    moment = now()
    members: dict[str, Any] = {
        "assets": [asset_item(row) | {"standing": show_standing(row, moment)} for row in rows],
        "states": [(state, said, counts.get(state, 0)) for state, said in STATES.items()],
        "looking": wanted,
        "same": urlencode(wanted),
        "damaged": damaged,
        "following": following,
        "first": cursor is None,
        "machines": await run_in_threadpool(machine_names, service),
        "chosen": given,
        "may_match": may_match(request),
        "title": "Assets: jointplay",
    }
    return await answer_page(request, "assets.html", members, problem, LISTED)


async def show_asset(
    request: Request,
    external_id: str,
    cursor: str | None,
    given: dict[str, str] | None = None,
    problem: Problem | None = None,
) -> Response:
    """Return the page of an asset, and what was wrong with a change of it."""
    service = of_request(request)
    members = await run_in_threadpool(past, service, external_id, cursor)
    stored = members["stored"]
    if given and "catalogue" not in given:  # of the form that changes it: a box that was left empty says nothing
        stored = {name: value for name, value in stored.items() if not name.startswith(BASELINE)}
    members["chosen"] = stored | (given or {})
    members |= {"may_match": may_match(request), "title": f"{external_id}: jointplay"}
    together = members["catalogues"] and len(members["several"]) > 1 and members["may_match"]
    hidden = {*(() if together else TOGETHER), *(() if members["limits"] else ("limits_um",))}
    return await answer_page(request, "asset.html", members, problem, [each for each in FIELDS if each not in hidden])


async def answer_page(
    request: Request, page: str, members: dict[str, Any], problem: Problem | None, fields: Sequence[str] = FIELDS
) -> Response:
    """Return a page, with a problem beside the field that it is about, or above all."""
    if problem is None:
        return templates.TemplateResponse(request, page, await context(request, **members))
    note(request, problem)
    messages = messages_of(problem, fields)
    members |= {"messages": messages}
    members["summary"] = None if messages else {"title": problem.title, "detail": problem.detail}
    whole = await context(request, **members)
    return templates.TemplateResponse(request, page, whole, problem.status, dict(problem.headers))


def past(service: Service, external_id: str, cursor: str | None) -> dict[str, Any]:
    """Return what the page of an asset shows.

    Raises
    ------
    UnknownAssetError
        When there is none of this id.
    BadCursorError
        For a cursor that is none.
    """
    store = service.store
    found = Assets(store.database)
    row = found.asset(external_id)
    damaged: list[Damaged] = []
    beyond: list[Damaged] = []
    rows = store.diagnoses(paging.decode_number(cursor), SHOWN + 1, None, diagnoses_of(external_id), beyond)
    diagnoses, damaged[:], following = paging.cut_around(rows, beyond, SHOWN)
    used = {key for each in diagnoses for key in each.measurements}
    among = select(MeasurementRow.id).where(MeasurementRow.id.in_(used))
    measurements = {each.id: each for each in store.measurements(None, len(used), among, damaged, gone=True)}
    own = store.measurements(None, SHOWN, measurements_of(external_id), damaged)
    with store.database.reading() as session:
        made, turns = moments_of(session, external_id, used), asked(session, external_id)
    diagnoses = [each for each in diagnoses if measurements.keys() & made.keys() >= set(each.measurements)]
    diagnoses.sort(key=lambda each: turns[each.id], reverse=True)
    own.sort(key=lambda each: (each.measured_at, each.number), reverse=True)
    recordings = [each for each in own if each.summary.get("kind") != "spectrum"]  # which is no baseline
    baselines = [store.measurement(key) for key in row.in_order]
    recordings += [each for each in baselines if each.id not in {one.id for one in recordings}]
    findings = Findings(store.database).of_asset(row, SHOWN + 1, damaged)
    colours, drawn = dict[str, float](), ""
    if diagnoses and cursor is None:
        mended = repairs_of(findings)

        def turn(each: DiagnosisRow) -> tuple[bool, datetime, int]:
            moments = [made[key] for key in each.measurements]
            counts = -turn_of(len(moments), each.result["verdict"])
            return not is_between(mended, moments), max(moments), counts

        last = max(diagnoses, key=turn)  # of alike ones the first, which was asked last
        since = [each.joints for each in findings if each.at > measured(last, made)]
        repaired = {name for joints in since for name, told in joints.items() if told.get("repaired")}
        colours = {name: share for name, share in joint_colours(last.answer).items() if name not in repaired}
        drawn = colour_sentence(last.answer) + (f" Repaired since: {', '.join(sorted(repaired))}." if repaired else "")
    offered = [each.description.name for each in service.shelf.offers() if each.machine.name == row.machine]
    compared = [each.answer.catalogue for each in diagnoses]  # the last first: what comes next is compared so
    machine = service.machine_of(row.machine, external_id)
    wearing = () if machine is None else machine.wearing_joints
    limits = [(name, f"{1e6 * machine.joints[name].worn_out_from:.4g}") for name in wearing] if machine else []
    drawing = ""
    if machine is not None:  # an answer of another catalogue may name a joint that its file does not have
        drawing = machine_picture(machine, {name: share for name, share in colours.items() if name in machine.joints})
    return {
        "asset": asset_item(row),
        "standing": show_standing(row, now()),
        "limits": limits,
        "drawing": drawing,
        "drawn": drawn,
        "stored": {
            "notes": row.notes,
            **{f"{BASELINE}{key}": "yes" for key in row.in_order},
            **{name: getattr(row, name) for name in DAYS},
            **{f"{LIMIT}{name}": f"{limit:g}" for name, limit in row.limits_um.items()},
        },
        "baseline": ", ".join(each.name for each in baselines),
        "recordings": [(each.id, spell(each)) for each in recordings],
        "several": [(each.id, spell(each)) for each in own if each.id not in row.in_order],
        "history": history(diagnoses, measurements, made, findings[:SHOWN]),
        "more_findings": len(findings) > SHOWN,
        "catalogues": offered,
        "catalogue": next((name for name in (*compared, *offered) if name in offered), None),
        "damaged": {each.problem: each for each in damaged}.values(),
        "following": following,
        "first": cursor is None,
    }


def spell(row: MeasurementRow) -> str:
    """Return what a recording is called in a list of an asset's."""
    return f"{row.name}, {spell_moment(row.measured_at)} UTC"


def asset_item(row: AssetRow) -> dict[str, Any]:
    """Return what the pages say of an asset."""
    return {
        "id": row.external_id,
        "machine": row.machine,
        "notes": row.notes,
        "baseline": row.baseline or "",
        "created": spell_moment(row.created_at),
    }


def machine_names(service: Service) -> list[str]:
    """Return the names of the machines that an asset can be one of: those of the service, and those of catalogues."""
    known = {service.machines.find(name).name for name in service.machines.names()}
    return sorted(known | {offer.machine.name for offer in service.shelf.offers()})


def may_match(request: Request, scope: Scope = Scope.MATCH) -> bool:
    """Return whether the session may note assets, or what another scope allows; without keys everybody may."""
    scopes = getattr(request.state, "scopes", None)
    return scopes is None or scope in scopes
