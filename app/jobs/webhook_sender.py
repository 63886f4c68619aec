"""Sending what webhooks are told: to public addresses only, without redirects, with little time and patience.

The address that was judged is the one that is connected to: a name that leads elsewhere a moment later changes nothing.
"""

from __future__ import annotations

import contextlib
import http.client
import ipaddress
import logging
import socket
import ssl
import threading
import time
from collections.abc import Callable
from urllib.parse import SplitResult, urlsplit

from sqlalchemy.exc import SQLAlchemyError

from jointplay.app.errors import BadFieldError
from jointplay.app.storage.rows import now
from jointplay.app.storage.webhooks import (
    GIVEN_UP_AFTER,
    SIGNATURE,
    Taken,
    Webhooks,
    signature,
    standard_signature,
)

log = logging.getLogger(__name__)

TIMEOUT_S = 10.0
DEADLINE_S = 30.0
PAUSE_S = 1.0
LANES = 8
"""Deliveries that are made beside each other, each for another webhook."""
LONGEST_URL = 2000


class NotDeliveredError(Exception):
    """An attempt that did not succeed; ``str()`` says why in one line."""


class GuardedConnection(http.client.HTTPConnection):
    """A connection to an address that was judged before; TLS is checked against the name.

    Parameters
    ----------
    host : str
        The name, for the Host header and the certificate.
    port : int
    address : str
        Where to connect.
    secure : bool
        Whether to speak TLS.
    """

    def __init__(self, host: str, port: int, address: str, secure: bool) -> None:
        super().__init__(host, port, timeout=TIMEOUT_S)
        self.default_port = 443 if secure else 80
        self._address = address
        self._secure = secure
        self.raw: socket.socket | None = None
        self.expired = False

    def connect(self) -> None:
        """Connect to the judged address, whatever the name leads to by now."""
        self.raw = self.sock = socket.create_connection((self._address, self.port), TIMEOUT_S)
        if self._secure:
            context = ssl.create_default_context()
            secured = context.wrap_socket(self.sock, server_hostname=self.host, do_handshake_on_connect=False)
            self.raw = self.sock = secured
            secured.do_handshake()

    def cut(self) -> None:
        """End it from another thread, whatever it is doing; the library lets go of `sock` while it still reads."""
        self.expired = True
        if self.raw is not None:
            with contextlib.suppress(OSError):
                self.raw.shutdown(socket.SHUT_RDWR)


