"""Dynamics of planar machines with clearance in their joints."""

from __future__ import annotations

NUMBERS_VERSION = 4
"""Of what a simulated case gives. It changes when, and only when, a digit of a stored spectrum may change: with the
equations, the integrators, their tolerances, the estimate of spectra, and not with the version of the product. Frozen
cases in ``tests/solver/test_numbers_version.py`` say when that is.
"""
