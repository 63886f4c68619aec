"""Models learned from a catalogue, and what they say of a recording: curves, networks, calibration, cross-checks."""
