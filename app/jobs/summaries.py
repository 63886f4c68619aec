"""What is known of a recording, or of a spectrum, that was read: as JSON values, and in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from jointplay.app.storage.told import Told

if TYPE_CHECKING:
    from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
    from jointplay.catalogue.measurements.measurement import Recording


def summary_of(measurement: Recording | MeasuredSpectrum, told: Told) -> dict[str, Any]:
    """Return what there is to say about a measurement.

    Parameters
    ----------
    measurement : Recording or MeasuredSpectrum
    told : Told
        By which it was read.

    Returns
    -------
    dict
        Members of :class:`jointplay.app.schemas.resources.MeasurementOut` that follow from the file; ``measured_at``
        is null where neither it nor its sender says that.
    """
    from jointplay.catalogue.measurements.measurement import Recording

    said = f"as said of the last file of asset {told.remembered_of} with these columns: {summarise_told(told.shown)}"
    remembered = [said] if told.remembered_of else []
    common = {
        "warnings": list(measurement.warnings),
        "import_report": [*measurement.import_report, *remembered],
        "measured_at": None if measurement.measured_at is None else measurement.measured_at.isoformat(),
    }
    channels = [
        {"name": channel.name, "unit": channel.unit, "quantity": channel.quantity} for channel in measurement.channels
    ]
    if isinstance(measurement, Recording):
        samples = len(measurement.signal)
        return {
            "kind": "recording",
            "sample_rate_hz": float(measurement.sample_rate),
            "samples": samples,
            "duration_s": samples / float(measurement.sample_rate),
            "revolutions": None if measurement.turns is None else len(measurement.turns) - 1,
            "channels": channels,
            **common,
        }
    return {
        "kind": "spectrum",
        "spectrum": {
            "lines": len(measurement.frequency),
            "resolution_hz": measurement.resolution,
            "lowest_hz": float(measurement.frequency[0]),
            "highest_hz": float(measurement.frequency[-1]),
        },
        "channels": [
            {**channel, "scaling": form.scaling, "detector": form.detector, "decibel": form.decibel}
            for channel, form in zip(channels, measurement.forms, strict=True)
        ],
        **common,
    }


def kind_of(summary: Mapping[str, Any]) -> str:
    """Return ``recording`` or ``spectrum``; of what was stored before there were spectra, nothing is said."""
    return str(summary.get("kind", "recording"))


def extent(summary: Mapping[str, Any]) -> str:
    """Return how long a recording is, or how far a spectrum reaches, in words."""
    if kind_of(summary) == "spectrum":
        held = summary["spectrum"]
        return f"spectrum, {held['lines']} lines, {held['resolution_hz']:.4g} Hz apart, to {held['highest_hz']:.6g} Hz"
    return f"{summary['duration_s']:.4g} s at {summary['sample_rate_hz']:.6g} Hz"


def channel_words(channel: Mapping[str, Any]) -> str:
    """Return what the numbers of a channel are, in words."""
    said = f"{channel['quantity']} in {channel['unit']}"
    if not channel.get("scaling"):
        return said
    scaling = {"psd": "density", "power": "power", "amplitude": "amplitude"}[channel["scaling"]]
    return f"{said}, {scaling}, {channel['detector']}{', dB' if channel['decibel'] else ''}"


def summarise_told(told: Mapping[str, Any]) -> str:
    """Return what a sender said of a file, in one line."""
    parts = []
    for name, value in told.items():
        if name == "sample_rate_hz":
            parts.append(f"sample rate {value:g} Hz")
        else:
            members = value if name == "profile" else {name: value}
            parts += [f"{member.replace('_', ' ')} {plainly(each)}" for member, each in members.items()]
    return "; ".join(parts)


def plainly(value: Any) -> str:
    """Return a JSON value as a reader writes it."""
    if isinstance(value, Mapping):
        return ", ".join(plainly(each) if name == "*" else f"{name}: {plainly(each)}" for name, each in value.items())
    if isinstance(value, list):
        return ", ".join(plainly(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
