"""`jointplay serve` as a process of its own, for what only a whole process shows: its log, its end, its children."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Condition, Thread
from typing import Any

import httpx
import psutil
from command_line import JOINTPLAY


@dataclass
class ServiceProcess:
    """A running service, and what it has written to stderr until now."""

    process: subprocess.Popen[str]
    address: str = ""
    written: list[str] = field(default_factory=list)
    heard: Condition = field(default_factory=Condition)

    def entries(self) -> list[dict[str, Any]]:
        """Lines of a log in JSON."""
        return [json.loads(line) for line in self.written]

    def listen(self) -> None:
        """Hear the process to its end."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with self.heard:
                self.written.append(line)
                self.heard.notify_all()

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Wait until a line that fits was written."""

        def found() -> re.Match[str] | None:
            return next((match for line in self.written if (match := re.search(pattern, line))), None)

        with self.heard:
            match = self.heard.wait_for(found, 300)
        assert match is not None, "".join(self.written)
        return match

    def wait_until_it_listens(self) -> None:
        """Wait for the first connection: a server says that it has started before it listens."""
        host, port = self.address.removeprefix("http://").split(":")
        for _ in range(3000):
            try:
                socket.create_connection((host, int(port))).close()
            except ConnectionRefusedError:
                time.sleep(0.1)
            else:
                return
        raise TimeoutError(f"{self.address}: started, and does not listen")

    def worker(self) -> int:
        """Process of the one worker that it has; builds are none of its."""
        (found,) = [
            child.pid
            for child in psutil.Process(self.process.pid).children()
            if "spawn_main" in " ".join(child.cmdline())
        ]
        return int(found)


@contextmanager
def service_process(folder: Path, *options: str, **environment: str) -> Iterator[ServiceProcess]:
    """Run a service over `folder`; it is ready when this gives it, and everything is heard when it is over."""
    command = [*JOINTPLAY, "serve", "--port", "0", "--workers", "1"]
    command += ["--catalogues", str(folder / "catalogues"), "--data", str(folder / "data"), *options]
    given = {f"JOINTPLAY_{name.upper()}": value for name, value in environment.items()}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, **given}) as process:
        running = ServiceProcess(process)
        listener = Thread(target=running.listen)
        listener.start()
        try:
            running.address = running.wait_for(r"serving (http://127\.0\.0\.1:\d+)")[1]
            running.wait_for("startup complete")
            running.wait_until_it_listens()
            yield running
        finally:
            process.kill()  # what has ended by itself is not concerned
            listener.join()


def client_of(running: ServiceProcess) -> httpx.Client:
    """A client of a service."""
    return httpx.Client(base_url=running.address, timeout=300)
