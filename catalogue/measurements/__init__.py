"""Recordings and spectra as they come: files, profiles, units, time bases, tacho pulses."""
