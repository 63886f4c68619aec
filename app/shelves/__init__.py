"""Catalogues and their entries, as they are offered."""
