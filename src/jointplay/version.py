"""The version of the product; what it computes and answers has others: ``docs/reference/catalogue-folder.md``."""

from __future__ import annotations

__version__ = "1.0.0"
