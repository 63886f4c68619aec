"""Catalogues of simulated vibration spectra: planning, building, storing and comparing them with measurements."""

from __future__ import annotations

FEATURES_VERSION = 2
"""Of what is compared. It changes when, and only when, the same recording or the same entry may have other features:
with the steps that recordings go through, with what sensors are taken to see of entries. Models and networks learned
from other features are not used. Frozen cases in ``tests/catalogue/test_versions.py`` say when that is.
"""

MATCHER_VERSION = 3
"""Of what is answered. It changes when, and only when, the same features may have another answer by
the curves of :mod:`jointplay.catalogue.matching.gaussian` or their networks; frozen as the features are.
"""
