"""Settings that hold for every test."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import databases
import pytest
from hypothesis import HealthCheck, settings

from jointplay.catalogue.processes import ONE_THREAD

# Processes of tests fill all processors: threads of arithmetic besides only wait for each other (a tenth of all work).
# Whatever comes to be numbers has not been imported yet.
os.environ.update(ONE_THREAD)

# What tests ask a service is not who may ask; those that ask just that make keys of their own.
os.environ.setdefault("JOINTPLAY_KEYS", "off")

# Examples are drawn the same way in every run, and slowness (an import, a compilation, other work) is no failure.
UNHURRIED = [HealthCheck.too_slow]
settings.register_profile(
    "repeatable", derandomize=True, deadline=None, max_examples=50, suppress_health_check=UNHURRIED
)
settings.load_profile("repeatable")


@pytest.fixture(params=databases.KINDS)
def url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """A new database of each kind there is."""
    with databases.database(request.param, tmp_path) as found:
        yield found


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """SIGINT as a shell hands it to what runs in front.

    In the background (`make test &`, some runners of CI) tests inherit a signal that is ignored, and so would whatever
    they start.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
