"""What trusted proxies say of a request: from where and how it came, and who signed in there.

From anywhere else these headers are what a client has made up, and are not looked at.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from jointplay.app import scopes
from jointplay.app.errors import UnauthorizedError
from jointplay.app.settings import networks

PERSON, GROUPS = "X-Forwarded-User", "X-Forwarded-Groups"
LONGEST_NAME = 128


class Proxies:
    """Middleware that believes ``X-Forwarded-For`` and ``-Proto`` of trusted proxies, and notes whether it was one.

    Parameters
    ----------
    app : ASGIApp
        The application behind.
    trusted : sequence of str
        Addresses and networks of proxies.
    """

    def __init__(self, app: ASGIApp, trusted: Sequence[str]) -> None:
        self._networks = networks(trusted)
        self._app = app
        # The last address in the header that is not a proxy's: what stands before it, the client may have sent.
        self._believing = cast(ASGIApp, ProxyHeadersMiddleware(self._pass, list(trusted)))  # type: ignore[arg-type]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with the client's address and the scheme that it came by."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        peer = scope.get("client")
        found = None if peer is None else parsed(peer[0])
        trusted = found is not None and any(found in each for each in self._networks)
        scope.setdefault("state", {}).update(peer=peer, by_proxy=trusted)
        await (self._believing if trusted else self._app)(scope, receive, send)

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        if parsed(scope["client"][0]) is None:  # a proxy that hands on what clients say
            scope["client"] = scope["state"]["peer"]
        await self._app(scope, receive, send)


def parsed(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return a host as an address; ``None`` where it is none."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


@dataclass(frozen=True)
class Person:
    """Somebody who has signed in at a proxy.

    Parameters
    ----------
    name : str
        As the proxy says.
    scopes : frozenset of Scope
        What they may do here.
    """

    name: str
    scopes: frozenset[scopes.Scope]


def person_of(request: Request, people: Mapping[str, frozenset[scopes.Scope]]) -> Person | None:
    """Return who asks, where a trusted proxy says so; ``None`` where nobody does.

    Parameters
    ----------
    request : Request
    people : mapping of str to frozenset of Scope
        What a member of a group may do, and everybody (``*``); empty where people do not sign in at a proxy.

    Raises
    ------
    UnauthorizedError
        What the proxy says cannot be a name, or is said twice: then one of both came from the client.
    """
    if not people or not request.state.by_proxy:
        return None
    names, groups = request.headers.getlist(PERSON), request.headers.getlist(GROUPS)
    for header, values in ((PERSON, names), (GROUPS, groups)):
        if len(values) > 1:
            raise UnauthorizedError(f"{header}: came twice; the proxy has to replace what clients send")
    name = names[0].strip() if names else ""
    if not name:
        return None
    # In braces stands what a proxy was to put in and did not know: Caddy leaves its placeholders as they are.
    if not name.isprintable() or len(name) > LONGEST_NAME or "{" in name:
        rule = f"must be a name of at most {LONGEST_NAME} characters that can be printed, without braces"
        raise UnauthorizedError(f"{PERSON}: {rule}")
    member = {each.strip() for each in groups[0].split(",")} if groups else set()
    granted = [people[group] for group in (scopes.EVERYBODY, *sorted(member - {scopes.EVERYBODY})) if group in people]
    return Person(name, frozenset().union(*granted))
