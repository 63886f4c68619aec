"""Settings of the service, read from the environment (prefix ``JOINTPLAY_``)."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SecretsSettingsSource,
    SettingsConfigDict,
)

from jointplay.app.errors import BadFieldError

SECRETS = "JOINTPLAY_SECRETS"
"""Names a folder whose files hold settings, such as ``jointplay_database``."""


class ServiceSettings(BaseSettings):
    """What the service may be told from outside; every field has a working default.

    A field ``time_limit_s`` is read from ``JOINTPLAY_TIME_LIMIT_S``, or from a file ``jointplay_time_limit_s`` in the
    folder that ``JOINTPLAY_SECRETS`` names, which is for what nobody should see in an environment.
    """

    model_config = SettingsConfigDict(env_prefix="JOINTPLAY_", frozen=True, extra="ignore")

    catalogues: Path = Field(
        default=Path(".jointplay/catalogues"),
        description="Directory whose sub-directories are catalogues; it may also be one catalogue itself.",
    )
    data: Path = Field(
        default=Path(".jointplay/server"),
        description="Directory for uploaded recordings and the data base of results; made when missing.",
    )
    database: str = Field(
        default="",
        description="Data base of results as a URL, postgresql://user@host/database; by default a file of SQLite in"
        " `data`.",
    )
    max_upload_mb: float = Field(
        default=200.0, gt=0, description="Largest upload in megabytes (10^6 bytes); a larger one is answered with 413."
    )
    time_limit_s: float = Field(
        default=120.0, gt=0, description="Longest time one reading or diagnosis may compute, in seconds; then 504."
    )
    workers: int = Field(
        default=2, ge=1, le=256, description="Number of processes that read recordings and diagnose them."
    )
    queue_limit: int = Field(
        default=32, ge=1, description="Number of requests that may wait for a worker; more are answered with 503."
    )
    keys: Literal["required", "off"] = Field(
        default="required",
        description="Whether requests need an API key: required, or off where this computer alone can ask.",
    )
    hosts: str = Field(
        default="localhost,127.0.0.1,::1",
        description="Names under which the service may be asked (Host header), with commas between; * for any.",
    )
    proxies: str = Field(
        default="",
        description="Addresses and networks of proxies in front, with commas between: from there alone"
        " X-Forwarded-For and -Proto are believed.",
    )
    people: str = Field(
        default="",
        description="What people may do who sign in at such a proxy (X-Forwarded-User), by group (X-Forwarded-Groups):"
        " *=read; fitters=read match.",
    )
    rate_limit_per_s: float = Field(
        default=1000.0, gt=0, description="Requests a second that one key, or one address without key, may make."
    )
    rate_burst: float = Field(
        default=2000.0, ge=1, description="Requests that may come at once before the limit a second counts; then 429."
    )
    connections: int = Field(
        default=1000,
        ge=2,
        description="Connections at a time, at most half of the files that the process may have open.",
    )
    connections_per_address: int = Field(
        default=250, ge=1, description="Connections of one address at a time, at most half of all; a proxy is one."
    )
    receive_timeout_s: float = Field(
        default=30.0, gt=0, description="Longest time that the body of a request may pause, in seconds; then 408."
    )
    scheduler: str = Field(
        default="",
        description="Address of a Dask scheduler, tcp://host:8786, whose workers compute builds in place of processes.",
    )
    builds: int = Field(
        default=1,
        ge=0,
        le=64,
        description="Number of catalogues that are built at a time; with 0 other servers of the same database do it.",
    )
    build_lease_s: float = Field(
        default=30.0,
        ge=1.0,
        description="Seconds after which another server takes up a build whose server gives no sign of life.",
    )
    webhooks_private: bool = Field(
        default=False, description="Whether webhooks may lead to addresses that are not public, such as 10.0.0.5."
    )
    keep_routine_days: float | None = Field(
        default=None,
        gt=0,
        description="Days that routine recordings are kept, from when they came; for ever unless set.",
    )
    keep_baseline_days: float | None = Field(
        default=None,
        gt=0,
        description="Days that recordings are kept that somebody says are baselines; those in use stay.",
    )
    keep_evidence_days: float | None = Field(
        default=None, gt=0, description="Days that evidence is kept: recordings that a finding speaks of."
    )
    quota_gb: float | None = Field(
        default=None, gt=0, description="Gigabytes (10^9 bytes) of recordings that may be stored in all; then 507."
    )
    quota_each_gb: float | None = Field(
        default=None,
        gt=0,
        description="Gigabytes of recordings that one key, or one person signed in at a proxy, may store; then 507.",
    )
    stop_limit_s: float = Field(
        default=30.0,
        ge=0.0,
        description="Longest time that answers have to end after SIGTERM, in seconds; those that do not get a 503.",
    )
    log_format: Literal["text", "json"] = Field(
        default="text", description="Form of the log on stderr: text, or json with one object a line."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Least level of what is logged."
    )
    page_size: int = Field(default=50, ge=1, le=500, description="Number of items in one page of a list.")

    @field_validator("proxies")
    @classmethod
    def are_addresses(cls, given: str) -> str:
        """Refuse proxies that are no addresses."""
        networks(listed(given))
        return given

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return where settings come from, what wins first: arguments, environment, files of secrets.

        Raises
        ------
        BadFieldError
            When there is no such folder of secrets.
        """
        folder = os.environ.get(SECRETS, "")
        if not folder:
            return init_settings, env_settings
        if not Path(folder).is_dir():
            raise BadFieldError(f"{SECRETS}: {folder}: is no folder")
        return init_settings, env_settings, SecretsSettingsSource(settings_cls, secrets_dir=folder)

    @property
    def max_upload_bytes(self) -> int:
        """Largest request body that is read, in bytes; multipart framing is included."""
        return int(self.max_upload_mb * 1e6)

    @property
    def keep_days(self) -> dict[str, float | None]:
        """How long recordings of each class are kept, in days; None for ever."""
        return {name: getattr(self, f"keep_{name}_days") for name in ("routine", "baseline", "evidence")}

    @property
    def quotas(self) -> tuple[float | None, float | None]:
        """How many bytes of recordings may be stored in all, and by one key or person."""
        both = (self.quota_gb, self.quota_each_gb)
        return tuple(None if each is None else 1e9 * each for each in both)  # type: ignore[return-value]

    @property
    def allowed_hosts(self) -> frozenset[str]:
        """Names of `hosts`, in lower case."""
        return frozenset(name.lower() for name in listed(self.hosts))

    @property
    def trusted_proxies(self) -> tuple[str, ...]:
        """Addresses and networks of `proxies`."""
        return listed(self.proxies)


def listed(given: str) -> tuple[str, ...]:
    """Return the items of a text with commas between."""
    return tuple(item.strip() for item in given.split(",") if item.strip())


def networks(given: Sequence[str]) -> tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...]:
    """Return addresses and networks; an address is a network of one.

    Raises
    ------
    ValueError
        For what is neither.
    """
    return tuple(ipaddress.ip_network(each) for each in given)