def check_url(url: str, private: bool = True) -> SplitResult:
    """Return the parts of a webhook's URL.

    Parameters
    ----------
    url : str
    private : bool
        Whether an address that is not public will do; a name is not looked up here, but when it is sent to.

    Raises
    ------
    BadFieldError
        When it is not http or https, carries a user, a fragment, or signs that no URL has, or is such an address.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise refusal(url, str(error)) from None
    if not url.isascii() or not url.isprintable() or " " in url or len(url) > LONGEST_URL:
        raise refusal(url, f"must be at most {LONGEST_URL} printable ASCII characters without spaces")
    if parts.scheme not in ("http", "https"):
        raise refusal(url, "must begin with http:// or https://")
    if not parts.hostname or port == 0:
        raise refusal(url, "names no host, or port 0")
    if parts.username is not None or parts.password is not None:
        raise refusal(url, "must not carry a user or password")
    if parts.fragment:
        raise refusal(url, "must not carry a fragment")
    if not private and (
        parts.hostname == "localhost" or (is_address(parts.hostname) and not is_public(parts.hostname))
    ):
        raise refusal(url, "must lead to a public address")
    return parts


def refusal(url: str, rule: str) -> BadFieldError:
    """Return the error for a URL that breaks a rule."""
    return BadFieldError(f"url: {url[:80]}: {rule}", field="url")


def is_address(host: str) -> bool:
    """Return whether a host is an IP address, not a name."""
    try:
        ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return False
    return True


def is_public(address: str) -> bool:
    """Return whether an IP address is one that anybody could reach; addresses inside of addresses count, too."""
    found = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address):
        inner = found.ipv4_mapped or found.sixtofour or (found.teredo or (None, None))[1]
        if inner is not None and not is_public(str(inner)):
            return False
    return found.is_global and not found.is_multicast and not found.is_reserved


def address_of(host: str, port: int, private: bool) -> str:
    """Return the address of a name that may be connected to.

    Parameters
    ----------
    host : str
    port : int
    private : bool
        Whether addresses that are not public will do.

    Raises
    ------
    NotDeliveredError
        When the name has no address, or any that is not allowed: a name that mixes both is up to no good.
    """
    try:
        found = [str(info[4][0]) for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)]
    except (OSError, UnicodeError):
        raise NotDeliveredError(f"{host[:80]}: has no address") from None
    if not private and not all(map(is_public, found)):
        raise NotDeliveredError(f"{host[:80]}: leads to an address that is not public")
    return found[0]


def send(taken: Taken, private: bool) -> None:
    """Make one attempt.

    Raises
    ------
    NotDeliveredError
        When it did not succeed; any answer but 2xx is no success, a redirect neither.
    """
    parts = check_url(taken.url)
    secure = parts.scheme == "https"
    host, port = str(parts.hostname), parts.port or (443 if secure else 80)
    body = taken.body.encode()
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    moment = int(time.time())
    headers = {
        "Content-Type": "application/json",
        "User-Agent": "jointplay",
        "Connection": "close",
        "webhook-id": taken.id,
        "webhook-timestamp": str(moment),
        "webhook-signature": standard_signature(taken.secret, taken.id, moment, body),
        "Jointplay-Event": taken.event,
        "Jointplay-Delivery": taken.id,
        SIGNATURE: signature(taken.secret, moment, body),
    }
    connection = GuardedConnection(host, port, address_of(host, port, private), secure)
    # Each wait is limited by itself; somebody who sends one byte now and then is stopped by the deadline.
    deadline = threading.Timer(DEADLINE_S, connection.cut)
    deadline.daemon = True
    deadline.start()
    try:
        connection.request("POST", target, body, headers)
        answer = connection.getresponse()
        if connection.expired:
            raise TimeoutError
        if not 200 <= answer.status < 300:
            raise NotDeliveredError(f"answered {answer.status}")
    except (OSError, http.client.HTTPException, ValueError) as error:
        if connection.expired:  # whatever the end of a connection looks like to who reads from it
            raise NotDeliveredError(f"took longer than {DEADLINE_S:g} s") from None
        raise NotDeliveredError(f"{type(error).__name__}: {' '.join(str(error).split())}") from None
    finally:
        deadline.cancel()
        connection.close()


class WebhookSender:
    """Makes deliveries as they fall due: one at a time for each webhook, those of several beside each other.

    Parameters
    ----------
    webhooks : Webhooks
    private : bool
        Whether addresses that are not public may be told.
    count : callable, optional
        Called after every attempt: ``delivered``, ``failed``, or ``given_up`` after the last that failed.
    """

    def __init__(self, webhooks: Webhooks, private: bool, count: Callable[[str], None] = lambda _outcome: None) -> None:
        self._count = count
        self._webhooks = webhooks
        self._private = private
        self._stop = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)
        self._busy: dict[str, Taken] = {}

    def start(self) -> None:
        """Begin; what earlier servers left is taken up."""
        self._thread.start()

    def close(self) -> None:
        """End; attempts in progress are waited for as long as a wait of their own may take."""
        self._stop.set()
        self._wake.set()
        until = time.monotonic() + TIMEOUT_S
        if self._thread.is_alive():
            self._thread.join(TIMEOUT_S)
        while self._busy and time.monotonic() < until:
            time.sleep(0.05)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wake.clear()
            try:
                busy = self._begin()
            except SQLAlchemyError as error:
                log.warning("webhooks wait for the database: %s", type(error).__name__)
                busy = False
            except Exception:
                # Whatever it is, it must not end the thread; what was taken is due again after its lease.
                log.exception("a webhook delivery could not be begun")
                busy = False
            if not busy:
                self._wake.wait(PAUSE_S)

    def _begin(self) -> bool:
        """Begin the delivery that is due for longest and can be made beside the others; return whether there was one.

        Webhooks at which nothing succeeds have half of the lanes: what they take must not keep the others waiting.
        """
        busy = dict(self._busy)
        if len(busy) >= LANES:
            return False
        troubled = sum(each.troubled for each in busy.values())
        taken = self._webhooks.take(now(), busy.keys(), troubled=troubled < LANES // 2)
        if taken is None:
            return False
        self._busy[taken.webhook] = taken
        lane = threading.Thread(target=self._serve, args=(taken,), name=f"webhook-{taken.webhook}", daemon=True)
        try:
            lane.start()
        except RuntimeError:  # the system has no thread left
            del self._busy[taken.webhook]
            raise
        return True

    def _serve(self, taken: Taken) -> None:
        try:
            self._deliver(taken)
        except SQLAlchemyError as error:  # it is due again after its lease
            log.warning("webhook delivery %s cannot be noted: %s", taken.id, type(error).__name__)
        finally:
            del self._busy[taken.webhook]
            self._wake.set()

    def step(self) -> bool:
        """Make the delivery that is due for longest; return whether there was one."""
        taken = self._webhooks.take(now())
        if taken is None:
            return False
        self._deliver(taken)
        return True

    def _deliver(self, taken: Taken) -> None:
        try:
            send(taken, self._private)
        except (NotDeliveredError, BadFieldError) as error:
            log.warning("webhook delivery %s, attempt %d: %s", taken.id, taken.attempts, error)
            self._fail(taken, str(error))
        except Exception:
            # Whatever it is, it must not come again without end.
            log.exception("webhook delivery %s, attempt %d", taken.id, taken.attempts)
            self._fail(taken, "failed in a way that was not foreseen; the log has the details")
        else:
            self._webhooks.settle(taken, now())
            self._count("delivered")

    def _fail(self, taken: Taken, error: str) -> None:
        if self._webhooks.settle(taken, now(), error):
            days = GIVEN_UP_AFTER.days
            log.error("webhook %s is disabled: nothing succeeded there for %d days: %s", taken.webhook, days, error)
        self._count("given_up" if taken.is_last else "failed")
