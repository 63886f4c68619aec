"""Expressions to machine code: vector and scalar dialects, the work array, caches on disk. It knows no mechanics."""
