"""Fields of a form that go with a file, as the OpenAPI document describes them."""

from __future__ import annotations

from typing import Any

from jointplay.catalogue.measurements.import_profile import SpectrumSaid


def text(description: str) -> dict[str, Any]:
    """Return the description of a field of text."""
    return {"type": "string", "description": description}


def one_of(name: str, description: str) -> dict[str, Any]:
    """Return the description of a field of a spectrum that has one of a few values."""
    schema = SpectrumSaid.model_json_schema()["properties"][name]["anyOf"][0]
    return {"type": "string", "enum": schema["enum"], "description": description}


FILE = {
    "type": "string",
    "format": "binary",
    "description": "A recording or a spectrum: CSV, UFF 58, WAV, MAT, TDMS, HDF5, NPZ or JSON, by content and name.",
}
ASSET = text("External id of the machine that was measured; it has to be known.")
#: What can be said of a file that does not say it itself.
SAID: dict[str, Any] = {
    "sample_rate": text('Sample rate of a recording without times: "10 kHz", or a number in Hz.'),
    "units": text('Unit of all columns that name none ("g"), or a JSON object: column to unit.'),
    "full_scale": text('What the full scale of a WAV file stands for: "5 g", or "1 V" with a sensitivity.'),
    "sensitivity": text('What a sensor gives ("100 mV/g"), of all columns in volts, or a JSON object by column.'),
    "tacho": text("Column with pulses of the drive's shaft."),
    "pulses_per_revolution": {"type": "string", "description": "Of the tacho; 1 unless given."},
    "scaling": one_of("scaling", "What the numbers of a spectrum are."),
    "detector": one_of("detector", "Whether amplitudes of a spectrum are rms or peak."),
    "decibel": {"type": "string", "enum": ["true", "false"], "description": "Whether a spectrum is in dB."},
    "reference": text("Of levels in dB, in the unit of the column."),
    "window": one_of("window", "Of a spectrum of amplitudes or powers."),
    "profile": text(
        "A mapping profile in YAML or JSON, as a text or as a file: names, units, decimal comma and all of the above."
    ),
}
