"""Compiled functions, kept on disk by the content of the package's source.

Numba keeps what it compiles beside each file and looks at that file alone: it would miss a change of a function that
the file only calls, and trip over a class that a newer version has renamed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core import config

from jointplay.solver.compiler.native import cache_directory

_config: Any = config
#: What every compiled function has in common: numbers that are none stay what they are, and other threads may run.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


@cache
def _directory() -> Path | None:
    """Where compiled functions of just this source are kept; ``None`` where nothing can be written."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    directory = cache_directory() / "functions" / digest.hexdigest()[:16]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe = directory / ".writable"
        probe.touch()
    except OSError:
        return None
    return directory


def compiled(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function when it is first called, or take it from the disk.

    Parameters
    ----------
    function : callable
    **options
        Further options of :func:`numba.njit`.
    """
    directory = _directory()
    if directory is None:
        return njit(**_OPTIONS, **options)(function)
    before = _config.CACHE_DIR
    _config.CACHE_DIR = str(directory)  # read when a function is decorated
    try:
        return njit(cache=True, **_OPTIONS, **options)(function)
    finally:
        _config.CACHE_DIR = before


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into every compiled one that calls it.

    For what runs at every step: handing an array over is nine words on the stack, and a count of references.
    """
    return compiled(function, forceinline=True)
