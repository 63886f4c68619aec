"""What passes between the process that reads a file and the one that asked for it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from jointplay.catalogue.measurements.readers.raw import RawColumn, RawRecording, SpectrumForm


def encoded(raw: RawRecording) -> dict[str, Any]:
    """Answer that stands for a recording.

    Parameters
    ----------
    raw : RawRecording

    Returns
    -------
    dict
        Members of JSON, and the numbers (n, c) under ``values``.
    """
    return {
        "columns": [asdict(column) for column in raw.columns],
        "sample_rate": raw.sample_rate,
        "facts": list(raw.facts),
        "warnings": list(raw.warnings),
        "declared": raw.declared,
        "relative": raw.relative,
        "ceiling": raw.ceiling,
        "form": None if raw.form is None else asdict(raw.form),
        "shape": list(raw.values.shape),
        "values": np.ascontiguousarray(raw.values, dtype="<f8"),
    }


def decoded(head: dict[str, Any], body: bytes, source: str) -> RawRecording:
    """Recording of an answer; the inverse of :func:`encoded`.

    Parameters
    ----------
    head : dict
        Members of JSON.
    body : bytes
        The numbers.
    source : str
        What messages call the file.

    Returns
    -------
    RawRecording
    """
    return RawRecording(
        source=source,
        columns=tuple(RawColumn(**column) for column in head["columns"]),
        values=np.frombuffer(body, dtype="<f8").reshape(head["shape"]).astype(np.float64),
        sample_rate=head["sample_rate"],
        facts=tuple(head["facts"]),
        warnings=tuple(head["warnings"]),
        declared=head["declared"],
        relative=head["relative"],
        ceiling=head["ceiling"],
        form=None if head["form"] is None else SpectrumForm(**head["form"]),
    )
