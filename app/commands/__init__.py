"""One module a command; heavy imports stay inside the commands that need them, so that ``--help`` is quick."""
