"""Reading in a capped process: this side of it. One process waits a caller; it is started when first needed."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.kinds import FileKind
from jointplay.catalogue.measurements.readers.raw import Limits, RawRecording, decode
from jointplay.catalogue.processes import ONE_THREAD

#: Waited longer than a file may take before the whole process is given up [s].
_GRACE = 10.0
#: What a file and its numbers pass through: with the usual 64 kB the two processes would take turns all the time.
_PIPE_BYTES = 1 << 20


class Cell:
    """A process that reads files one after the other, each in a child of its own."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._lock = threading.Lock()

    def read(
        self, kind: FileKind, data: bytes, source: str, limits: Limits, table: Mapping[str, Any] | None = None
    ) -> RawRecording:
        """Read a file.

        Parameters
        ----------
        kind : FileKind
        data : bytes
            Plain or gzipped.
        source : str
            What messages call it.
        limits : Limits
        table : mapping, optional
            Further arguments of its reader.

        Raises
        ------
        MeasurementError
            The file cannot be read: what the reader says of it, or that it took too much memory or time, or crashed.
        """
        request = {"kind": kind.name, "source": source, "limits": asdict(limits), "bytes": len(data)}
        request["table"] = dict(table or {})
        with self._lock:
            process = self._running()
            assert process.stdin is not None and process.stdout is not None
            guard = threading.Timer(limits.reader_clock_seconds + _GRACE, self._kill, [process])
            guard.start()
            try:
                process.stdin.write(json.dumps(request).encode() + b"\n")
                process.stdin.write(data)
                process.stdin.flush()
                head = json.loads(process.stdout.readline())
                body = process.stdout.read(head["bytes"])
            except (OSError, ValueError):
                self.close()
                self._refuse_slow(kind, -process.returncode, source, limits)
                raise MeasurementError(source, rule=f"{kind.name} file: its reader ended early") from None
            finally:
                guard.cancel()
        return self._judged(kind, head, body, source, limits)

    def _judged(self, kind: FileKind, head: dict[str, Any], body: bytes, source: str, limits: Limits) -> RawRecording:
        ended = head["signal"]
        self._refuse_slow(kind, ended, source, limits)
        if ended:
            name = signal.Signals(ended).name
            raise MeasurementError(source, rule=f"{kind.name} file: is damaged: its reader was ended by {name}")
        end = max(body.find(b"\n"), 0)
        try:
            answer = json.loads(body[:end])
        except ValueError:
            raise MeasurementError(source, rule=f"{kind.name} file: its reader gave no answer") from None
        if "error" in answer:
            *said, field = answer["error"]
            raise MeasurementError(source, *said, field=field)
        return decode(answer, memoryview(body)[end + 1 :], source)

    @staticmethod
    def _refuse_slow(kind: FileKind, ended: int, source: str, limits: Limits) -> None:
        """Refuse a file whose reader was ended by one of the signals that are sent after a time."""
        if ended in (signal.SIGPROF, signal.SIGALRM):
            seconds = limits.reader_seconds if ended == signal.SIGPROF else limits.reader_clock_seconds
            raise MeasurementError(source, rule=f"{kind.name} file: takes longer than {seconds:g} s to be read")

    def _running(self) -> subprocess.Popen[bytes]:
        # A process that was forked off has its parent's pipes, which it must not share.
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            root = str(Path(__file__).parents[4])
            path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
            self._process = subprocess.Popen(
                [sys.executable, "-m", "jointplay.catalogue.measurements.readers.zygote"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": path},
                pipesize=_PIPE_BYTES,
                start_new_session=True,
            )
            self._owner = os.getpid()
        return self._process

    @staticmethod
    def _kill(process: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)

    def close(self) -> None:
        """End the process; the next file starts another."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            self._kill(process)
            for stream in (process.stdin, process.stdout):
                with contextlib.suppress(OSError):
                    if stream is not None:
                        stream.close()
            process.wait()


CELL = Cell()
atexit.register(CELL.close)
