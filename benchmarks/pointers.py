"""Memory by its address, in compiled code: Numba takes a copy of arrays that a function refers to."""

from __future__ import annotations

from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

#: ``carray(pointer, shape)``: an array over memory.
carray: Any = numba.carray  # type: ignore[attr-defined]


def _doubles_at(typing_context: Any, address: Any) -> Any:
    """A number as the address of doubles."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    pointer: Any = types.CPointer
    return pointer(types.float64)(types.int64), generate


#: ``doubles_at(address)`` inside compiled code.
doubles_at: Any = intrinsic(_doubles_at)
