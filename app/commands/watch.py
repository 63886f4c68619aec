"""``jointplay watch``: send every recording that comes into a folder to a service, once."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

import click

from jointplay.app.commands.parameters import QuantityOption, each_once, file_options, json_option
from jointplay.app.commands.watch_journal import Entry, Journal, claim
from jointplay.app.commands.watch_sending import (
    Destination,
    FailedError,
    NotNowError,
    RefusedError,
    WrongRequestError,
)
from jointplay.app.errors import RefusedFilesError
from jointplay.app.fields import FILE_FIELDS

KEY = "JOINTPLAY_KEY"
LOOK_S = 1.0
LONGEST_PAUSE_S = 60.0
TRIES = 3
"""How often a file is sent at which the service fails."""

UNENDED = 10.0
"""How much longer a text is waited for that does not end with a line: it is probably still being written."""

TEXTS = (".csv", ".tsv", ".txt", ".lvm", ".asc", ".dat")
ASIDE = (".tmp", ".part", ".partial", ".filepart", ".crdownload", ".yaml", ".yml")
"""Endings of files under way, and of profiles."""


@click.command("watch")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False), metavar="DIR")
@click.option("--server", required=True, metavar="URL", help=f"Of the service; its key is in the environment: {KEY}.")
@click.option("--catalogue", metavar="NAME", help="Of the service: each recording is diagnosed by it; else only kept.")
@click.option("--asset", metavar="ID", help="The machine that was measured, if it is one of the service's assets.")
@click.option(
    "--effort",
    type=click.Choice(["fast", "standard", "thorough"]),
    help="How much to compute for each recording, with --catalogue.  [default: the service's]",
)
@click.option(
    "--quiet",
    type=QuantityOption("TIME"),
    default="5 s",
    show_default=True,
    help="How long a file must not have changed before it is sent.",
)
@click.option("--once", is_flag=True, help="End when everything that lies there is sent or refused.")
@file_options
@json_option
def command(
    folder: Path,
    server: str,
    catalogue: str | None,
    asset: str | None,
    effort: str | None,
    quiet: float,
    once: bool,
    as_json: bool,
    **told: Any,
) -> None:
    """Send every recording that lies in DIR, or comes into it, to a service, once.

    A file is sent when it has not changed for a while; one that is refused is tried again when it has changed. The
    folder keeps a journal, so that the same command goes on after any end.
    """
    if effort and not catalogue:
        raise click.BadParameter(f"{effort}: needs --catalogue", param_hint="'--effort'")
    asked = (("catalogue", catalogue), ("asset", asset), ("effort", effort))
    fields = {name: value for name, value in asked if value}
    destination = Destination(address_of(server), {**fields, **said_of_files(told)}, os.environ.get(KEY, ""))
    with claim(folder):
        watcher = Watcher(folder, destination, quiet, as_json)
        try:
            watcher.run(once=once)
        except KeyboardInterrupt:
            click.echo(f"jointplay: {watcher.sent} sent; the same command goes on", err=True)
            raise
        except WrongRequestError as error:
            raise click.UsageError(str(error)) from None
    if once and watcher.refused:
        raise RefusedFilesError(f"{folder}: {watcher.refused} files were refused")


# When a recording was made is said of one file, not of all that come.
command.params = [
    each for each in command.params if each.name not in {each.name for each in FILE_FIELDS if each.by_file}
]


def address_of(server: str) -> str:
    """Return the URL of a service without a path.

    Raises
    ------
    click.BadParameter
    """
    try:
        parts = urlsplit(server)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0 and not parts.username
    except ValueError:
        usable = False
    if not usable or parts.path.strip("/") or parts.query or parts.fragment:
        raise click.BadParameter(f"{server}: must be as http://host:8000 or https://host", param_hint="'--server'")
    return f"{parts.scheme}://{parts.netloc}"


def said_of_files(told: Mapping[str, Any]) -> dict[str, str]:
    """Return fields of a form for what options say of all files."""
    fields = {}
    for each in FILE_FIELDS:
        value = told.get(each.name)
        if value in (None, ()):
            continue
        fields[each.name] = json.dumps(each_once(value, f"--{each.option}")) if each.by_column else str(value)
    return fields


class Watcher:
    """Looks at a folder again and again, and sends what is whole.

    Parameters
    ----------
    folder : Path
        Claimed by this process.
    destination : Destination
    quiet : float
        Seconds.
    as_json : bool
        Whether a line is said as JSON.
    """

    def __init__(self, folder: Path, destination: Destination, quiet: float, as_json: bool = False) -> None:
        self._folder, self._destination, self._quiet, self._as_json = folder, destination, quiet, as_json
        self._journal = Journal(folder, json.dumps([destination.server, dict(sorted(destination.fields.items()))]))
        self._seen: dict[str, tuple[tuple[int, int], float]] = {}
        self._failures: dict[str, int] = {}
        self._waiting = ""
        self.sent = self.refused = 0

    def run(self, *, once: bool) -> None:
        """Look until nothing is left to do, or for ever.

        Raises
        ------
        WrongRequestError
            The service takes no file asked for so.
        """
        pause = LOOK_S
        while True:
            try:
                left = self._look()
                self._waiting, pause = "", min(LOOK_S, self._quiet)
            except NotNowError as error:
                if str(error) != self._waiting:
                    click.echo(f"jointplay: {error}; trying again", err=True)
                self._waiting, left, pause = str(error), True, min(2.0 * max(pause, LOOK_S), LONGEST_PAUSE_S)
            if once and not left:
                return
            time.sleep(pause)

    def _look(self) -> bool:
        """Send what is whole; return whether anything is left."""
        left = False
        for path, size, mtime_ns in self._files():
            if self._journal.is_settled(path.name, size, mtime_ns):
                continue
            left = True
            state, now = (size, mtime_ns), time.monotonic()
            before, since = self._seen.get(path.name, (None, now))
            if state != before:
                self._seen[path.name] = (state, now)
                since = now
            if now - since < self._quiet:
                continue
            try:
                content = path.read_bytes()
                after = path.stat()
            except OSError:  # gone, or held by whoever writes it
                continue
            if (after.st_size, after.st_mtime_ns) != state or len(content) != size:
                continue
            unended = path.suffix.lower() in TEXTS and not content.endswith((b"\n", b"\r"))
            if unended and now - since < UNENDED * self._quiet:
                continue
            digest = hashlib.sha256(content).hexdigest()
            self._take(Entry(self._journal.to, path.name, size, mtime_ns, digest, "sending", path.name), content)
        return left

    def _files(self) -> Iterator[tuple[Path, int, int]]:
        """Recordings with size and time of change, by name; none of those that are plainly something else."""
        for path in sorted(self._folder.iterdir()):
            if path.name.startswith(".") or path.suffix.lower() in ASIDE:
                continue
            try:
                if path.is_file():
                    found = path.stat()
                    yield path, found.st_size, found.st_mtime_ns
            except OSError:
                continue

    def _take(self, entry: Entry, content: bytes) -> None:
        """Send a file, or note why that is not needed."""
        known = self._journal.content(entry.sha256)
        if known is not None and known.state != "sending":
            what = "refused" if known.state == "refused" else "sent"
            self._note(replace(entry, state=known.state, name=known.name, said=known.said), f"{what} as {known.name}")
            return
        if known is not None:  # its answer was lost: the very same is asked for once more
            entry = replace(entry, name=known.name)
        before = self._journal.last(entry.file)
        self._journal.add(entry)
        try:
            answer = self._destination.send(entry.name, content, token_of(entry))
        except RefusedError as error:
            self._refuse(entry, str(error))
        except FailedError as error:
            tried = self._failures[entry.sha256] = self._failures.get(entry.sha256, 0) + 1
            if tried >= TRIES:
                self._refuse(entry, f"failed {tried} times: {error}")
        else:
            self.sent += 1
            said = summary(answer)
            if before is not None and is_beginning(before, content):
                said += f"; what it held at first was sent, too: delete {before.said}"
            self._note(replace(entry, state="sent", said=answer["id"]), said)

    def _refuse(self, entry: Entry, why: str) -> None:
        self.refused += 1
        self._note(replace(entry, state="refused", said=why), f"refused: {why}")

    def _note(self, entry: Entry, said: str) -> None:
        self._journal.add(entry)
        state: Literal["sending", "sent", "refused"] = entry.state
        shown = {"file": entry.file, "sha256": entry.sha256, "state": state, "name": entry.name, "said": entry.said}
        click.echo(json.dumps(shown) if self._as_json else f"{entry.file}: {said}")


def is_beginning(before: Entry, content: bytes) -> bool:
    """Return whether what was sent of a file is how its content begins: its writer had paused for long."""
    if before.state != "sent" or before.size >= len(content):
        return False
    return hashlib.sha256(content[: before.size]).hexdigest() == before.sha256


def token_of(entry: Entry) -> str:
    """Return the key of idempotency: the same for the same content, asked for in the same way."""
    return f"watch-{hashlib.sha256(f'{entry.to} {entry.sha256} {entry.name}'.encode()).hexdigest()}"


def summary(answer: Mapping[str, Any]) -> str:
    """Return what a service made of a file, in short."""
    if "verdict" not in answer:
        return f"recording {answer['id']}"
    from jointplay.app.rows import percent

    first = answer["hypotheses"][0]
    joints = "+".join(first["joints"]) or "none worn"
    verdict = str(answer["verdict"]).replace("_", " ")
    # Without a verdict on joints none of them is named.
    said = f" ({joints}, {percent(first['probability'])})" if answer["verdict"] in ("worn", "in_order") else ""
    return f"{verdict}{said}: diagnosis {answer['id']}"
