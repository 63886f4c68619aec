"""What a request needs to be allowed: one rule for every address, those included that are added later."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import StrEnum

from jointplay.app.errors import BadFieldError

READING = frozenset({"GET", "HEAD", "OPTIONS"})
API = "/api/v1"
#: Addresses that say nothing of anybody's machines: whether the process lives, the form to sign in, scripts and styles.
OPEN = ("/healthz", "/readyz", "/sign-in", "/sign-out", "/openapi.json")
OPEN_FOLDER = "/static/"
ADMINISTERED = ("/webhooks", "/keys", "/audit")
#: How long a recording is kept, and forms of pages, which know no DELETE.
ADMINISTERED_OF_EACH = tuple(
    map(re.compile, (r"/measurements/[^/]+/retention", r"/(assets|measurements|diagnoses|findings)/[^/]+/delete"))
)
#: What is taken back by DELETE, and can be said again: everything else that is deleted is gone.
TAKEN_BACK = re.compile(r"/assets/[^/]+/acknowledgement")
BUILDING = ("/forecasts", "/builds", "/machines")


#: A key holds for so long, and the secret before its newest for so much longer, unless somebody says otherwise.
LIFETIME_DAYS, GRACE_HOURS = 365, 24
LONGEST_DAYS, LONGEST_GRACE_HOURS = 3650, 720
#: In place of a group: whoever has signed in at the proxy.
EVERYBODY = "*"


class Scope(StrEnum):
    """What a key or a person may do; no scope holds another."""

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
    if any(each.fullmatch(place) for each in ADMINISTERED_OF_EACH):
        return Scope.ADMIN
    if method == "DELETE" and not TAKEN_BACK.fullmatch(place):
        return Scope.ADMIN
    return Scope.BUILD if under(place, BUILDING) else Scope.MATCH


def under(place: str, folders: tuple[str, ...]) -> bool:
    """Return whether a path is one of some folders or lies below one."""
    return any(place == folder or place.startswith(f"{folder}/") for folder in folders)


def parse_people(given: str) -> Mapping[str, frozenset[Scope]]:
    """Return what members of groups may do, by group.

    Parameters
    ----------
    given : str
        Such as ``*=read; fitters=read match``.

    Raises
    ------
    BadFieldError
        When it is not of this form, names a group twice, or a scope that there is not.
    """
    found: dict[str, frozenset[Scope]] = {}
    known = frozenset(scope.value for scope in Scope)
    for entry in filter(None, map(str.strip, given.split(";"))):
        group, _, said = entry.rpartition("=")
        wanted = frozenset(said.split())
        if not group.strip() or not wanted or not wanted <= known or group.strip() in found:
            rule = f"must be a group, named once, = and scopes of {', '.join(Scope)}, as in *=read; fitters=read match"
            raise BadFieldError(f"JOINTPLAY_PEOPLE: {entry[:80]}: {rule}", field="people")
        found[group.strip()] = frozenset(map(Scope, wanted))
    return found
