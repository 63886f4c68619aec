"""What can be said of a file that it does not say itself: one vocabulary of fields, options and entries of the form."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileField:
    """One thing that can be said of a file: a field over HTTP and on the page, an option of commands.

    Parameters
    ----------
    name, option : str
        Of the field, and of the option.
    place : str
        In an :class:`~jointplay.catalogue.measurements.import_profile.ImportProfile`; empty for what is held beside it.
    label, says : str
        On the page; and what it is, there, in documents and in the help of commands.
    choices : tuple of str
        Values there are; empty where any text will do.
    by_column : str
        What each column is given; empty where it is said of the whole file.
    by_file : bool
        Whether each of several files has its own; what is so is a moment.
    """

    name: str
    option: str
    place: str
    label: str
    says: str
    choices: tuple[str, ...] = ()
    by_column: str = ""
    by_file: bool = False

    @property
    def of_spectrum(self) -> bool:
        """Whether it is said of spectra alone."""
        return self.place.startswith("spectrum.")


# fmt: off
FILE_FIELDS = (
    FileField("sample_rate", "sample-rate", "", "Sample rate",
              'Of a recording without times: "10 kHz", or a number in Hz.'),
    FileField("units", "unit", "", "Unit",
              'Of columns that name none: "g" for all but the time, or "t=s, *=g" by name; mm/s is a velocity, um a'
              " displacement.", by_column="UNIT"),
    FileField("full_scale", "full-scale", "full_scale", "Full scale",
              'What the full scale of a WAV file stands for: "5 g", or "1 V" with a sensitivity.'),
    FileField("sensitivity", "sensitivity", "sensitivity", "Sensitivity",
              'What a sensor gives whose column is in volts: "100 mV/g".', by_column="VOLTAGE/UNIT"),
    FileField("tacho", "tacho", "tacho.column", "Tacho column",
              "Column with pulses of the drive's shaft: they give the speed."),
    FileField("pulses_per_revolution", "pulses", "tacho.pulses_per_revolution", "Pulses per revolution",
              "Of the tacho; 1 unless given."),
    FileField("scaling", "scaling", "spectrum.scaling", "Scaling",
              "What the numbers of a spectrum are.", ("psd", "power", "amplitude")),
    FileField("detector", "detector", "spectrum.detector", "Detector",
              "Whether amplitudes of a spectrum are rms or peak.", ("rms", "peak", "peak-to-peak")),
    FileField("window", "window", "spectrum.window", "Window", "Of a spectrum of amplitudes or powers.",
              ("rectangular", "hann", "hamming", "blackman", "flattop")),
    FileField("decibel", "decibel", "spectrum.decibel", "In dB", "Whether a spectrum is in dB.", ("false", "true")),
    FileField("reference", "reference", "spectrum.reference", "Reference of dB",
              "Of levels in dB, in the unit of the column."),
    FileField("measured_at", "measured-at", "measured_at", "Measured at",
              'When it was measured, in place of what the file says: "2024-11-21T10:03:00+01:00".', by_file=True),
    FileField("time_zone", "time-zone", "time_zone", "Time zone",
              'Of times that name none: "Europe/Berlin", "+01:00"; UTC unless given.'),
)
# fmt: on
"""All that can be said of a file, besides a whole profile."""

PROFILE = "YAML or JSON that says all this, and names, delimiter and decimal comma, for files of one origin."
TOLD = frozenset({"profile", *(each.name for each in FILE_FIELDS)})
"""Fields of a form that say something of its file."""

ALL_OTHERS = "*"
"""Stands for all columns that have no text of their own."""

_ENTRIES = {each.name: (each.option, each.label) for each in FILE_FIELDS} | {
    "profile": ("profile", "Profile"),
    "mapping": ("map", "Columns and their sensors"),
    "speed": ("speed", "Drive speed"),
}


def say_cure(field: str) -> str:
    """Return where a field is given, whichever way a file came; empty for one that is not said of files.

    Parameters
    ----------
    field : str
        As refusals of readers have it.
    """
    if field not in _ENTRIES:
        return ""
    option, label = _ENTRIES[field]
    return f" (option --{option}, field {field}, in the form {label!r})"
