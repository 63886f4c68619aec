"""The command line, as tests call it."""

from __future__ import annotations

import sys
from pathlib import Path

from click.testing import CliRunner, Result

from jointplay.app.cli import main

JOINTPLAY = [sys.executable, "-m", "jointplay.app.cli"]


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def assert_refused(result: Result, status: int, text: str) -> None:
    assert result.exit_code == status
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("jointplay: ")
    assert text in lines[0]
