"""The report of a diagnosis, one page for the work order: what it says, its figures, HTML and PDF."""
