"""A server that is told by webhooks, plain or over TLS, and what a test asks of them."""

from __future__ import annotations

import queue
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from jointplay.app.storage.webhooks import WebhookRow, Webhooks, announce


@dataclass(frozen=True)
class Told:
    """A request as it came to the listener."""

    path: str
    headers: dict[str, str]
    body: bytes


class Listener(ThreadingHTTPServer):
    """A server that keeps what it is told and answers as it was set to."""

    def __init__(self, tls: ssl.SSLContext | None = None) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        if tls is not None:
            self.socket = tls.wrap_socket(self.socket, server_side=True, do_handshake_on_connect=False)
        self.told: queue.Queue[Told] = queue.Queue()
        self.status = 204
        self.url = f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A connection that is broken off is for the sender to tell."""


class Handler(BaseHTTPRequestHandler):
    server: Listener

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.told.put(Told(self.path, {name.lower(): value for name, value in self.headers.items()}, body))
        self.send_response(self.server.status)
        if 300 <= self.server.status < 400:
            self.send_header("Location", f"{self.server.url}/elsewhere")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def listening(tls: ssl.SSLContext | None = None) -> Iterator[Listener]:
    """Run a listener in a thread."""
    with Listener(tls) as found:
        thread = threading.Thread(target=found.serve_forever, daemon=True)
        thread.start()
        yield found
        found.shutdown()
        thread.join(10)


def tell(webhooks: Webhooks, event: Any = "finding.created") -> None:
    with webhooks._database.writing() as session:
        announce(session, event, {"finding": "f1"})


def state(webhooks: Webhooks, hook: WebhookRow) -> tuple[str, int, str]:
    (row,) = webhooks.deliveries(hook.id, None, 10)
    return row.state, row.attempts, row.error
