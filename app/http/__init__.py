"""What every request meets: gate, limits, errors, pages of lists, the document of the interface."""
