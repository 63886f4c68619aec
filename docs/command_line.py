"""The page of the command line, made of the commands themselves: ``python docs/command_line.py``."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path

import click

from jointplay.app.cli import main

PAGE = Path(__file__).parent / "reference" / "command-line.md"
HEAD = """# The command line

Made by `python docs/command_line.py` of what `jointplay COMMAND --help` says. How to go about it: [at the
prompt](../guide/prompt.md).
"""


def sections(command: click.Command, name: str, level: int = 2) -> Iterator[str]:
    """Yield the section of a command and those of its sub-commands."""
    context = click.Context(command, info_name=name)
    options = [each for each in command.params if isinstance(each, click.Option) and each.name != "help"]
    yield f"{'#' * level} `{name}`\n"
    yield textwrap.fill(" ".join((command.help or "").split()), 120) + "\n"
    yield f"`{' '.join([name, *command.collect_usage_pieces(context)])}`\n"
    if options:
        rows = [each.get_help_record(context) for each in options]
        yield "| option | |\n|---|---|"
        yield from (f"| `{_cell(row[0])}` | {_cell(row[1])} |" for row in rows if row is not None)
        yield ""
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            found = command.get_command(context, each)
            assert found is not None
            yield from sections(found, f"{name} {each}", level + 1)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def page() -> str:
    """Return the page as it is to be."""
    context = click.Context(main, info_name="jointplay")
    lines = [HEAD]
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert command is not None
        lines += sections(command, f"jointplay {name}")
    return "\n".join(lines).rstrip("\n") + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
