"""How a recording may be matched. Nothing is imported here: the command line offers these words, too."""

from __future__ import annotations

from typing import Literal

Mode = Literal["trusted", "robust"]
"""How far a model is believed: as simulated, or with everything that may differ in the real machine."""

ModeAsked = Literal["auto", "trusted", "robust"]
"""A mode, or what the recording says for itself."""

Effort = Literal["fast", "standard", "thorough"]
"""How much an answer may cost."""

UNKNOWN_BELOW = 0.02
"""P-value below which a hypothesis does not explain a recording."""
