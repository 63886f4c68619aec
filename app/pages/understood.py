"""What the page shows of a recording before it is diagnosed: facts, columns with their sensors, the drive speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jointplay.app.jobs.summaries import channel_words, kind_of, summarise_told
from jointplay.app.pages.page_forms import NOT_USED
from jointplay.app.rows import micrometres
from jointplay.app.shelves.catalogues import Offer
from jointplay.app.storage.rows import MeasurementRow
from jointplay.app.words import SOURCES, spell_moment
from jointplay.catalogue.signals.sensors import match_by_name


def confirmation(
    measurement: MeasurementRow,
    offer: Offer,
    found: Mapping[str, Any],
    given: Mapping[str, str],
    remembered: Mapping[str, str],
) -> dict[str, Any]:
    """Return the members that the page of confirmation shows.

    Parameters
    ----------
    measurement : MeasurementRow
        The recording.
    offer : Offer
        The catalogue it is to be compared with.
    found : Mapping
        What :func:`jointplay.app.pages.understanding.understand` returned.
    given : Mapping
        Fields that somebody filled in already; they stay.
    remembered : Mapping
        Column to sensor by what was confirmed for the asset's last recording with the same columns.
    """
    summary = measurement.summary
    names = [channel["name"] for channel in summary["channels"]]
    by_name = {**match_by_name(names, offer.machine), **remembered}
    estimated = "" if found["speed_rpm"] is None else f"{found['speed_rpm']:.6g}"
    return {
        "measurement": measurement.id,
        "name": measurement.name,
        "catalogue": offer.description,
        "facts": [
            ("Machine", f"{offer.description.machine}, {offer.description.entries} cases in {offer.description.name}"),
            *extents(summary),
            ("Measured", f"{spell_moment(measurement.measured_at)} UTC, {SOURCES[measurement.measured_at_source]}"),
            *((("Virtual", virtual_text(summary["virtual"])),) if summary.get("virtual") else ()),
            *((("You said", summarise_told(measurement.told.shown)),) if measurement.told.shown else ()),
        ],
        "columns": [
            {
                "name": channel["name"],
                "words": channel_words(channel),
                "field": f"sensor-{index}",
                "chosen": given.get(f"sensor-{index}", by_name.get(channel["name"]) or NOT_USED),
            }
            for index, channel in enumerate(summary["channels"])
        ],
        "remembered": given.get("asset") if remembered else "",
        "sensors": [sensor.name for sensor in offer.machine.sensors],
        "not_used": NOT_USED,
        "estimated": estimated,
        "speed": given.get("speed", estimated),
        "speed_hint": speed_hint(found, offer, kind_of(summary)),
        "warnings": list(dict.fromkeys([*summary["warnings"], *found["warnings"]])),
        "report": summary["import_report"],
    }


def virtual_text(truth: Mapping[str, Any]) -> str:
    """Return what a simulated recording was made with."""
    joints = ", ".join(f"{joint} {micrometres(size)} µm" for joint, size in truth["clearances_um"].items() if size)
    noise = f"noise {truth['sensor_noise_m_s2']:g} m/s²"
    return f"simulated, not measured: {joints or 'no play'}; {truth['drive_speed_rpm']:.5g} rpm; {noise}"


def extents(summary: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return how long a recording is, or how far and how finely a spectrum reaches."""
    if kind_of(summary) == "spectrum":
        held = summary["spectrum"]
        return (
            ("Spectrum", f"{held['lowest_hz']:.6g} to {held['highest_hz']:.6g} Hz"),
            ("Resolution", f"{held['resolution_hz']:.4g} Hz, {held['lines']} lines"),
        )
    return (
        ("Length", f"{summary['duration_s']:.4g} s, {summary['samples']} samples"),
        ("Sample rate", f"{summary['sample_rate_hz']:.6g} Hz"),
    )


def speed_hint(found: Mapping[str, Any], offer: Offer, kind: str) -> str:
    """Return where the drive speed comes from, in a sentence."""
    nominal = offer.description.nominal_speed_rpm
    usual = f" The machine's own is {nominal:.4g} rpm." if nominal is not None else ""
    if found["field"] == "mapping":
        return f"It is looked for in the columns whose sensors are said above.{usual}"
    if found["speed_rpm"] is None:
        return f"It was not found in the {kind}: write it here, unless this is one of another machine.{usual}"
    source = "By the pulses of the tacho" if found["tacho"] else f"Found in the {kind}"
    return (
        f"{source}: {found['speed_rpm']:.6g} ± {found['uncertainty_rpm']:.2g} rpm (standard uncertainty)."
        f" Write another one if you know better.{usual}"
    )
