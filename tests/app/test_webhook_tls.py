"""Webhooks over TLS: told to who has a certificate for the name, and to nobody else."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme
from webhook_listener import Listener, listening

from jointplay.app.jobs import webhook_sender
from jointplay.app.jobs.webhook_sender import NotDeliveredError, send
from jointplay.app.storage.webhooks import Taken

NAME = "hooks.example"


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture(scope="module")
def secured(authority: trustme.CA) -> Iterator[Listener]:
    """A listener with a certificate for :data:`NAME`."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert(NAME).configure_cert(context)
    with listening(context) as found:
        yield found


@pytest.fixture
def trusted(authority: trustme.CA, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The authority is among those that this computer trusts."""
    file = tmp_path / "authority.pem"
    authority.cert_pem.write_to_path(str(file))
    monkeypatch.setenv("SSL_CERT_FILE", str(file))


def attempt(listener: Listener, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Send a delivery to a name that leads to the listener."""
    monkeypatch.setattr(webhook_sender, "address_of", lambda _host, _port, _private: "127.0.0.1")
    send(
        Taken("d1", f"https://{name}:{listener.server_port}/hook", "whsec_c2VjcmV0", "finding.created", "{}", 1),
        private=False,
    )


@pytest.mark.usefixtures("trusted")
def test_who_has_the_names_certificate_is_told(secured: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    attempt(secured, monkeypatch, NAME)
    told = secured.told.get(timeout=300)
    assert (told.path, told.body, told.headers["host"]) == ("/hook", b"{}", f"{NAME}:{secured.server_port}")


@pytest.mark.usefixtures("trusted")
def test_who_has_another_names_certificate_is_not(secured: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NotDeliveredError, match=r"SSLCertVerificationError.*other\.example"):
        attempt(secured, monkeypatch, "other.example")
    assert secured.told.empty()


def test_who_has_a_certificate_of_nobody_known_is_not(secured: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NotDeliveredError, match="SSLCertVerificationError"):
        attempt(secured, monkeypatch, NAME)
    assert secured.told.empty()


@pytest.mark.usefixtures("trusted")
def test_who_speaks_no_tls_is_not(listener: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NotDeliveredError, match="SSLError"):
        attempt(listener, monkeypatch, NAME)
    assert listener.told.empty()
