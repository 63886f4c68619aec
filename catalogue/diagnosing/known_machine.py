"""What recordings of a machine in order have shown of it, for the diagnosis of later ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from jointplay.catalogue.diagnosing.answer_of_baseline import BaselineRecording, BaselineShown
from jointplay.catalogue.diagnosing.baseline import Baseline, fit_baseline
from jointplay.catalogue.diagnosing.stroke_loads import FoundLoad
from jointplay.catalogue.diagnosing.told import ToldNumbers
from jointplay.catalogue.diagnosing.told_numbers import tell_numbers
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True)
class KnownMachine:
    """What was fitted to recordings of a machine in order, and these themselves.

    Parameters
    ----------
    baseline : Baseline
        What was fitted.
    sha256 : tuple of str
        Of the recordings.
    past : tuple of PreparedMeasurement
        The recordings, which later ones are compared with as such.
    """

    baseline: Baseline
    sha256: tuple[str, ...]
    past: tuple[PreparedMeasurement, ...] = ()
    _told: list[tuple[FoundLoad | None, ToldNumbers | None]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, in_order: Mapping[str, PreparedMeasurement], catalogue: Catalogue) -> KnownMachine:
        """Fit recordings of the machine in order, by their checksums; raises as :func:`fit_baseline`."""
        past = tuple(in_order.values())
        return cls(fit_baseline(past, catalogue), tuple(in_order), past)

    def weights(self, catalogue: Catalogue) -> FloatArray | None:
        """Return how much each entry of a catalogue is of this machine; None where all count the same."""
        if not self.baseline.explained:
            return None
        matrix = catalogue.matrix
        paths = [path for group in self.baseline.paths.values() for path in group]
        rows = [matrix.rows(hypothesis.label) for hypothesis in matrix.hypotheses]
        return self.baseline.weights(matrix.numbers(paths), rows)

    def tell(
        self, catalogue: Catalogue, progress: Callable[[int, int], None] | None = None
    ) -> tuple[FoundLoad | None, ToldNumbers | None]:
        """Return what they tell of load and numbers, by simulations of the machine in order, which are made once.

        Of the catalogue that it was fitted by; `progress` is called with the number of cases done and their total.
        """
        if not self._told:
            earlier = [self.baseline.correct(each, catalogue.machine) for each in self.past]
            self._told.append(tell_numbers(earlier, catalogue, progress))
        return self._told[0]

    def describe(self, *, heard: bool) -> BaselineShown:
        """Return it as an answer shows it that has, or has not, heard how its recording differs from these."""
        found = self.baseline
        first, *further = (
            BaselineRecording(measurement=each.name, measurement_sha256=sha256)
            for each, sha256 in zip(self.past, self.sha256, strict=True)
        )
        return BaselineShown(
            measurement=first.measurement,
            measurement_sha256=first.measurement_sha256,
            further=tuple(further),
            used=found.explained,
            p_before=found.p_before,
            p_after=found.p_after,
            numbers=found.numbers,
            gains=found.gains,
            heard=heard,
        )
