"""``python -m benchmarks.watching``: drop files into a watched folder, kill the watcher twice, count the recordings.

Some files are half there at first and are finished later, some contents come twice under two names. The watcher is
killed with SIGKILL at two moments and started again; a service on this computer takes what it sends. In the end there
has to be one recording of each content, none lost, none doubled.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

JOINTPLAY = (sys.executable, "-m", "jointplay.app.cli")
QUIET_S = 1.0


@dataclass(frozen=True)
class Outcome:
    """What became of the files.

    Parameters
    ----------
    files, contents : int
        Dropped; different ones among their contents.
    recordings : int
        That the service has.
    lost, doubled : int
        Contents that it has not, or more than once.
    foreign : int
        Recordings of contents that nobody finished: halves.
    seconds : float
        From the first file to the end of the last watcher.
    """

    files: int
    contents: int
    recordings: int
    lost: int
    doubled: int
    foreign: int
    seconds: float


def recording(number: int) -> bytes:
    """Return a recording of a tenth of a second by one sensor, another one for every number."""
    draws = random.Random(number)
    rows = [f"{k / 2560:.9f},{draws.gauss(0.0, 1.0):.6f}" for k in range(300)]
    return "\n".join(["time [s],s1-y [m/s2]", *rows, ""]).encode()


@contextmanager
def service(folder: Path) -> Iterator[str]:
    """Serve an empty installation; gives its address."""
    (folder / "catalogues").mkdir()
    command = [*JOINTPLAY, "serve", "--no-keys", "--port", "0"]
    command += ["--catalogues", str(folder / "catalogues"), "--data", str(folder / "data")]
    with (
        open(folder / "service.log", "w+", encoding="utf-8") as log,
        subprocess.Popen(command, stderr=log) as process,
    ):
        try:
            while not (found := re.search(r"serving (http://\S+)", Path(log.name).read_text(encoding="utf-8"))):
                if process.poll() is not None:
                    raise RuntimeError(f"the service ended with {process.returncode}")
                time.sleep(0.1)
            yield found[1]
        finally:
            process.terminate()


def recordings(server: str) -> list[str]:
    """Return the SHA-256 of every recording that a service has."""
    found: list[str] = []
    cursor = ""
    while True:
        with urllib.request.urlopen(f"{server}/api/v1/measurements?limit=200{cursor}") as answer:
            page = json.load(answer)
        found += [item["sha256"] for item in page["items"]]
        if not page["next_cursor"]:
            return found
        cursor = f"&cursor={page['next_cursor']}"


def drop(server: str, folder: Path, count: int, halves: int, twice: int, kills: int) -> Outcome:
    """Drop files into a folder that is watched, and kill the watcher while it works.

    Parameters
    ----------
    server : str
    folder : Path
        Empty.
    count : int
        Different recordings.
    halves, twice : int
        Of them: cut within a line at first; there under a second name, too.
    kills : int
    """
    contents = {f"rec-{number:04d}.csv": recording(number) for number in range(count)}
    copies = {f"copy-{number:04d}.csv": recording(number) for number in range(twice)}
    wanted = Counter(hashlib.sha256(content).hexdigest() for content in contents.values())
    command = [*JOINTPLAY, "watch", str(folder), "--server", server, "--quiet", f"{QUIET_S} s", "--once"]
    begin = time.monotonic()
    unfinished = list(contents)[-halves:] if halves else []
    for name, content in {**contents, **copies}.items():
        (folder / name).write_bytes(content[: len(content) // 2 - 3] if name in unfinished else content)
    for turn in range(kills):
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as watcher:
            assert watcher.stdout is not None
            for _ in range(max(1, (count - halves) // (kills + 1))):
                watcher.stdout.readline()
            watcher.kill()
        if turn == 0:
            for name in unfinished:
                with open(folder / name, "ab") as file:
                    file.write(contents[name][len(contents[name]) // 2 - 3 :])
    ended = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    if ended.returncode:
        raise RuntimeError(f"the watcher ended with {ended.returncode}")
    took = time.monotonic() - begin
    found = Counter(recordings(server))
    return Outcome(
        files=len(contents) + len(copies),
        contents=len(wanted),
        recordings=found.total(),
        lost=len(wanted.keys() - found.keys()),
        doubled=sum(number - 1 for number in found.values()),
        foreign=len(found.keys() - wanted.keys()),
        seconds=took,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--halves", type=int, default=100)
    parser.add_argument("--twice", type=int, default=50)
    parser.add_argument("--kills", type=int, default=2)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        watched = Path(folder, "watched")
        watched.mkdir()
        with service(Path(folder)) as server:
            found = drop(server, watched, asked.count, asked.halves, asked.twice, asked.kills)
    print(
        f"{found.files} files of {found.contents} contents, {asked.halves} half-written at first, {asked.kills} kills:"
        f" {found.recordings} recordings, {found.lost} lost, {found.doubled} doubled, {found.foreign} of halves;"
        f" {found.seconds:.0f} s"
    )
    raise SystemExit(bool(found.lost or found.doubled or found.foreign))


if __name__ == "__main__":
    main()
