"""What recordings of a machine in order have shown of it, for the diagnosis of later ones."""

from __future__ import annotations

from dataclasses import dataclass

from jointplay.catalogue.diagnosing.answer import BaselineShown
from jointplay.catalogue.diagnosing.baseline import Baseline, fit_baseline
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
    sha256 : str
        Of the recording.
    past : tuple of PreparedMeasurement
        Recordings that later ones are compared with as such.
    """

    baseline: Baseline
    sha256: str
    past: tuple[PreparedMeasurement, ...] = ()

    @classmethod
    def of(cls, in_order: PreparedMeasurement, sha256: str, catalogue: Catalogue) -> KnownMachine:
        """Fit a recording of the machine in order; raises as :func:`fit_baseline`."""
        return cls(fit_baseline(in_order, catalogue), sha256, (in_order,))

    def weights(self, catalogue: Catalogue) -> FloatArray | None:
        """Return how much each entry of a catalogue is of this machine; None where all count the same."""
        if not self.baseline.explained:
            return None
        matrix = catalogue.matrix
        paths = [path for group in self.baseline.paths.values() for path in group]
        rows = [matrix.rows(hypothesis.label) for hypothesis in matrix.hypotheses]
        return self.baseline.weights(matrix.numbers(paths), rows)

    def describe(self) -> BaselineShown:
        """Return it as the answer shows it."""
        found = self.baseline
        return BaselineShown(
            measurement=found.name,
            measurement_sha256=self.sha256,
            used=found.explained,
            p_before=found.p_before,
            p_after=found.p_after,
            numbers=found.numbers,
            gains=found.gains,
        )
