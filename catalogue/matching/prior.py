"""What is held likely before a recording is heard: which joints wear, and how many at once."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from catalogue.errors import DiagnosisError

if TYPE_CHECKING:
    from catalogue.matching.matcher import MatchResult

__all__ = ["LARGEST", "Prior"]

LARGEST = 1000.0
"""Weights lie between one part of this and this: beyond, no recording could say otherwise."""


@dataclass(frozen=True)
class Prior:
    """Weights of hypotheses before a recording; that of a machine in order is 1.

    Parameters
    ----------
    another : float
        What every worn joint beyond the first multiplies a weight by. Joints of one machine have run the same hours, so
        that wear in one is no reason to expect none in another; draws held out of catalogues are told apart best with
        0.3 to 0.5 (docs/decisions.md).
    joints : mapping of str to float
        What a joint multiplies by where it is worn; 1 for those that are not named.

    Raises
    ------
    DiagnosisError
        A weight is not between 0.001 and 1000.
    """

    another: float = 0.4
    joints: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in (("another", self.another), *((f"joints.{joint}", w) for joint, w in self.joints.items())):
            if not 1.0 / LARGEST <= value <= LARGEST:
                raise DiagnosisError(f"prior.{name}: {value}: must be from {1.0 / LARGEST:g} to {LARGEST:g}")

    def check(self, known: Collection[str]) -> None:
        """Refuse joints that are not among those of the machine that may wear.

        Raises
        ------
        DiagnosisError
            A joint is not known.
        """
        for joint in self.joints:
            if joint not in known:
                raise DiagnosisError(f"prior.joints.{joint}: must be one of the joints {', '.join(sorted(known))}")

    def weight(self, joints: Collection[str]) -> float:
        """Return the weight of a hypothesis, given by its worn joints."""
        return self.another ** max(0, len(joints) - 1) * math.prod(self.joints.get(joint, 1.0) for joint in joints)

    def applied(self, result: MatchResult) -> MatchResult:
        """Return an answer that was found with the usual prior as it is with this one."""
        usual = Prior()
        if self == usual:
            return result
        factors = [self.weight(match.joints) / usual.weight(match.joints) for match in result.hypotheses]
        total = sum(match.probability * factor for match, factor in zip(result.hypotheses, factors, strict=True))
        again = (
            replace(match, probability=match.probability * factor / total)
            for match, factor in zip(result.hypotheses, factors, strict=True)
        )
        return replace(result, hypotheses=tuple(sorted(again, key=lambda match: -match.probability)))
