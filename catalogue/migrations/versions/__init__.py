"""One module a revision, named by what it does and its number."""
