"""`jointplay watch`: what lies in a folder reaches the service once, whatever happens in between."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from command_line import JOINTPLAY, assert_refused, invoke
from filelock import FileLock
from http_answers import send
from small_service import serving, spoiled

from benchmarks.watching import drop, recording, recordings
from jointplay.app.commands import watch
from jointplay.app.commands.watch import Watcher
from jointplay.app.commands.watch_journal import JOURNAL, LOCK
from jointplay.app.commands.watch_sending import (
    Destination,
    FailedError,
    NotNowError,
    RefusedError,
    WrongRequestError,
    judge,
)
from jointplay.app.settings import ServiceSettings

NONE = Destination("http://127.0.0.1:1", {})


@pytest.fixture
def empty(tmp_path: Path) -> Iterator[str]:
    """Address of a service that has nothing yet."""
    (tmp_path / "catalogues").mkdir()
    with serving(ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", workers=1)) as address:
        yield address


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    found = tmp_path / "watched"
    found.mkdir()
    return found


class Told:
    """A destination that does as it is told, and remembers what it got."""

    def __init__(self, *outcomes: Exception | None) -> None:
        self.outcomes = list(outcomes)
        self.got: list[tuple[str, bytes, str]] = []

    def send(self, _destination: Destination, name: str, content: bytes, token: str) -> dict[str, Any]:
        self.got.append((name, content, token))
        outcome = self.outcomes.pop(0) if self.outcomes else None
        if outcome is not None:
            raise outcome
        return {"id": f"id-{len(self.got)}"}


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Told]:
    monkeypatch.setattr(watch, "LOOK_S", 0.01)

    def make(*outcomes: Exception | None) -> Told:
        made = Told(*outcomes)
        monkeypatch.setattr(Destination, "send", lambda *given: made.send(*given))
        return made

    return make


def watched(folder: Path, quiet: float = 0.02) -> Watcher:
    watcher = Watcher(folder, NONE, quiet)
    watcher.run(once=True)
    return watcher


def journal(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / JOURNAL).read_text().splitlines() if line]


@pytest.mark.long
def test_nothing_is_lost_or_doubled_though_the_watcher_is_killed_twice(empty: str, folder: Path) -> None:
    found = drop(empty, folder, count=30, halves=6, twice=4, kills=2)
    assert (found.files, found.recordings, found.lost, found.doubled, found.foreign) == (34, 30, 0, 0, 0)
    again = invoke("watch", folder, "--server", empty, "--quiet", "0.02 s", "--once")
    assert (again.exit_code, again.stdout) == (0, ""), "all of it is known"


def test_each_recording_is_diagnosed_once_and_kept_with_its_asset(
    client: httpx.Client, server: str, worn: bytes, folder: Path
) -> None:
    client.put("/api/v1/assets/watched-1", json={"machine": "slider-crank"}).raise_for_status()
    (folder / "monday.csv").write_bytes(worn)
    (folder / "bad.csv").write_bytes(spoiled(worn, "infinite"))
    (folder / ".hidden.csv").write_bytes(worn)
    (folder / "tuesday.csv.part").write_bytes(worn[:1000])
    asked = ("watch", folder, "--server", server, "--quiet", "0.02 s", "--once", "--catalogue", "slider-crank")
    result = invoke(*asked, "--asset", "watched-1")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1] == f"jointplay: {folder}: 1 files were refused"
    good, bad = result.stdout.splitlines()  # the bad one does not end with a line, and is waited for
    assert bad.startswith("bad.csv: refused: ")
    assert "line 301" in bad
    assert good.startswith("monday.csv: worn (B, ")
    (item,) = client.get("/api/v1/diagnoses", params={"asset": "watched-1"}).json()["items"]
    assert good.endswith(f"diagnosis {item['id']}")
    (folder / JOURNAL).unlink()  # what is sent again within a day gets the same answer, and creates nothing
    assert item["id"] in invoke(*asked, "--asset", "watched-1", "--json").stdout
    assert len(client.get("/api/v1/diagnoses", params={"asset": "watched-1"}).json()["items"]) == 1


def test_options_say_of_all_files_what_they_do_not_say(empty: str, folder: Path) -> None:
    bare = recording(1).decode().replace("time [s],s1-y [m/s2]", "time,s1-y")
    (folder / "bare.csv").write_text(bare)
    assert "unit" in invoke("watch", folder, "--server", empty, "--quiet", "0.02 s", "--once").stdout
    told = ("--unit", "time=s", "--unit", "*=g", "--time-zone", "Europe/Berlin")
    result = invoke("watch", folder, "--server", empty, "--quiet", "0.02 s", "--once", *told)
    assert result.exit_code == 0, result.stderr
    assert len(recordings(empty)) == 1
    assert "--measured-at" not in invoke("watch", "--help").stdout


def test_a_file_that_is_refused_is_said_once_and_tried_again_when_it_has_grown(
    folder: Path, told: Callable[..., Told], capsys: pytest.CaptureFixture[str]
) -> None:
    got = told(RefusedError("too short"))
    (folder / "a.csv").write_bytes(b"half\n")
    assert watched(folder).refused == 1
    assert watched(folder).refused == 0
    assert capsys.readouterr().out == "a.csv: refused: too short\n"
    with open(folder / "a.csv", "ab") as file:
        file.write(b"whole\n")
    assert watched(folder).sent == 1
    assert [content for _, content, _ in got.got] == [b"half\n", b"half\nwhole\n"]
    assert [entry["state"] for entry in journal(folder)] == ["sending", "refused", "sending", "sent"]


@pytest.fixture
def passing(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """A clock of the watcher's own, and how to let time pass on it."""
    moment = [0.0]

    def wait(seconds: float) -> None:
        moment[0] += seconds

    monkeypatch.setattr(watch, "time", SimpleNamespace(**{**vars(time), "monotonic": lambda: moment[0], "sleep": wait}))
    return wait


