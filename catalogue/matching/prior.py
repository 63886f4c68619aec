"""What is held likely before a recording is heard: which joints wear, and how many at once."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from jointplay.catalogue.errors import DiagnosisError

if TYPE_CHECKING:
    from jointplay.catalogue.matching.matcher import MatchResult

LARGEST = 1000.0
"""Weights lie between one part of this and this: beyond, no recording could say otherwise."""


@dataclass(frozen=True)
class Prior:
    """Weights of hypotheses before a recording.

    Parameters
    ----------
    worn : float
        Probability that any joint is worn, joints alike.
    another : float
        How much likelier it is that one joint more is worn, whichever they are: sets of as many joints share that
        equally, so that two worn joints are not likelier on a machine that has more pairs. Joints of one machine have
        run the same hours in the same dirt, so that wear in one is no reason to expect none in another
        (docs/decisions/0117, 0123).
    joints : mapping of str to float
        What a joint multiplies by where it is worn; 1 for those that are not named.

    Raises
    ------
    DiagnosisError
        A weight is not between 0.001 and 1000, or the probability not between 0.001 and 0.999.
    """

    worn: float = 0.75
    another: float = 0.6
    joints: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in (("another", self.another), *((f"joints.{joint}", w) for joint, w in self.joints.items())):
            if not 1.0 / LARGEST <= value <= LARGEST:
                raise DiagnosisError(f"prior.{name}: {value}: must be from {1.0 / LARGEST:g} to {LARGEST:g}")
        if not 1.0 / LARGEST <= self.worn <= 1.0 - 1.0 / LARGEST:
            rule = f"must be from {1.0 / LARGEST:g} to {1.0 - 1.0 / LARGEST:g}"
            raise DiagnosisError(f"prior.worn: {self.worn}: {rule}")

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

    def weight(self, worn: Collection[str], count: int, most: int) -> float:
        """Return the weight of a hypothesis, given by its worn joints, on a machine of so many that may wear.

        No more than `most` wear at once. Without weights of joints it is a probability.
        """
        if not worn:
            return 1.0 - self.worn
        share = self.numbers(count, most)[len(worn) - 1] / math.comb(count, len(worn))
        return self.worn * share * math.prod(self.joints.get(joint, 1.0) for joint in worn)

    def numbers(self, count: int, most: int) -> tuple[float, ...]:
        """Return the probabilities of one to `most` worn joints, of so many that may wear, where any is.

        What is held of single joints is left out.
        """
        weights = [self.another**more for more in range(min(most, count))]
        return tuple(weight / sum(weights) for weight in weights)

    def apply(self, result: MatchResult, count: int) -> MatchResult:
        """Return an answer that was found with the usual prior as it is with this one; `count` joints may wear."""
        usual = Prior()
        if self == usual:
            return result
        most = max(len(match.joints) for match in result.hypotheses)
        factors = [
            self.weight(match.joints, count, most) / usual.weight(match.joints, count, most)
            for match in result.hypotheses
        ]
        total = sum(match.probability * factor for match, factor in zip(result.hypotheses, factors, strict=True))
        again = (
            replace(match, probability=match.probability * factor / total)
            for match, factor in zip(result.hypotheses, factors, strict=True)
        )
        return replace(result, hypotheses=tuple(sorted(again, key=lambda match: -match.probability)))
