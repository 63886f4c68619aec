"""What a request needs to be allowed: one rule for every address, those included that are added later."""

from __future__ import annotations

from enum import StrEnum

READING = frozenset({"GET", "HEAD", "OPTIONS"})
API = "/api/v1"
#: Addresses that say nothing of anybody's machines: whether the process lives, the form to sign in, scripts and styles.
OPEN = ("/healthz", "/readyz", "/sign-in", "/sign-out", "/openapi.json")
OPEN_FOLDER = "/static/"
ADMINISTERED = ("/webhooks", "/keys", "/audit")
RETENTION = "/retention"
#: What is taken back by DELETE, and can be said again: everything else that is deleted is gone.
TAKEN_BACK = "/acknowledgement"
BUILDING = ("/forecasts", "/builds", "/machines")


class Scope(StrEnum):
    """What a key may be used for; no scope holds another."""

    READ = "read"
    MATCH = "match"
    BUILD = "build"
    ADMIN = "admin"


def scope_of(method: str, path: str) -> Scope | None:
    """Return the scope that a request needs; ``None`` where none is needed.

    An address that is not known needs `read` to look and `match` to change: what is forgotten here is closed, not open.

    Parameters
    ----------
    method : str
        HTTP method, in capitals.
    path : str
        Path of the request, or the template of a route.
    """
    if path in OPEN or path.startswith(OPEN_FOLDER):
        return None
    place = path.removeprefix(API)
    if under(place, ADMINISTERED):
        return Scope.ADMIN
    if method in READING:
        return Scope.READ
    if place.endswith(RETENTION) or (method == "DELETE" and not place.endswith(TAKEN_BACK)):
        return Scope.ADMIN
    return Scope.BUILD if under(place, BUILDING) else Scope.MATCH


def under(place: str, folders: tuple[str, ...]) -> bool:
    """Return whether a path is one of some folders or lies below one."""
    return any(place == folder or place.startswith(f"{folder}/") for folder in folders)
