"""Finds worn joints of planar machines from the vibration of their frame."""

from __future__ import annotations

__version__ = "0.1.0"
