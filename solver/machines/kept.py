"""Results that are kept by machine, as its file writes it.

Machines of the same content are equal in whatever order their files name links and joints, but equations written in
another order round otherwise. What is kept must not depend on which of them a process met first.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar, cast

from jointplay.solver.machines.machine import Machine

Function = TypeVar("Function", bound=Callable[..., Any])


def keep_by_machine(most: int) -> Callable[[Function], Function]:
    """Keep the last `most` results of a function of a machine and of other things that can be hashed."""

    def decorated(function: Function) -> Function:
        @lru_cache(maxsize=most)
        def of(order: tuple[tuple[str, ...], ...], machine: Machine, *others: Any) -> Any:
            return function(machine, *others)

        def found(machine: Machine, *others: Any) -> Any:
            return of((tuple(machine.links), tuple(machine.joints)), machine, *others)

        found.__doc__ = function.__doc__
        return cast(Function, found)

    return decorated
