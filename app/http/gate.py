"""The gate before every request: the host it names, how often its client asks, its key, where a form was sent from."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING
from urllib.parse import quote, urlsplit

from cachetools import LRUCache
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import URL
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Send
from starlette.types import Scope as Connection

from jointplay.app import logs
from jointplay.app.actor import Actor, acting
from jointplay.app.errors import ForbiddenError, RateLimitedError, UnauthorizedError, WrongHostError
from jointplay.app.http.handlers import answer, is_fragment, is_page, path_of, problem_from
from jointplay.app.http.proxies import Person, person_of
from jointplay.app.scopes import READING, scope_of
from jointplay.app.scopes import Scope as KeyScope
from jointplay.app.settings import ServiceSettings

if TYPE_CHECKING:
    from jointplay.app.storage.keys import Key, Keys

COOKIE = "jointplay_session"
ANY_HOST = "*"
#: Whoever watches the process asks by address, and is told nothing but whether it lives.
PROBES = ("/healthz", "/readyz")
CLIENTS_REMEMBERED = 10_000


class TokenBuckets:
    """One bucket of tokens a client, filled evenly, emptied by requests.

    Parameters
    ----------
    rate : float
        Tokens a second.
    burst : float
        Tokens that a full bucket holds.
    clock : callable
        Gives a time [s] that never goes back.
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._burst = burst
        self._clock = clock
        # A client that was forgotten begins with a full bucket: with 10 000 others in between it has waited long.
        self._buckets: LRUCache[str, tuple[float, float]] = LRUCache(CLIENTS_REMEMBERED)

    def take(self, client: str) -> float:
        """Take a token; return 0, or when the bucket is empty the time until there is one [s]."""
        present, tokens = self._look_at(client)
        wait = 0.0 if tokens >= 1 else (1 - tokens) / self._rate
        self._buckets[client] = (tokens if wait else tokens - 1, present)
        return wait

    def wait(self, client: str) -> float:
        """Return the time until there is a token [s], which nobody takes."""
        return max(0.0, (1 - self._look_at(client)[1]) / self._rate)

    def _look_at(self, client: str) -> tuple[float, float]:
        present = self._clock()
        tokens, filled_at = self._buckets.get(client, (self._burst, present))
        return present, min(self._burst, tokens + (present - filled_at) * self._rate)

    def __len__(self) -> int:
        """Return the number of clients that are remembered."""
        return len(self._buckets)


