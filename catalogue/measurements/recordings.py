"""Files that people hand over, whatever they hold: a recording over time, or a spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile, profile_beside
from jointplay.catalogue.measurements.measured_columns import is_spectrum
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum, spectrum_of
from jointplay.catalogue.measurements.measurement import Recording, measurement_of, raw_of
from jointplay.catalogue.measurements.readers import Limits

__all__ = ["read_recording"]


def read_recording(
    source: str | Path | bytes,
    *,
    name: str | None = None,
    sample_rate: float | None = None,
    units: Mapping[str, str] | None = None,
    limits: Limits | None = None,
    profile: ImportProfile | None = None,
) -> Recording | MeasuredSpectrum:
    """Read a recording or a spectrum.

    Parameters and errors are those of :func:`jointplay.catalogue.measurements.measurement.read_measurement`.

    Returns
    -------
    Recording or MeasuredSpectrum
        A spectrum where the first column is a frequency.
    """
    limits, profile = limits or Limits(), profile or profile_beside(source)
    raw, sha256 = raw_of(source, name, limits, profile)
    if is_spectrum(raw, units):
        if sample_rate is not None:
            rule = "is given, but the file holds a spectrum"
            raise MeasurementError(raw.source, None, "sample_rate", sample_rate, rule, field="sample_rate")
        return spectrum_of(raw, dict(units or {}), limits, sha256)
    rate = sample_rate or profile.sample_rate_hz
    return measurement_of(raw, sample_rate=rate, units=units, limits=limits, sha256=sha256)
