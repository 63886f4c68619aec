"""Settings that hold for every test."""

from __future__ import annotations

from hypothesis import settings

# Examples are drawn the same way in every run, and a slow first call (an import, a compilation) is no failure.
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("repeatable")
