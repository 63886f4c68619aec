"""What builds will take, said before they are asked for."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from jointplay.app.http.openapi import problems
from jointplay.app.routes.builds import body, read_wanted
from jointplay.app.routes.diagnoses import JSON_TYPE
from jointplay.app.schemas.builds import ForecastOut
from jointplay.app.service import of_request

router = APIRouter(prefix="/forecasts", tags=["builds"])


@router.post(
    "",
    response_model=ForecastOut,
    responses=problems(400, 409, 413, 415, 422, 500, 503, 504),
    openapi_extra={"requestBody": body()},
)
async def forecast(request: Request) -> Response:
    """Say what a build would take, in time and space; some of its cases are tried, which takes up to half a minute."""
    found = await of_request(request).forecast(await read_wanted(request))
    return Response(ForecastOut(**found).model_dump_json(), media_type=JSON_TYPE)
