"""Cases to results: histories, ensembles and their spectra, what accuracy costs."""
