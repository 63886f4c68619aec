"""``jointplay serve``: the HTTP interface and the web page."""

from __future__ import annotations

import ipaddress
import logging
import signal
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.errors import AddressError

if TYPE_CHECKING:
    from jointplay.app.settings import ServiceSettings

log = logging.getLogger(__name__)


@click.command("serve")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="Port; 0 takes a free one."
)
@click.option(
    "--catalogues",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Directory of catalogues, or one catalogue (JOINTPLAY_CATALOGUES) [default: .jointplay/catalogues].",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Directory for uploads and results (JOINTPLAY_DATA) [default: .jointplay/server].",
)
@click.option("--workers", type=click.IntRange(1, 256), help="Processes that compute (JOINTPLAY_WORKERS) [default: 2].")
@click.option(
    "--no-keys", is_flag=True, help="Ask for no API keys (JOINTPLAY_KEYS=off); only where this computer alone can ask."
)
def command(
    host: str, port: int, catalogues: Path | None, data: Path | None, workers: int | None, no_keys: bool
) -> None:
    """Serve the HTTP interface (/api/v1, /openapi.json) and the web page (/).

    Every setting may also come from the environment, as JOINTPLAY_ and the setting's name in capitals.
    """
    from pydantic import ValidationError

    from jointplay.app.http.connections import Server, listen, most_connections
    from jointplay.app.logs import LogSettings, configure
    from jointplay.app.main import create_app
    from jointplay.app.settings import ServiceSettings

    given: dict[str, Any] = {"catalogues": catalogues, "data": data, "workers": workers}
    given["keys"] = "off" if no_keys else None
    try:
        settings = ServiceSettings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        raise click.UsageError(f"JOINTPLAY_{'_'.join(map(str, first['loc'])).upper()}: {first['msg']}") from None
    if settings.keys == "off" and not loopback(host):
        raise AddressError(
            f"{host}: without keys (--no-keys) only this computer itself may ask: 127.0.0.1, ::1, localhost"
        )
    if settings.scheduler:
        from jointplay.catalogue.building.cluster import check_address

        check_address(settings.scheduler)
    settings = answering(settings, host)
    configure(LogSettings(settings.log_format, settings.log_level))
    if not settings.catalogues.is_dir():
        say(settings, f"{settings.catalogues}: no catalogues there yet; `jointplay build` makes one")
    most = most_connections(settings)
    listener = listen(host, port)
    say(settings, f"serving http://{host}:{listener.getsockname()[1]}")
    if settings.keys == "required":
        say(settings, "requests need a key; `jointplay keys create NAME` makes one")
    try:
        application = create_app(settings, warm=True)
    except BaseException:
        listener.close()
        raise
    server = Server(
        application,
        listener,
        most,
        min(settings.connections_per_address, max(1, most // 2)),
        # Before it waits for answers to end: a stream of events would go on as long as somebody reads it.
        before_stop=lambda: application.state.service.stop(),
        server_header=False,
        log_config=None,
        access_log=False,
        proxy_headers=False,  # the application believes those of proxies that it is told of, and no others
        timeout_graceful_shutdown=ceil(settings.stop_limit_s),
    )
    # The server takes SIGTERM itself, and sends it again when it has stopped: a stop in good order is no failure (0).
    signal.signal(signal.SIGTERM, lambda _number, _frame: None)
    server.run()
    if not server.started:
        raise click.exceptions.Exit(1)


def say(settings: ServiceSettings, text: str) -> None:
    """Tell whoever started the service something; where the log is JSON, as a line of it."""
    if settings.log_format == "json":
        log.info(text)
    else:
        click.echo(f"jointplay: {text}", err=True)


def loopback(host: str) -> bool:
    """Return whether only this computer can reach an address; a name that others could stand behind is none."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def answering(settings: ServiceSettings, host: str) -> ServiceSettings:
    """Return settings under which a service answers to the address that it listens at, besides the names they hold."""
    try:
        every = ipaddress.ip_address(host).is_unspecified
    except ValueError:
        every = False
    return settings if every else settings.model_copy(update={"hosts": f"{settings.hosts},{host}"})
