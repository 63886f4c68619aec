"""Catalogues of simulated vibration spectra: planning, building, storing and comparing them with measurements."""
