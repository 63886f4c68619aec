"""Files of recordings, checked while they are read: what is not what was stored is never read as if it was."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from jointplay.app.errors import RecordingDamagedError, RecordingMissingError

NAMED = re.compile(r"[0-9a-f]{64}")
"""Name of a file that is kept: the SHA-256 of its bytes. One on its way has another."""

BLOCK = 1 << 20


def read_bytes(path: Path | str) -> bytes:
    """Return the bytes of a recording, if they are those that were stored.

    Raises
    ------
    RecordingMissingError
        There is no such file.
    RecordingDamagedError
        It holds other bytes than its name says, is a link or no file, or cannot be read.
    """
    blocks = list(blocks_of(Path(path)))
    return blocks[0] if len(blocks) == 1 else b"".join(blocks)


def check_file(path: Path) -> Iterator[int]:
    """Read a recording block by block, and give how many bytes each had.

    Raises
    ------
    RecordingMissingError, RecordingDamagedError
        As :func:`read_bytes`.
    """
    for block in blocks_of(path):
        yield len(block)


def blocks_of(path: Path) -> Iterator[bytes]:
    """Give the bytes of a recording; after the last it is said whether they are those that were stored.

    Raises
    ------
    RecordingMissingError, RecordingDamagedError
        As :func:`read_bytes`.
    """
    digest = hashlib.sha256()
    try:
        # A link is not followed, and what is no file (a pipe) is not waited for.
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC), "rb", buffering=0) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise damaged(path, "is no file")
            while block := file.read(BLOCK):
                digest.update(block)
                yield block
    except FileNotFoundError:
        raise RecordingMissingError(f"recording {path.name[:16]}: its file is missing; {CURE}") from None
    except OSError as error:
        raise damaged(
            path, "is a link" if error.errno == errno.ELOOP else f"cannot be read: {error.strerror}"
        ) from None
    if NAMED.fullmatch(path.name) and digest.hexdigest() != path.name:
        raise damaged(path, f"is not what was stored: its SHA-256 is {digest.hexdigest()[:16]}…")


CURE = "bring it back from a backup"


def damaged(path: Path, rule: str) -> RecordingDamagedError:
    """Return the error for a file that is not what was stored."""
    return RecordingDamagedError(f"recording {path.name[:16]}: its file {rule}; {CURE}")
