"""Dockerfile and compose.yaml are whole: what they name is there, every part is watched, nobody is root."""

from __future__ import annotations

import ipaddress
import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from command_line import invoke
from distributed.cli import dask_scheduler, dask_worker
from ruamel.yaml import YAML

from jointplay.app.settings import SECRETS, ServiceSettings

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docker"
OURS = ("api", "scheduler", "worker")
OTHERS = ("proxy", "prometheus", "grafana")


def stages() -> dict[str, tuple[str, list[tuple[str, str]]]]:
    """By name, what a stage of the Dockerfile begins with, and its instructions."""
    found: dict[str, tuple[str, list[tuple[str, str]]]] = {}
    text = re.sub(r"^#.*\n", "", (FOLDER / "Dockerfile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    for line in re.sub(r"\\\n\s*", " ", text).splitlines():
        if not line.strip():
            continue
        word, _, rest = line.partition(" ")
        if word == "FROM":
            start, _, name = rest.partition(" AS ")
            steps: list[tuple[str, str]] = []
            found[name] = (start, steps)
        else:
            steps.append((word, rest.strip()))
    return found


def instructions(name: str) -> list[tuple[str, str]]:
    """All instructions of an image, those of the stages it begins with first."""
    known = stages()
    start, steps = known[name]
    return [*(instructions(start) if start in known else []), *steps]


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    with open(FOLDER / "compose.yaml", encoding="utf-8") as file:
        return json.loads(json.dumps(YAML(typ="safe").load(file)))  # type: ignore[no-any-return]


def test_the_images_are_built_from_what_there_is() -> None:
    for _start, steps in stages().values():
        for sources in (rest.split()[:-1] for word, rest in steps if word == "COPY" and not rest.startswith("--from")):
            for source in sources:
                assert (ROOT / source).exists(), source
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    copied = " ".join(rest for word, rest in stages()["build"][1] if word == "COPY").split()
    files = packages["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    assert {name.partition("/")[0] for name in files} <= set(copied)
    (extras,) = re.findall(r"'\.\[([\w,]+)\]'", " ".join(rest for _word, rest in stages()["build"][1]))
    assert set(extras.split(",")) <= set(packages["project"]["optional-dependencies"])


@pytest.mark.parametrize("target", ["api", "worker"])
def test_nobody_is_root(target: str) -> None:
    users = [rest for word, rest in instructions(target) if word == "USER"]
    assert re.fullmatch(r"[1-9]\d+:[1-9]\d+", users[-1])
    assert all(word not in ("RUN", "ADD") for word, _rest in stages()[target][1])


def test_variables_of_images_and_services_are_settings(compose: dict[str, Any]) -> None:
    known = {f"JOINTPLAY_{name.upper()}" for name in ServiceSettings.model_fields} | {SECRETS}
    text = " ".join(rest for word, rest in instructions("api") if word == "ENV")
    named = {*re.findall(r"JOINTPLAY_\w+", text), *compose["services"]["api"]["environment"]}
    assert {name for name in named if name.startswith("JOINTPLAY_")} <= known
    assert {"JOINTPLAY_SECRETS", "JOINTPLAY_SCHEDULER", "JOINTPLAY_DATA"} <= named


def test_every_service_is_watched_and_ours_have_no_rights(compose: dict[str, Any]) -> None:
    assert set(compose["services"]) == {*OURS, *OTHERS, "database"}
    for name, service in compose["services"].items():
        assert service["healthcheck"]["test"][0] == "CMD", name
        for volume in service.get("volumes", []):
            source, _, place = volume.partition(":")
            assert source in compose["volumes"] or ((FOLDER / source).is_dir() and place.endswith(":ro")), volume
    for name in (*OURS, *OTHERS):
        service = compose["services"][name]
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert service["tmpfs"]
        build = service.get("build")
        assert build is None or (
            build["target"] in stages() and (FOLDER / build["context"] / build["dockerfile"]).is_file()
        )
    assert compose["services"]["worker"]["image"] == compose["services"]["scheduler"]["image"]


def test_nothing_takes_all_of_the_computer(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        assert {"mem_limit", "cpus", "pids_limit"} <= set(service), name
        assert set(service["logging"]["options"]) == {"max-size", "max-file"}, name


def test_the_proxy_alone_is_reached_from_outside_and_believed(compose: dict[str, Any]) -> None:
    services = compose["services"]
    outside = {name: service["ports"] for name, service in services.items() if "ports" in service}
    assert outside == {"proxy": ["80:80", "443:443"], "grafana": ["127.0.0.1:3000:3000"]}
    address = services["proxy"]["networks"]["front"]["ipv4_address"]
    assert services["api"]["environment"]["JOINTPLAY_PROXIES"] == address
    (own,) = compose["networks"]["front"]["ipam"]["config"]
    assert ipaddress.ip_address(address) in ipaddress.ip_network(own["subnet"])
    # Whoever starts before the proxy is given no address that is its own.
    assert ipaddress.ip_network(own["ip_range"]).subnet_of(ipaddress.ip_network(own["subnet"]))
    assert ipaddress.ip_address(address) not in ipaddress.ip_network(own["ip_range"])
    assert compose["networks"]["back"] == {"internal": True}
    assert {name for name, each in services.items() if "front" in each["networks"]} == {"proxy", "api", "grafana"}
    assert services["proxy"]["environment"]["JOINTPLAY_SITE"] in services["api"]["environment"]["JOINTPLAY_HOSTS"]


def test_secrets_are_files_and_nothing_else_is_one(compose: dict[str, Any]) -> None:
    given = {name for service in compose["services"].values() for name in service.get("secrets", [])}
    assert given == set(compose["secrets"])
    assert all(set(secret) == {"file"} for secret in compose["secrets"].values())
    text = (FOLDER / "compose.yaml").read_text(encoding="utf-8")
    named = re.findall(r"\w*PASSWORD\w*", text)
    assert named == ["POSTGRES_PASSWORD_FILE", "GF_SECURITY_ADMIN_PASSWORD__FILE"]
    assert "jointplay_database" in given
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    assert {"docker/secrets/", "docker/proxy/users"} <= set(ignored)


def test_services_name_each_other_by_the_ports_they_have(compose: dict[str, Any]) -> None:
    text = (FOLDER / "compose.yaml").read_text(encoding="utf-8")
    port = compose["services"]["scheduler"]["command"][compose["services"]["scheduler"]["command"].index("--port") + 1]
    assert set(re.findall(r"tcp://(\w+):(\d+)", text)) == {("scheduler", port)}
    assert all(
        name in compose["services"]
        for service in compose["services"].values()
        for name in service.get("depends_on", {})
    )
    stop = float(compose["services"]["api"]["stop_grace_period"].removesuffix("s"))
    assert stop > ServiceSettings.model_fields["stop_limit_s"].default + 5


@pytest.mark.parametrize("service", ["scheduler", "worker"])
def test_dask_knows_the_options(compose: dict[str, Any], service: str) -> None:
    command = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}[service]
    program, *options = compose["services"][service]["command"]
    assert program == service
    known = CliRunner().invoke(command, ["--help"]).output
    for option in options:
        assert not option.startswith("-") or re.search(rf"{option}\b", known), option


def test_the_program_knows_the_commands_of_the_readme() -> None:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    named = {shlex.split(each)[0] for each in re.findall(r"(?:api jointplay|/data jointplay-api) (\w+)", text)}
    assert named == {"keys", "backup", "build"}
    for name in named:
        assert invoke(name, "--help").exit_code == 0
