"""Machine code for this processor, kept on disk by content: of LLVM assembly, and of functions compiled by Numba.

Numba keeps what it compiles beside each file and looks at that file alone: it would miss a change of a function that
the file only calls, and trip over a class that a newer version has renamed. Here the package's whole source counts.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, cast

import llvmlite
import llvmlite.binding as llvm
import numba
import platformdirs
from numba import njit
from numba.core import config

from jointplay.solver.compiler.arrange import VERSION as ARRANGEMENT
from jointplay.solver.compiler.arrange import arrange
from jointplay.solver.errors import SettingsError

_DIGEST = hashlib.sha256().digest_size


def cache_directory() -> Path:
    """Where compiled kernels are kept: ``JOINTPLAY_CACHE_DIR`` or the user's cache directory."""
    configured = os.environ.get("JOINTPLAY_CACHE_DIR")
    base = Path(configured) if configured else Path(platformdirs.user_cache_dir("jointplay"))
    return base / "kernels"


@cache
def processor() -> tuple[str, str]:
    """Name and features of the processor that code is compiled for.

    This one, unless ``NUMBA_CPU_NAME`` and ``NUMBA_CPU_FEATURES`` name another, as they do for what Numba compiles.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    name, features = os.environ.get("NUMBA_CPU_NAME"), os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        features = "" if name == "generic" else llvm.get_host_cpu_features().flatten()
    return name or llvm.get_host_cpu_name(), features


def _target_machine() -> llvm.TargetMachine:
    name, features = processor()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=name, features=features, opt=3, codemodel="jitdefault", jit=True)


def content_key(text: str) -> str:
    """SHA-256 over the code, the processor it is compiled for and the compiler."""
    parts = (text, *processor(), str(ARRANGEMENT), llvmlite.__version__, str(llvm.llvm_version_info))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _compile(text: str) -> bytes:
    machine = _target_machine()
    module = llvm.parse_assembly(arrange(text, processor()[1]))
    module.verify()
    # Straight-line code gains nothing by more.
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
    builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def _read(path: Path) -> bytes | None:
    """Object code, or ``None`` where there is none or a damaged one (it is then compiled again)."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    digest, code = content[:_DIGEST], content[_DIGEST:]
    return code if hashlib.sha256(code).digest() == digest else None


def _publish(path: Path, code: bytes) -> None:
    """Write under another name, then rename: two processes that compile the same kernel cannot meet half a file."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(hashlib.sha256(code).digest() + code)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def object_code(text: str) -> bytes:
    """Machine code of LLVM assembly, from the disk cache where it is there.

    Raises
    ------
    SettingsError
        The cache directory cannot be used.
    """
    directory = cache_directory()
    path = directory / f"{content_key(text)}.o"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        code = _read(path)
        if code is None:
            code = _compile(text)
            _publish(path, code)
    except OSError as error:
        reason = error.strerror or str(error)
        raise SettingsError(f"kernel cache {directory} cannot be used ({reason}); set JOINTPLAY_CACHE_DIR") from error
    return code


_engines: dict[str, llvm.ExecutionEngine] = {}
_loading = threading.Lock()


def load(text: str) -> Callable[[str], int]:
    """Load LLVM assembly into this process; returns what gives the address of a function by name."""
    key = content_key(text)
    with _loading:
        if key not in _engines:
            code = object_code(text)
            engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
            engine.finalize_object()
            _engines[key] = engine
        engine = _engines[key]
    return cast("Callable[[str], int]", engine.get_function_address)


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
