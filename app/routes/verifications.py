"""Verifying diagnoses: what they were made of, and whether they come out the same again."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool

from jointplay.app.http.openapi import problems
from jointplay.app.jobs.verification import Checked, Repetition, check, repeat
from jointplay.app.jobs.workers import TaskFailedError
from jointplay.app.problems import PLAIN_TYPE
from jointplay.app.schemas.custody import CatalogueThen, EvidenceOut, VerificationOut, VersionPair
from jointplay.app.service import of_request
from jointplay.app.storage.rows import DiagnosisRow

router = APIRouter(prefix="/diagnoses", tags=["diagnoses"])


@router.get("/{key}/verification", responses=problems(404, 409, 500, 503, 504))
async def verify(request: Request, key: str) -> VerificationOut:
    """Check the files that a diagnosis was made of, make the answer again, and say how it compares."""
    service = of_request(request)
    row = await run_in_threadpool(service.store.diagnosis, key)
    found = await run_in_threadpool(check, service.store, row, service.shelf.place_of)
    again = Repetition("not_repeated", said=found.said)
    if (asked := found.again) is not None:
        try:
            again = await service.answers.answer(
                repeat, asked.then, asked.recordings, question=asked.question, measurements=[key]
            )
        except TaskFailedError as error:
            if error.problem.type == PLAIN_TYPE:  # that nobody foresaw
                raise
            again = Repetition("not_repeated", said=error.problem.detail)
    return verification_out(row, found, again)


def verification_out(row: DiagnosisRow, found: Checked, again: Repetition) -> VerificationOut:
    """Return the outside shape of a verification."""
    made = row.answer.provenance
    sound = all(each.state == "sound" for each in (*found.recordings, *found.baselines))
    return VerificationOut(
        diagnosis=row.id,
        checksum=row.checksum,
        verified=sound and again.outcome in ("equal", "rounding"),
        recordings=[EvidenceOut(**asdict(each)) for each in found.recordings],
        baselines=[EvidenceOut(**asdict(each)) for each in found.baselines],
        catalogue=CatalogueThen(id=row.catalogue, name=row.answer.catalogue, state=found.catalogue),
        versions={
            "solver": VersionPair(then=made.solver_version, now=again.solver),
            "matcher": VersionPair(then=made.matcher.version, now=again.matcher),
        },
        repeated=again.outcome,
        differences=[asdict(each) for each in again.differences],
        said=again.said,
    )
