"""The version of the product; of what it computes and answers there are others, see ``docs/catalogue.md``."""

from __future__ import annotations

__version__ = "0.1.0"
