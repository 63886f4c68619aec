"""The process that readers run in: ``python -m jointplay.catalogue.measurements.readers.zygote``.

It loads a reader's library once and forks for every file. The child takes limits of memory, time and output before it
sees the file, and answers in JSON and plain arrays: whatever becomes of it, nothing of it is executed by who asked.
A text of up to 16 MB, which nothing but this program's own code sees, is read without a child, under the limit of time
alone: a fork costs three times what that does.
Requests and answers are a line of JSON with the length of what follows.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, BinaryIO

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.readers.kinds import KINDS, TEXT
from jointplay.catalogue.measurements.readers.raw import Limits, encode
from jointplay.catalogue.measurements.readers.unpacking import check_content, small_content, unpack

#: Beyond the arrays, an answer holds facts; they are short.
_MORE_OUTPUT = 16_000_000


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are none; each file is read in a child of its own."""
    read: set[str] = set()
    while line := requests.readline():
        asked = json.loads(line)
        data = requests.read(asked["bytes"])
        kind, limits = KINDS[asked["kind"]], Limits(**asked["limits"])
        for name in kind.libraries:
            with contextlib.suppress(ImportError):  # of an extra: its reader says so
                import_module(name)
        if kind.example and kind.name not in read:
            read.add(kind.name)
            getattr(import_module(kind.module), kind.function)(kind.example, "example", limits)
        if kind is TEXT and (content := small_content(data)) is not None:
            answer_here(asked, content, limits, answers)
            continue
        with tempfile.TemporaryFile() as file:
            child = os.fork()
            if child == 0:
                answer_and_leave(asked, data, limits, file)
            del data
            _, status = os.waitpid(child, 0)
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            head = {"signal": os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0, "bytes": size}
            answers.write(json.dumps(head).encode() + b"\n")
            while part := file.read(1 << 20):
                answers.write(part)
            answers.flush()


def answer_here(asked: dict[str, Any], content: bytes, limits: Limits, answers: BinaryIO) -> None:
    """Read a small text in this process, and write the answer."""
    with limited_time(limits):
        answer = answer_to(asked, lambda: check_content(content, asked["source"], limits, text=True), limits)
    values = memoryview(answer.pop("values", b"")).cast("B")
    line = json.dumps(answer).encode() + b"\n"
    answers.write(json.dumps({"signal": 0, "bytes": len(line) + values.nbytes}).encode() + b"\n")
    answers.write(line)
    answers.write(values)
    answers.flush()


@contextlib.contextmanager
def limited_time(limits: Limits) -> Iterator[None]:
    """Let a signal end this process when the block takes too long; whoever asked is told so by that."""
    try:
        restrict_time(limits)
        yield
    finally:
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0)


def answer_to(asked: dict[str, Any], content: Callable[[], bytes], limits: Limits) -> dict[str, Any]:
    """Return what a reader has of a file, or what is wrong with it."""
    kind = KINDS[asked["kind"]]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of libraries; what matters is checked
            reader = getattr(import_module(kind.module), kind.function)
            return encode(reader(content(), asked["source"], limits, **asked["table"]))
    except MeasurementError as error:
        return {"error": [error.line, error.column, _plain(error.value), error.rule, error.field]}
    except BaseException as error:  # whatever a library raises at a damaged file is a statement about the file
        rule = f"is damaged, or none of the {kind.name} files that are read"
        if _for_want_of_memory(error):
            rule = f"needs more than {limits.reader_memory / 1e6:g} MB to be read"
        return {"error": [None, None, None, rule, ""]}


def answer_and_leave(asked: dict[str, Any], data: bytes, limits: Limits, file: Any) -> None:
    """Read one file under limits, write the answer, and end this process."""
    try:
        restrict(limits)
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)  # libraries print whole damaged files
        text = asked["kind"] == TEXT.name
        write(file, answer_to(asked, lambda: unpack(data, asked["source"], limits, text=text), limits))
    finally:
        with contextlib.suppress(BaseException):
            file.flush()
        os._exit(0)


def restrict_time(limits: Limits) -> None:
    """Limit processor time and time by the clock."""
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, limits.reader_seconds)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, limits.reader_clock_seconds)


def restrict(limits: Limits) -> None:
    """Limit memory (beyond what is taken now), processor time, time by the clock, and size of files."""
    restrict_time(limits)
    with contextlib.suppress(OSError, ValueError):
        with open("/proc/self/statm") as counted:
            taken = int(counted.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + limits.reader_memory, taken + limits.reader_memory))
    largest = limits.file_bytes + limits.decoded_bytes + _MORE_OUTPUT
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def write(file: Any, answer: dict[str, Any]) -> None:
    """Write one line of JSON and the numbers below it, in place of whatever was begun."""
    file.seek(0)
    file.truncate()
    values = answer.pop("values", None)
    file.write(json.dumps(answer).encode() + b"\n")
    if values is not None:
        file.write(memoryview(values).cast("B"))


def _for_want_of_memory(error: BaseException | None) -> bool:
    """Whether a want of memory is at the bottom of it; libraries wrap what they catch."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False


def _plain(value: object) -> object:
    return value if value is None or isinstance(value, str | int | float) else str(value)[:160]


if __name__ == "__main__":
    answers_to = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not stand among the answers
    serve(sys.stdin.buffer, answers_to)