def test_a_file_is_left_alone_while_it_changes(
    folder: Path, told: Callable[..., Told], passing: Callable[[float], None]
) -> None:
    got, watcher = told(), Watcher(folder, NONE, 5.0)
    (folder / "a.csv").write_bytes(b"1\n")
    assert watcher._look()  # seen for the first time
    passing(4.0)
    (folder / "a.csv").write_bytes(b"1\n2\n")
    assert watcher._look()  # changed since
    passing(4.0)
    assert watcher._look()
    assert not got.got
    passing(1.0)
    watcher._look()
    assert [content for _, content, _ in got.got] == [b"1\n2\n"]


def test_a_text_that_does_not_end_with_a_line_is_waited_for_longer(
    folder: Path, told: Callable[..., Told], passing: Callable[[float], None]
) -> None:
    got, watcher = told(), Watcher(folder, NONE, 5.0)
    (folder / "a.csv").write_bytes(b"1\n2")
    (folder / "b.wav").write_bytes(b"RIFF")
    watcher._look()
    passing(5.0 * watch.UNENDED - 1.0)
    watcher._look()
    assert [name for name, _, _ in got.got] == ["b.wav"]
    watcher.run(once=True)
    assert [name for name, _, _ in got.got] == ["b.wav", "a.csv"]


def test_a_writer_that_paused_for_long_is_told_what_its_half_became(
    folder: Path, told: Callable[..., Told], capsys: pytest.CaptureFixture[str]
) -> None:
    got = told()
    (folder / "a.csv").write_bytes(b"1\n")
    assert watched(folder).sent == 1
    (half,) = (entry["said"] for entry in journal(folder) if entry["state"] == "sent")
    capsys.readouterr()
    (folder / "a.csv").write_bytes(b"1\n2\n")
    assert watched(folder).sent == 1
    assert f"; what it held at first was sent, too: delete {half}\n" in capsys.readouterr().out
    (folder / "a.csv").write_bytes(b"other\n")
    assert watched(folder).sent == 1
    assert "at first" not in capsys.readouterr().out
    assert [content for _, content, _ in got.got] == [b"1\n", b"1\n2\n", b"other\n"]


def test_the_same_content_under_two_names_is_sent_once(
    folder: Path, told: Callable[..., Told], capsys: pytest.CaptureFixture[str]
) -> None:
    got = told()
    (folder / "a.csv").write_bytes(b"1\n")
    (folder / "b.csv").write_bytes(b"1\n")
    assert watched(folder).sent == 1
    assert [name for name, _, _ in got.got] == ["a.csv"]
    assert capsys.readouterr().out == "a.csv: recording id-1\nb.csv: sent as a.csv\n"


def test_an_answer_that_was_lost_is_asked_for_again_by_the_same_name_and_key(
    folder: Path, told: Callable[..., Told]
) -> None:
    got = told(KeyboardInterrupt())
    (folder / "a.csv").write_bytes(b"1\n")
    with pytest.raises(KeyboardInterrupt):
        watched(folder)
    (folder / "a.csv").rename(folder / "b.csv")
    with open(folder / JOURNAL, "a") as file:
        file.write('{"to": "cut')
    watched(folder)
    assert got.got[0] == got.got[1]
    assert [entry["file"] for entry in journal_of_whole_lines(folder)] == ["a.csv", "b.csv", "b.csv"]


