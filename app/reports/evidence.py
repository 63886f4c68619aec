"""The line in a report by which it is told from one of another diagnosis, or of a changed one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from jointplay.app.storage.rows import DiagnosisRow

MARK = "jointplay-evidence"
LINE = re.compile(rb"jointplay-evidence ([0-9a-f]{32}) ([0-9a-f]{64}) ([0-9a-f]{64})((?: [0-9a-f]{64})+)")


@dataclass(frozen=True)
class Evidence:
    """What a report is of.

    Parameters
    ----------
    diagnosis, checksum, catalogue : str
        Id and checksum of the stored diagnosis, id of its catalogue.
    recordings : sequence of str
        SHA-256 of each.
    """

    diagnosis: str
    checksum: str
    catalogue: str
    recordings: Sequence[str]

    @property
    def line(self) -> str:
        """As it stands in a report, among its keywords."""
        return " ".join((MARK, self.diagnosis, self.checksum, self.catalogue, *self.recordings))


def evidence_of(row: DiagnosisRow) -> Evidence:
    """Return what a report of a stored diagnosis is of."""
    answer = row.answer
    first = [answer.provenance.measurement_sha256]
    return Evidence(row.id, row.checksum, row.catalogue, [each.sha256 for each in answer.recordings] or first)


def read_evidence(content: bytes) -> Evidence | None:
    """Return what a report, HTML or PDF, is of; None where it does not say."""
    found = LINE.search(content)
    if found is None:
        return None
    diagnosis, checksum, catalogue, recordings = (part.decode() for part in found.groups())
    return Evidence(diagnosis, checksum, catalogue, recordings.split())
