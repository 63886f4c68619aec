"""Kernels in scalar Python bound to a compiler: the functions that a driver calls, one case a call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from jointplay.solver.integrators.kernel import KernelCode

Function = Callable[..., Any]
#: A compiler: takes a function and returns one that can be called in its place.
Compile = Callable[[Function], Function]


def kernel_functions(code: KernelCode, compiled: Compile) -> dict[str, Function]:
    """Compile the functions of scalar source: ``prepare``, ``held``, ``dopri``, ``project``.

    Parameters
    ----------
    code : KernelCode
        In the scalar dialect. Without closures ``project`` does nothing.
    compiled : callable
        The compiler.
    """
    scope: dict[str, Any] = {}
    exec(compile(code.text, "<kernel>", "exec"), scope)
    names = ["prepare", "held", "dopri", *(["project"] if code.constrained else [])]
    for name in names:
        scope[name] = compiled(scope[name])  # also where `dopri` looks for `held`
    functions = {name: scope[name] for name in names}
    return {"project": compiled(_nothing), **functions}


def _nothing(w: Any) -> None:
    """No closures to restore."""
