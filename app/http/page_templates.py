"""The templates of the page, and the page that says why there is no other one."""

from __future__ import annotations

from pathlib import Path

from fastapi.templating import Jinja2Templates
from starlette.requests import Request
from starlette.responses import Response

from jointplay.app.problems import Problem

templates = Jinja2Templates(directory=Path(__file__).parents[1] / "templates")


def is_fragment(request: Request) -> bool:
    """Return whether a script asks, and shows the answer in a part of the page."""
    return request.headers.get("hx-request") == "true"


def is_page(request: Request) -> bool:
    """Return whether a person in front of a browser will read the answer."""
    if request.url.path.startswith("/api/"):
        return False
    return is_fragment(request) or "text/html" in request.headers.get("accept", "")


def problem_page(request: Request, problem: Problem) -> Response:
    """Return a problem as a page, or as the part of a page that a script asked for."""
    bare = problem.detail.rstrip(".") == problem.title
    detail = "Nothing is at this address." if bare and problem.status == 404 else problem.detail
    members = {"summary": {"title": problem.title, "detail": detail}, "title": f"{problem.title}: jointplay"}
    template = "_refusal.html" if is_fragment(request) else "refused.html"
    return templates.TemplateResponse(request, template, members, problem.status, dict(problem.headers))
