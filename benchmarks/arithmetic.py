"""One right-hand side: operations, instructions, nanoseconds, and the share of what the core's arithmetic can do."""

from __future__ import annotations

import ctypes
import re
from collections import Counter
from collections.abc import Callable, Mapping

import casadi as ca
import llvmlite.binding as llvm
import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks import slider_crank
from benchmarks.computer import processor_seconds
from benchmarks.scenes import Scene, p1, quick_return
from jointplay.solver.cases.start import start_velocity
from jointplay.solver.compiler import native
from jointplay.solver.compiler.ir import DECLARATIONS, LANES, ROW
from jointplay.solver.equations.model import Model, build_model
from jointplay.solver.integrators import gill
from jointplay.solver.integrators.kernel import Kernel, compile_model, kernel_code
from jointplay.solver.machines.machine import Machine

Array = NDArray[np.float64]

_ROUNDS = 7
#: Independent chains of fused multiplications and additions that measure the core's peak: enough to hide their latency,
#: few enough to stay in registers of AVX2, two a row, and turns of the loop.
_CHAINS, _TURNS = 6, 2_000_000


def casadi_operations(model: Model) -> int:
    """Instructions of the right-hand side as symbols, inputs and outputs included."""
    function = ca.Function("right", [model.t, model.z, model.v, model.p], ca.cse([model.acceleration]))
    return int(function.n_instructions())


def _body(text: str, opening: str, closing: str) -> str:
    start = text.index(opening)
    return text[start : text.index(closing, start)]


def flops(text: str) -> int:
    """Floating-point operations per lane of ``rhs`` in vector code: fused multiply-add counts as two."""
    body = _body(text, "@rhs(ptr", "\n}")
    single = re.findall(
        r"= (?:f(?:add|sub|mul|div|neg|cmp)|call [^@]*@llvm\.(?:sqrt|floor|fabs|maxnum|minnum)\.)", body
    )
    return len(single) + 2 * body.count("@llvm.fmuladd.")


def assembly(text: str) -> str:
    """What the compiler makes of vector code, with the options of :mod:`jointplay.solver.compiler.native`."""
    name, features = native.processor()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=name, features=features, opt=3, codemodel="jitdefault", jit=True
    )
    module = llvm.parse_assembly(text)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    return str(machine.emit_assembly(module))


def instructions(text: str) -> dict[str, int]:
    """Machine instructions of ``rhs`` by kind, of all lanes together."""
    body = _body(assembly(text), "\nrhs:", "\n.Lfunc_end")
    names = Counter(match.group(1) for match in re.finditer(r"^\t([a-z][a-z0-9]*)", body, re.MULTILINE))
    vector = {name: n for name, n in names.items() if name.startswith("v")}
    arithmetic = re.compile(r"v(f?n?m?(add|sub|mul|div|sqrt|max|min|cmp|rndscale|round|reduce|rcp)|fmadd|fmsub|fnm)")
    return {
        "all": sum(names.values()),
        "vector": sum(vector.values()),
        "arithmetic": sum(n for name, n in vector.items() if arithmetic.match(name) and name.endswith(("pd", "sd"))),
        "divisions and roots": sum(n for name, n in vector.items() if name.startswith(("vdiv", "vsqrt"))),
    }


def filled(kernel: Kernel, model: Model, clearances: Mapping[str, float]) -> Array:
    """Work array with all lanes at the start of one case."""
    p = model.vector({f"joints.{joint}.clearance": value for joint, value in clearances.items()})
    z = np.zeros(model.size)
    work, rows = kernel.work_array(), kernel.rows
    for place, column in ((rows.z, z), (rows.v, start_velocity(model, p, z)), (rows.parameters, p)):
        work[place] = np.reshape(column, (-1, 1))
    return work


def nanoseconds(machine: Machine, clearances: Mapping[str, float]) -> tuple[float, Kernel, Model]:
    """Of one right-hand side per lane, all lanes filled."""
    model = build_model(machine, tuple(clearances))
    kernel = compile_model(model)
    work = filled(kernel, model, clearances)
    count = max(200, 8_000_000 // max(kernel.operations, 1) // 4)
    gill.repeat(kernel.functions, work, 1)
    spent = processor_seconds(lambda: gill.repeat(kernel.functions, work, count), _ROUNDS)
    return 1e9 * spent / count / LANES, kernel, model


@njit(error_model="numpy")
def _by_hand(count: int, y: Array, out: Array) -> float:
    total = 0.0
    for i in range(count):
        slider_crank.derivative(1e-9 * i, y, slider_crank.BY_STATE, out)
        total += out[6]
    return total


def _fma_loop() -> str:
    """``void peak(double* w)`` as LLVM assembly: rows w[k] = w[k] * a + b, many times over."""
    chains = range(_CHAINS)
    start = "\n".join(
        f"  %p{k} = getelementptr {ROW}, ptr %w, i64 {k}\n  %s{k} = load {ROW}, ptr %p{k}, align 8" for k in chains
    )
    kept = "\n".join(f"  %x{k} = phi {ROW} [ %s{k}, %entry ], [ %y{k}, %loop ]" for k in chains)
    call = f"call {ROW} @llvm.fmuladd.v{LANES}f64"
    work = "\n".join(f"  %y{k} = {call}({ROW} %x{k}, {ROW} %s0, {ROW} %s1)" for k in chains)
    end = "\n".join(f"  store {ROW} %y{k}, ptr %p{k}, align 8" for k in chains)
    return f"""{DECLARATIONS}
define void @peak(ptr %w) {{
entry:
{start}
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %loop ]
{kept}
{work}
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, {_TURNS}
  br i1 %more, label %loop, label %done
done:
{end}
  ret void
}}
"""


def peak_gflops() -> float:
    """Of one core: independent chains of fused multiplications and additions on rows, in registers alone."""
    peak = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(native.load(_fma_loop())("peak"))
    rows = np.full(_CHAINS * LANES, 0.5)
    spent = processor_seconds(lambda: peak(rows.ctypes.data), _ROUNDS)
    return 2 * _CHAINS * LANES * _TURNS / spent / 1e9


def _one(scene: Scene, peak: float) -> dict[str, object]:
    ns, kernel, model = nanoseconds(scene.machine, dict(scene.fault.items()))
    text = kernel_code(model).text
    work = flops(text)
    return {
        "scene": scene.name, "coordinates": model.size, "symbols": casadi_operations(model),
        "operations": kernel.operations, "flops": work, "instructions": instructions(text), "ns": ns,
        "gflops": work / ns, "share": work / ns / peak,
    }  # fmt: skip


def measure(quick: bool, say: Callable[[str], None]) -> dict[str, object]:
    """P1 and QR, and P1 by hand."""
    peak = peak_gflops()
    rows = []
    for scene in (p1(), quick_return()):
        rows.append(_one(scene, peak))
        say(f"right-hand side: {scene.name}: {rows[-1]['operations']} operations, {rows[-1]['ns']:.1f} ns")
    y, out = slider_crank.start(), np.empty(slider_crank.SIZE)
    _by_hand(1, y, out)
    count = 20_000 if quick else 200_000
    by_hand = 1e9 * processor_seconds(lambda: _by_hand(count, y, out), _ROUNDS) / count
    return {"peak_gflops": peak, "rows": rows, "by_hand_ns": by_hand}
