"""Variants of a machine: what differs between cases, but is no number that a case could change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

__all__ = ["AS_FILED", "LawChoice", "Variant"]

LawChoice = Literal["own", "linear", "hertz"]
"""Contact law of the turning joints: as the machine file has it, or another one fitted to it."""


@dataclass(frozen=True)
class Variant:
    """How the machine of a case differs in kind from the machine file.

    Parameters
    ----------
    law : {"own", "linear", "hertz"}
        Contact law of the turning joints.
    """

    law: LawChoice = "own"

    @property
    def content(self) -> dict[str, Any]:
        """What differs from the machine file, as plain data; empty if nothing does. :meth:`from_content` reads it."""
        return {} if self.law == "own" else {"law": self.law}

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Self:
        """Read what :attr:`content` wrote.

        Raises
        ------
        TypeError
            There is more than that in it.
        ValueError
            A law that is not known.
        """
        variant = cls(**content)
        if variant.law not in get_args(LawChoice):
            raise ValueError(f"law {variant.law!r} is not known")
        return variant


AS_FILED = Variant()
"""The machine as its file has it."""
