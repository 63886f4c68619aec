"""Drawings, plots and files that commands and pages write."""
