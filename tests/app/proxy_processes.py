"""Proxies of Debian's packages before a service, with the files of docker/proxy."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import trustme

FOLDER = Path(__file__).parents[2] / "docker" / "proxy"


def program(name: str) -> str:
    """Where a proxy is; its tests are skipped where there is none, unless somebody said that there must be."""
    found = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if found is None:
        if os.environ.get("JOINTPLAY_REQUIRE_PROXY"):
            pytest.fail(f"{name} is not installed, and JOINTPLAY_REQUIRE_PROXY is set")
        pytest.skip(f"{name} is not installed")
    return found


def free_ports(count: int) -> list[int]:
    """Ports of this computer that nobody listens at."""
    held = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    found = [each.getsockname()[1] for each in held]
    for each in held:
        each.close()
    return found


@contextmanager
def started(command: Sequence[str], ports: Sequence[int], log: Path, **more: Any) -> Iterator[None]:
    """Run a proxy until it listens at its ports, for the time of a ``with`` block."""
    with log.open("w") as file, subprocess.Popen(command, stdout=file, stderr=file, **more) as process:
        try:
            deadline = time.monotonic() + 120
            for port in ports:
                while True:
                    assert process.poll() is None and time.monotonic() < deadline, log.read_text()
                    try:
                        socket.create_connection(("127.0.0.1", port), 1).close()
                        break
                    except OSError:
                        time.sleep(0.05)
            yield
        finally:
            process.terminate()


def certificates(folder: Path) -> tuple[Path, Path, Path]:
    """Files of a certificate for this computer, of its key and of the authority."""
    authority = trustme.CA()
    made = authority.issue_cert("localhost", "127.0.0.1")
    names = [folder / name for name in ("jointplay.crt", "jointplay.key", "authority.crt")]
    made.cert_chain_pems[0].write_to_path(names[0])
    made.private_key_pem.write_to_path(names[1])
    authority.cert_pem.write_to_path(names[2])
    return names[0], names[1], names[2]


@contextmanager
def caddy(service: str, folder: Path, users: str, oauth2: str, tls: tuple[Path, Path]) -> Iterator[dict[str, str]]:
    """One Caddy with the Caddyfile for each way to sign in; gives the address of each."""
    found = program("caddy")
    files = folder / "proxy"
    shutil.copytree(FOLDER, files)
    (files / "users").write_text(users, encoding="utf-8")
    home = {**os.environ, "HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    ways = ("keys", "basic", "oauth2")
    ports = dict(zip(ways, free_ports(len(ways)), strict=True))
    servers, whole = {}, {}
    for way, port in ports.items():
        told = {
            "JOINTPLAY_SIGN_IN": way,
            "JOINTPLAY_UPSTREAM": service.removeprefix("http://"),
            "JOINTPLAY_OAUTH2": oauth2.removeprefix("http://"),
            "JOINTPLAY_TLS": f"{tls[0]} {tls[1]}",
        }
        adapt = [found, "adapt", "--config", str(files / "Caddyfile")]
        done = subprocess.run(adapt, env=home | told, capture_output=True, text=True, check=True)
        whole = json.loads(done.stdout)
        (server,) = whole["apps"]["http"]["servers"].values()
        assert server["listen"] == [":443"]
        # As shipped, but at ports of this computer alone.
        servers[way] = {**server, "listen": [f"127.0.0.1:{port}"], "automatic_https": {"disable": True}}
    whole["apps"]["http"]["servers"] = servers
    whole["admin"] = {"disabled": True}
    config = folder / "caddy.json"
    config.write_text(json.dumps(whole), encoding="utf-8")
    run = [found, "run", "--config", str(config)]
    with started(run, list(ports.values()), folder / "caddy.log", env=home):
        yield {way: f"https://localhost:{port}" for way, port in ports.items()}


@contextmanager
def nginx(service: str, folder: Path, tls: tuple[Path, Path]) -> Iterator[tuple[str, str]]:
    """An nginx with nginx.conf; gives its addresses, that of TLS first."""
    found = program("nginx")
    port, plain = free_ports(2)
    text = (FOLDER / "nginx.conf").read_text(encoding="utf-8")
    own = "".join(
        f"    {kind}_temp_path {folder}/{kind};\n" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    for shipped, here in (
        ("listen 443 ssl;", f"listen 127.0.0.1:{port} ssl;"),
        ("listen 80;", f"listen 127.0.0.1:{plain};"),
        ("/etc/nginx/tls/jointplay.crt", str(tls[0])),
        ("/etc/nginx/tls/jointplay.key", str(tls[1])),
        ("http://127.0.0.1:8000", service),
        ("worker_processes auto;", "worker_processes 1;"),
        ("http {\n", "http {\n" + own),
    ):
        assert text.count(shipped) == 1, shipped
        text = text.replace(shipped, here)
    config = folder / "nginx.conf"
    config.write_text(text, encoding="utf-8")
    account = "user root; " if os.geteuid() == 0 else ""
    told = f"{account}daemon off; pid {folder}/nginx.pid; error_log stderr;"
    run = [found, "-p", str(folder), "-e", "stderr", "-c", str(config), "-g", told]
    with started(run, [port, plain], folder / "nginx.log"):
        yield f"https://localhost:{port}", f"http://localhost:{plain}"


@contextmanager
def oauth2_proxy(people: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """What answers for oauth2-proxy: by the cookie of a request, which headers say who asks."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = re.search(r"_oauth2_proxy=(\w+)", self.headers.get("Cookie", ""))
            answer = people.get(found[1]) if found else None
            self.send_response(401 if answer is None else 202)
            for name, value in (answer or {}).items():
                self.send_header(name, value)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
