"""Signals to spectra: alias-free samples, windows, bands of orders, sensors. Nothing here knows a model."""
