"""A line to PostgreSQL that can be cut, or paused."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import databases
from sqlalchemy.engine import make_url


class Line:
    """A line to a server that can be cut and mended, paused and resumed; its port stays the same."""

    def __init__(self, host: str, port: int) -> None:
        self._target = (host, port)
        self._flows = threading.Event()
        self._flows.set()
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._listener = self._listen(0)
        self.port: int = self._listener.getsockname()[1]

    def _listen(self, port: int) -> socket.socket:
        listener = socket.create_server(("127.0.0.1", port))
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()
        return listener

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                client = listener.accept()[0]
                self._flows.wait()
                pair = (client, socket.create_connection(self._target))
                self._pairs.append(pair)
                threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def _carry(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError, ValueError), one, other:
            while True:
                for source in select.select([one, other], [], [])[0]:
                    self._flows.wait()
                    content = source.recv(65536)
                    if not content:
                        return
                    (other if source is one else one).sendall(content)

    def cut(self) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for pair in self._pairs:
            for end in pair:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
        self._pairs.clear()

    def pause(self) -> None:
        """Let nothing through, in either direction: connections stay, as with a server that is stopped."""
        self._flows.clear()

    def resume(self) -> None:
        self._flows.set()

    def mend(self) -> None:
        self._listener = self._listen(self.port)


@contextmanager
def remote(tmp_path: Path) -> Iterator[tuple[Line, str]]:
    with databases.database("postgresql", tmp_path) as url:
        target = make_url(url)
        line = Line(target.host or "127.0.0.1", target.port or 5432)
        shown = target.set(host="127.0.0.1", port=line.port).render_as_string(hide_password=False)
        try:
            yield line, shown
        finally:
            line.resume()
            line.cut()
