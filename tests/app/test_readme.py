"""The commands of the README lead to a diagnosis, as they stand there; the port alone is another, lest it be taken."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEADING = "## From nothing to a diagnosis over HTTP"


def commands() -> list[str]:
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition(HEADING)[2]
    block = re.search(r"```\n(.*?)```", section, re.DOTALL)
    assert block is not None
    return block[1].splitlines()


def test_there_are_five_commands() -> None:
    assert len(commands()) == 5
    assert sum(command.startswith("curl ") for command in commands()) == 2


@pytest.mark.long
@pytest.mark.timeout(3000)  # two minutes of a processor, beside whatever other work
def test_the_commands_of_the_readme_lead_to_a_diagnosis(tmp_path: Path) -> None:
    for entry in ROOT.iterdir():  # the checkout, without what was made in it
        if not entry.name.startswith(".") and entry.name != "build":
            (tmp_path / entry.name).symlink_to(entry)
    (tmp_path / ".venv").mkdir()  # what `make install` would make, which needs the network; `make test` has made it
    (tmp_path / ".venv" / "bin").symlink_to(Path(sys.prefix) / "bin")
    (tmp_path / ".venv" / ".installed").touch()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    lines = [command.replace("8000", port) for command in commands()]
    script = "\n".join(["set -e", "trap 'kill $! && wait $!' EXIT", *lines])
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JOINTPLAY_")}
    kept = {name: os.environ[name] for name in ("JOINTPLAY_CACHE_DIR",) if name in os.environ}
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env={**environment, **kept}, capture_output=True, text=True, timeout=2900
    )
    assert done.returncode == 0, done.stderr
    ready, end = json.JSONDecoder().raw_decode(done.stdout, done.stdout.index("{"))
    assert ready == {"status": "ready", "catalogues": 1}
    result = json.loads(done.stdout[end:])
    assert (result["machine"], result["verdict"]) == ("slider-crank", "worn")
    assert list(result["hypotheses"][0]["joints"]) == ["B"]
    clearance = result["hypotheses"][0]["joints"]["B"]
    low, high = clearance["interval_um"]
    assert low <= 150 <= high, clearance
