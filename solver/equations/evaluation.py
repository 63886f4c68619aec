"""Numbers of CasADi functions as arrays of NumPy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def evaluate(function: ca.Function, *arguments: ArrayLike) -> list[Array]:
    """Call a function with dense arguments and outputs.

    Parameters
    ----------
    function : casadi.Function
        Such as those of :class:`~jointplay.solver.equations.model_functions.ModelFunctions`.
    arguments : array_like
        Vectors or numbers.

    Returns
    -------
    list of (rows, columns) arrays

    Notes
    -----
    By way of its buffers: CasADi's own conversion of arguments and results takes 60 us, this 20, most functions 1.
    """
    buffer: Any
    buffer, call = function.buffer()
    given = [np.ascontiguousarray(argument, dtype=np.float64) for argument in arguments]
    found = [np.zeros(function.size_out(i), order="F") for i in range(function.n_out())]
    for i, argument in enumerate(given):
        if argument.size != function.nnz_in(i):
            raise ValueError(f"{function.name()}: argument {i} has {argument.size} numbers, not {function.nnz_in(i)}")
        if argument.size:
            buffer.set_arg(i, argument.data)
    for i, result in enumerate(found):
        if function.nnz_out(i) != result.size:
            raise ValueError(f"{function.name()}: output {i} is not dense")
        if result.size:
            buffer.set_res(i, result.reshape(-1, order="F").data)
    call()
    return found