def journal_of_whole_lines(folder: Path) -> list[dict[str, Any]]:
    lines = (folder / JOURNAL).read_text().splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def test_a_service_that_cannot_now_is_asked_again_and_one_that_fails_three_times(
    folder: Path, told: Callable[..., Told], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []
    # Of the watcher alone: servers that run in threads of this process sleep, too.
    monkeypatch.setattr(watch, "time", SimpleNamespace(**{**vars(time), "sleep": pauses.append}))
    failed = FailedError("a worker died")
    got = told(NotNowError("all busy"), NotNowError("all busy"), failed, failed, failed)
    (folder / "a.csv").write_bytes(b"1\n")
    watcher = watched(folder, 1e-6)
    assert (watcher.sent, watcher.refused, len(got.got)) == (0, 1, 5)
    printed = capsys.readouterr()
    assert printed.err == "jointplay: all busy; trying again\n", "said once"
    assert printed.out == "a.csv: refused: failed 3 times: a worker died\n"
    assert pauses[1:3] == [0.02, 0.04]


def test_another_destination_gets_everything(folder: Path, told: Callable[..., Told]) -> None:
    got = told()
    (folder / "a.csv").write_bytes(b"1\n")
    watched(folder)
    Watcher(folder, Destination(NONE.server, {"asset": "press-7"}), 0.02).run(once=True)
    assert len({token for _, _, token in got.got}) == 2


@pytest.mark.parametrize(
    ("status", "document", "kind"),
    [
        (422, {"detail": "x", "errors": [{"field": "file"}]}, RefusedError),
        (422, {"detail": "x", "errors": [{"field": "asset"}]}, WrongRequestError),
        (413, {"detail": "x"}, RefusedError),
        (409, {"type": "urn:jointplay:problem:idempotency-key-in-use", "detail": "x"}, NotNowError),
        (503, {"detail": "x"}, NotNowError),
        (429, {"detail": "x"}, NotNowError),
        (401, {"detail": "x"}, WrongRequestError),
        (307, {"detail": "x"}, WrongRequestError),
        (500, {"detail": "x"}, FailedError),
        (504, {"detail": "x"}, FailedError),
        (200, [], WrongRequestError),
    ],
)
def test_what_a_status_means(status: int, document: object, kind: type[Exception]) -> None:
    with pytest.raises(kind):
        judge(status, json.dumps(document).encode())


@pytest.mark.parametrize(("effort", "kind"), [("thorough", NotNowError), ("standard", FailedError)])
def test_an_answer_of_effort_thorough_is_waited_for(
    effort: str, kind: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = SimpleNamespace(status=504, read=lambda: b'{"detail": "96 of 9984 cases are simulated"}')
    slow = SimpleNamespace(request=lambda *_: None, getresponse=lambda: answer, close=lambda: None)
    destination = Destination("http://x", {"catalogue": "c", "effort": effort})
    monkeypatch.setattr(Destination, "_connection", lambda _: slow)
    with pytest.raises(kind, match="96 of 9984 cases"):
        destination.send("a.csv", b"", "token")


def test_an_effort_needs_a_catalogue(folder: Path) -> None:
    refused = invoke("watch", folder, "--server", "http://x", "--effort", "thorough")
    assert_refused(refused, 2, "'--effort': thorough: needs --catalogue")


def test_one_watcher_a_folder(folder: Path) -> None:
    with FileLock(folder / LOCK):
        assert_refused(invoke("watch", folder, "--server", "http://x"), 1, "is being watched by another process")


@pytest.mark.parametrize("server", ["x", "ftp://x", "http://", "http://x/api", "http://u:p@x", "http://x:0"])
def test_an_address_that_is_none_is_refused(server: str, folder: Path) -> None:
    assert_refused(invoke("watch", folder, "--server", server), 2, f"{server}: must be as http://host:8000")


def test_a_wrong_request_ends_it(server: str, folder: Path, worn: bytes, client: httpx.Client) -> None:
    (folder / "a.csv").write_bytes(worn)
    asked = ("watch", folder, "--server", server, "--quiet", "0.02 s")
    assert_refused(invoke(*asked, "--catalogue", "none"), 2, "catalogue: none: there is none")
    assert_refused(invoke(*asked, "--asset", "nobody"), 2, "nobody")
    assert send(client, worn, "a.csv").status_code == 201


def test_ctrl_c_says_that_the_same_command_goes_on(ctrl_c: None, empty: str, folder: Path) -> None:
    command = [*JOINTPLAY, "watch", str(folder), "--server", empty, "--quiet", "0.02 s"]
    (folder / "a.csv").write_bytes(recording(1))
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, env={**os.environ}, **pipes) as process:  # type: ignore[call-overload]
        assert process.stdout.readline().startswith("a.csv: recording ")
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()
    assert process.returncode == 130
    assert "jointplay: 1 sent; the same command goes on" in said
