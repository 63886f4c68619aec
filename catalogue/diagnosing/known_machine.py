"""A machine of which a recording in order is known, as a diagnosis uses it."""

from __future__ import annotations

from dataclasses import dataclass

from jointplay.catalogue.diagnosing.answer import BaselineShown
from jointplay.catalogue.diagnosing.baseline import Baseline
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True)
class KnownMachine:
    """What was fitted to a recording of the machine in order, and the checksum of that recording."""

    baseline: Baseline
    sha256: str

    def weights(self, catalogue: Catalogue) -> FloatArray | None:
        """Return how much each entry of a catalogue is of this machine; None where all count the same."""
        if not self.baseline.explained:
            return None
        matrix = catalogue.matrix
        paths = [path for group in self.baseline.paths.values() for path in group]
        rows = [matrix.rows(hypothesis.label) for hypothesis in matrix.hypotheses]
        return self.baseline.weights(matrix.numbers(paths), rows)

    def shown(self) -> BaselineShown:
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
