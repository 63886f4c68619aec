"""The audit log: what was done, by whom."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request

from jointplay.app.http import paging
from jointplay.app.http.openapi import problems
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.custody import AuditItem, AuditPage
from jointplay.app.service import of_request
from jointplay.app.storage.audit import AuditLog, AuditRow

router = APIRouter(prefix="/audit", tags=["audit"])

Kind = Annotated[
    str | None, Query(max_length=32, pattern=r"^[a-z]+$", examples=["asset"], description="Only what was done to such.")
]
Object = Annotated[
    str | None,
    Query(alias="object", max_length=128, pattern=r"^[ -~]+$", examples=["press-7"], description="Its id."),
]


@router.get("", responses=problems(400, 422))
def audit(
    request: Request, kind: Kind = None, key: Object = None, cursor: Cursor = None, limit: Limit = None
) -> AuditPage:
    """List what was done, the last first; to one kind of objects, or to one of them."""
    service = of_request(request)
    size = limit or service.settings.page_size
    rows = AuditLog(service.store.database).page(paging.decode_number(cursor), size + 1, kind, key)
    shown, following = paging.cut(rows, size)
    return AuditPage(items=[audit_item(row) for row in shown], next_cursor=following)


def audit_item(row: AuditRow) -> AuditItem:
    """Return the outside shape of a row."""
    return AuditItem(**row.content, hash=row.hash)
