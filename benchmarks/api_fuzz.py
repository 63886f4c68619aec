"""Schemathesis against a running service: ``python -m benchmarks.api_fuzz CATALOGUES [--examples 50]``.

It starts a server of its own over a directory of catalogues and sends what the OpenAPI document allows, what it
forbids, and chains of both, over every operation. Builds are ordered and cancelled, but not carried out.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.entry_load import serving

CONFIGURATION = Path(__file__).parent.parent / "schemathesis.toml"
PHASES = "examples,coverage,fuzzing,stateful"
COLOURS = re.compile(r"\x1b\[[0-9;]*m")


@dataclass(frozen=True)
class Found:
    """What a run of Schemathesis says.

    Parameters
    ----------
    calls, operations, tested : int
        Requests sent; operations of the document, and those that were reached.
    failures : int
        Answers that broke a check.
    exit_status : int
    output : str
    """

    calls: int
    operations: int
    tested: int
    failures: int
    exit_status: int
    output: str

    @property
    def whole(self) -> bool:
        """Whether every operation was reached, and nothing failed."""
        return self.exit_status == 0 and not self.failures and 0 < self.operations == self.tested


def run(address: str, examples: int, seed: int = 1, phases: str = PHASES, more: Sequence[str] = ()) -> Found:
    """Run Schemathesis against a service.

    Parameters
    ----------
    address : str
    examples : int
        Most requests for one operation in a phase of random ones.
    seed : int
    phases : str
        Names with commas between.
    more : sequence of str
        Further options.
    """
    program = Path(sys.executable).parent / "schemathesis"
    command = [str(program), "--config-file", str(CONFIGURATION), "run", f"{address}/openapi.json", "--mode", "all"]
    command += ["--phases", phases, "--max-examples", str(examples), "--seed", str(seed), *more]
    command += ["--suppress-health-check", "all", "--request-timeout", "60", "--generation-database", "none"]
    ended = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"})
    output = COLOURS.sub("", ended.stdout + ended.stderr)

    def number(pattern: str) -> int:
        match = re.search(pattern, output)
        return int(match[1].replace(",", "")) if match else 0

    return Found(
        calls=number(r"([\d,]+) generated"),
        operations=number(r"Selected: (\d+)/"),
        tested=number(r"Tested: (\d+)"),
        failures=number(r"(\d+) unique failure") or number(r"found (\d+)"),
        exit_status=ended.returncode,
        output=output,
    )


def main() -> None:
    """Print the report and a last line of figures; exit with 1 when anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("catalogues", type=Path)
    parser.add_argument("--examples", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as data, serving(given.catalogues, Path(data)) as (address, _, _):
        found = run(address, given.examples, given.seed)
    print(found.output)
    print(f"{found.calls} calls, {found.tested} of {found.operations} operations, {found.failures} failures")
    raise SystemExit(0 if found.whole else 1)


if __name__ == "__main__":
    main()
