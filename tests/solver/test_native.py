"""The disk cache of compiled kernels: content-keyed, safe against damage and against company."""

from __future__ import annotations

import ctypes
import multiprocessing
from pathlib import Path

import numpy as np
import pytest

from jointplay.solver.compiler import native
from jointplay.solver.compiler.ir import DECLARATIONS, LANES, Block
from jointplay.solver.errors import SettingsError


def _doubling(factor: float) -> str:
    block = Block()
    block.store(0, block.mul(block.load(0), block.constant(factor)))
    return "\n".join([DECLARATIONS, block.function("scale")])


def _run(code: str) -> float:
    work = np.ones(LANES)
    ctypes.CFUNCTYPE(None, ctypes.c_void_p)(native.load(code)("scale"))(work.ctypes.data)
    return float(work[0])


def _compile_elsewhere(directory: str, factor: float) -> int:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JOINTPLAY_CACHE_DIR", directory)
        return len(native.object_code(_doubling(factor)))


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("JOINTPLAY_CACHE_DIR", str(tmp_path))
    return tmp_path / "kernels"


def test_second_use_reads_what_the_first_left(cache: Path) -> None:
    code = _doubling(2.5)
    assert _run(code) == 2.5
    (path,) = cache.iterdir()
    before = path.read_bytes(), path.stat().st_mtime_ns
    native.object_code(code)
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before


def test_other_content_is_another_file(cache: Path) -> None:
    native.object_code(_doubling(3.0))
    native.object_code(_doubling(3.5))
    assert len(list(cache.iterdir())) == 2


def _compile_for(directory: str, name: str) -> int:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_CPU_NAME", name)
        patch.setenv("NUMBA_CPU_FEATURES", "")
        return _compile_elsewhere(directory, 5.5)


def test_another_processor_is_another_file(cache: Path) -> None:
    """Each in a process of its own, which asks once what it compiles for."""
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        pool.starmap(_compile_for, [(str(cache.parent), name) for name in ("generic", "", "generic")], chunksize=1)
    assert len(list(cache.iterdir())) == 2


def _sum_for(name: str) -> bytes:
    block = Block()
    block.store(0, block.fma(block.load(0), block.load(LANES), block.load(2 * LANES)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_CPU_NAME", name)
        return native.object_code("\n".join([DECLARATIONS, block.function("sum")]))


def test_a_processor_that_cannot_fuse_does_not_ask_the_c_library(cache: Path) -> None:
    """The library's way of rounding once takes two hundred times as long as all the rest."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert b"fma\0" not in pool.apply(_sum_for, ["generic"])


@pytest.mark.parametrize("damage", [b"", b"not an object file", None])
def test_a_damaged_file_is_compiled_again(cache: Path, damage: bytes | None) -> None:
    code = _doubling(4.0)
    good = native.object_code(code)
    (path,) = cache.iterdir()
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]) if damage is None else damage)
    assert native.object_code(code) == good
    assert path.read_bytes() == content


def test_processes_that_compile_the_same_kernel(cache: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        sizes = pool.starmap(_compile_elsewhere, [(str(cache.parent), 5.0)] * 6)
    assert len(set(sizes)) == 1
    assert [path.suffix for path in cache.iterdir()] == [".o"]


def test_a_cache_that_cannot_be_used_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("JOINTPLAY_CACHE_DIR", str(tmp_path / "file"))
    with pytest.raises(SettingsError, match=r"^kernel cache .*; set JOINTPLAY_CACHE_DIR$"):
        native.object_code(_doubling(6.0))
