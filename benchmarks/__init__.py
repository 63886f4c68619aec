"""Measurements of cost and accuracy, beside other programs on the same machines: ``python -m benchmarks``."""
