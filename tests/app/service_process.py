"""`jointplay serve` as a process of its own, for what only a whole process shows: its log, its end, its children."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any

import httpx
from command_line import JOINTPLAY


@dataclass
class ServiceProcess:
    """A running service, and what it has written to stderr until now."""

    process: subprocess.Popen[str]
    address: str = ""
    written: list[str] = field(default_factory=list)

    def entries(self) -> list[dict[str, Any]]:
        """Lines of a log in JSON."""
        return [json.loads(line) for line in self.written]


@contextmanager
def service_process(folder: Path, *options: str, **environment: str) -> Iterator[ServiceProcess]:
    """Run a service over `folder`; it is ready when this gives it, and everything is heard when it is over."""
    command = [*JOINTPLAY, "serve", "--port", "0", "--workers", "1"]
    command += ["--catalogues", str(folder / "catalogues"), "--data", str(folder / "data"), *options]
    given = {f"JOINTPLAY_{name.upper()}": value for name, value in environment.items()}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, **given}) as process:
        assert process.stderr is not None
        running = ServiceProcess(process)
        try:
            for line in iter(process.stderr.readline, ""):
                running.written.append(line)
                if found := re.search(r"serving (http://127\.0\.0\.1:\d+)", line):
                    running.address = found[1]
                if "startup complete" in line:
                    break
            assert running.address, "".join(running.written)
            rest = Thread(target=running.written.extend, args=(process.stderr,))
            rest.start()
            try:
                yield running
            finally:
                process.kill()  # what has ended by itself is not concerned
                rest.join()
        finally:
            process.kill()


def client_of(running: ServiceProcess) -> httpx.Client:
    """A client of a service."""
    return httpx.Client(base_url=running.address, timeout=60)