class Gate:
    """Middleware that lets requests pass that may.

    Parameters
    ----------
    app : ASGIApp
        The application behind.
    settings : Settings
        `keys`, `hosts`, `rate_limit_per_s`, `rate_burst` are used.
    people : mapping of str to frozenset of Scope
        What people of a group may do who signed in at a proxy.
    """

    def __init__(self, app: ASGIApp, settings: ServiceSettings, people: Mapping[str, frozenset[KeyScope]]) -> None:
        self._app = app
        self._people = people
        self._hosts = settings.allowed_hosts
        self._keyed = settings.keys == "required"
        self._buckets = TokenBuckets(settings.rate_limit_per_s, settings.rate_burst)

    async def __call__(self, scope: Connection, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it here."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        refusal: Response | None = None
        try:
            await self._judge(request)
        except Exception as error:
            # Raised in a middleware, an exception would pass the application's own handlers by.
            refusal = refuse(request, error)
        if refusal is None:
            with acting(actor_of(request)):
                await self._app(scope, receive, send)
        else:
            await refusal(scope, receive, send)

    async def _judge(self, request: Request) -> None:
        """Raise what speaks against a request."""
        path, method = path_of(request.scope), request.method
        if path not in PROBES:
            self._check_host(request)
        key, person, by_cookie = None, None, False
        needed = scope_of(method, path)
        try:
            person = None if path in PROBES else person_of(request, self._people)
            request.state.person = None if person is None else person.name
            if self._keyed and needed is not None:
                key, by_cookie = await identify(request, request.app.state.keys, person)
        finally:
            # Wrong keys are counted as well, at their sender's address.
            if path not in PROBES:
                self._count(key.id if key is not None else address(request))
        request.state.key = None if key is None else key.id
        request.state.key_name = None if key is None else key.name
        request.state.signed_in = by_cookie
        request.state.scopes = held = scopes_of(key, person) if self._keyed else None
        # What the proxy knows its user by, a browser sends for every page that asks, as it does with cookies.
        by_browser = by_cookie or (person is not None and key is None)
        if method not in READING and (by_browser or key is None):
            check_origin(request, browser=by_browser)
        if held is not None and needed is not None and needed not in held:
            who = f"the key {key.id}" if key is not None else f"{request.state.person} (JOINTPLAY_PEOPLE)"
            raise ForbiddenError(f"{who} has not the scope {needed}, which {method} {path} needs", needed)

    def _check_host(self, request: Request) -> None:
        """Refuse a request that names another host: a page that points its own name here must not be answered."""
        if ANY_HOST in self._hosts:
            return
        named = request.headers.get("host", "")
        if host_name(named) not in self._hosts:
            raise WrongHostError(f"Host: {named[:80]}: is none of {', '.join(sorted(self._hosts))} (JOINTPLAY_HOSTS)")

    def _count(self, client: str) -> None:
        """Refuse a client that asks too often."""
        wait = self._buckets.take(client)
        if wait:
            raise RateLimitedError("too many requests; Retry-After says when to try again", math.ceil(wait))


async def identify(request: Request, keys: Keys, person: Person | None = None) -> tuple[Key | None, bool]:
    """Return the key of a request, and whether it came by a browser's cookie.

    A key that is sent counts before the person, the person before the cookie; a person has none.

    Raises
    ------
    UnauthorizedError
        When there is none, or one that does not hold.
    """
    token = token_of(request)
    if token is not None:
        return await run_in_threadpool(keys.find, token), False
    if person is not None:
        return None, False
    session = request.cookies.get(COOKIE)
    if session is not None:
        return await run_in_threadpool(keys.of_session, session), True
    raise UnauthorizedError("a key is needed: Authorization: Bearer KEY, or X-API-Key: KEY")


def scopes_of(key: Key | None, person: Person | None) -> frozenset[KeyScope] | None:
    """Return what may be done: by a key what it is for, without one what the person may; nothing is known of others."""
    return key.scopes if key is not None else person.scopes if person is not None else None


def name_of(request: Request) -> str:
    """Return who asks, as people call them: the person, or the name of the key; empty where neither is known."""
    return request.state.person or request.state.key_name or ""


def token_of(request: Request) -> str | None:
    """Return the key that the headers of a request carry; one in an address is never looked at."""
    kind, _, token = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer" and token.strip():
        return token.strip()
    return request.headers.get("x-api-key") or None


def check_origin(request: Request, *, browser: bool) -> None:
    """Refuse what another site's page makes a browser send.

    Parameters
    ----------
    request : Request
    browser : bool
        Whether it is surely one that asks: then it has to say where from.

    Raises
    ------
    ForbiddenError
        When it came from another site, or does not say.
    """
    site, origin = request.headers.get("sec-fetch-site"), request.headers.get("origin")
    if site is not None:
        allowed = site in ("same-origin", "none")
    elif origin is not None:
        # Scheme and host are not compared with ours: behind a proxy that speaks TLS we know neither.
        allowed = urlsplit(origin).netloc.lower() == request.headers.get("host", "").lower()
    else:
        allowed = not browser
    if not allowed:
        raise ForbiddenError("the request was sent by a page of another site (Origin, Sec-Fetch-Site)")


def refuse(request: Request, error: Exception) -> Response:
    """Return the answer to a request that may not pass; a browser without a session is shown the form to sign in."""
    if isinstance(error, UnauthorizedError) and (is_page(request) or is_visit(request)):
        place = URL("/sign-in").include_query_params(next=find_place(request))
        if is_fragment(request):
            return Response(status_code=401, headers={"HX-Redirect": str(place)})
        return RedirectResponse(str(place), status_code=303)
    return answer(request, problem_from(error))


def is_visit(request: Request) -> bool:
    """Return whether a browser goes to an address by itself, such as that of a report."""
    return request.method == "GET" and request.headers.get("sec-fetch-mode") == "navigate"


def find_place(request: Request) -> str:
    """Return where a browser goes on after it signed in: to the page it asked for, or the one that sent the form.

    What names another site, or cannot be read, becomes the first page.
    """
    if request.method == "GET":
        return own_place(quote(request.scope["path"]), request.scope["query_string"].decode("latin-1"))
    sender = request.headers.get("hx-current-url") or request.headers.get("referer", "")
    try:
        parts = urlsplit(sender)
    except ValueError:
        return "/"
    if parts.netloc.lower() != request.headers.get("host", "").lower():
        return "/"
    return own_place(parts.path, parts.query)


def own_place(path: str, query: str) -> str:
    """Return a path of this service with its query, in the form of an address."""
    if not path.startswith("/") or path.startswith("//"):
        return "/"
    return f"{path}?{query}" if query else path


def host_name(named: str) -> str:
    """Return the name in a Host header, in lower case, without its port; nothing where it holds more than that."""
    try:
        parts = urlsplit(f"//{named}")
    except ValueError:
        return ""
    return (parts.hostname or "") if parts.netloc == named and "@" not in named else ""


def actor_of(request: Request) -> Actor:
    """Return who sent a request that was let pass."""
    return Actor(
        key=request.state.key, person=request.state.person, address=address(request), request_id=logs.request_id()
    )


def address(request: Request) -> str:
    """Return the address that a request came from."""
    return request.client.host if request.client is not None else "unknown"
