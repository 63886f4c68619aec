"""The ``jointplay`` command: its frame, and how errors leave it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

import click

from jointplay.version import __version__

COMMANDS = {
    "machines": "list the machines that ship with the program, or print one as a file",
    "check": "validate a machine; show its links, joints, degrees of freedom and a drawing",
    "simulate": "simulate time histories and spectra of the frame",
    "trade-off": "measure spectral error against cost on this computer",
    "build": "build or extend a catalogue of fault spectra",
    "verify": "check a catalogue and repair its index, or check all that a service keeps",
    "reindex": "make the index and the feature matrix of a catalogue again from its spectra",
    "regenerate": "simulate some cases of a catalogue again and compare",
    "export": "write a catalogue into one file for other programs: HDF5, NPZ or CSV",
    "diagnose": "rank the fault hypotheses of a catalogue for a measurement",
    "follow": "say how worn a machine is by all its recordings, how fast it wears, and until when",
    "watch": "send every recording that comes into a folder to a service, once",
    "evaluate": "measure the diagnoses of a catalogue on recordings it has not seen",
    "keys": "make, list and take back keys to the HTTP interface",
    "audit": "write who did what to a service, and when",
    "prune": "delete what a service keeps no longer, or say what that is",
    "backup": "copy everything a service keeps, while it works",
    "restore": "bring such a copy to where a service is to find it",
    "serve": "serve the HTTP interface and the web page",
    "sbom": "list what the installed program is made of, with licences; a bill of materials",
}


class PlainGroup(click.Group):
    """A group whose commands are imported when called and whose errors are one plain line on stderr."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of use."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command's module and return the command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"jointplay.app.commands.{cmd_name.replace('-', '_')}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that was asked for; a refusal names the one that was likely meant, as that of options."""
        from difflib import get_close_matches

        if args[0] not in COMMANDS and (near := get_close_matches(args[0], COMMANDS, 1)):
            ctx.fail(f"No such command {args[0]!r}. Did you mean {near[0]!r}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command; every failure becomes one line on stderr and an exit status."""
        kwargs["standalone_mode"] = False
        status = run(lambda: super(PlainGroup, self).main(*args, **kwargs))
        sys.exit(status)


def run(call: Callable[[], Any]) -> int:
    """Call a command and return the exit status: 0, 2 for bad input, 1 for a failure, 130 for Ctrl-C."""
    try:
        outcome = call()
        sys.stdout.flush()
        return outcome if isinstance(outcome, int) else 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except (click.Abort, KeyboardInterrupt):
        complain("interrupted")
        return 130
    except click.exceptions.NoArgsIsHelpError as help_wanted:
        click.echo(help_wanted.ctx.get_help(), err=True)
        return 2
    except click.ClickException as error:
        complain(error.format_message())
        return 2
    except BrokenPipeError:
        # The reader of our output has gone (`jointplay machines | head`): nothing is left to say, and nowhere to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        named = f"{error.filename}: " if error.filename else ""
        complain(f"{named}{error.strerror or error}")
        return (
            2 if isinstance(error, (FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)) else 1
        )
    except Exception as error:
        return explain(error)


def explain(error: Exception) -> int:
    """Print an exception as one line and return its exit status; one that nobody foresaw is named as such."""
    from jointplay.app.problems import exit_status, kind_of, say

    if kind_of(error) is None:
        if os.environ.get("JOINTPLAY_DEBUG"):
            raise error
        complain(f"unexpected {type(error).__name__}: {error} (JOINTPLAY_DEBUG=1 shows where)")
        return 1
    complain(say(error))
    return exit_status(error)


def complain(message: str) -> None:
    """Write one plain line to stderr."""
    click.echo(f"jointplay: {' '.join(message.split())}", err=True)


def version() -> str:
    """Return the version of the product."""
    return __version__


def show_version(ctx: click.Context, _option: click.Parameter, wanted: bool) -> None:
    """Print the version and stop."""
    if wanted and not ctx.resilient_parsing:
        click.echo(f"jointplay {version()}")
        ctx.exit()


@click.group(cls=PlainGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=show_version, help="Show the version."
)
def main() -> None:
    """Find out which joints of a machine have play, and how much, from the vibration of its frame."""


if __name__ == "__main__":
    main()
