"""Hermitian 3 x 3 cross-power matrices as nine real numbers, and back without loss."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["CHANNELS", "PACKED", "UNITS", "pack", "unpack"]

CHANNELS = ("x", "y", "theta")
"""Motions of the frame, in the order of rows and columns of a matrix."""

UNITS = ("(m/s2)^2", "(m/s2)^2", "(rad/s2)^2")
"""Units of the diagonal; that of an element off the diagonal is the product of its two motions' units."""

PACKED = (
    "x x",
    "y y",
    "theta theta",
    "re x y",
    "im x y",
    "re x theta",
    "im x theta",
    "re y theta",
    "im y theta",
)  # fmt: skip
"""What the nine numbers are."""

_ABOVE = ((0, 1), (0, 2), (1, 2))


def pack(power: NDArray[np.complexfloating]) -> NDArray[np.float32]:
    """Nine numbers, in the order of :data:`PACKED`, of every matrix.

    Parameters
    ----------
    power : ndarray of complex, shape (..., 3, 3)
        Hermitian.

    Returns
    -------
    ndarray of float32, shape (..., 9)
    """
    packed = np.empty((*power.shape[:-2], len(PACKED)), dtype=np.float32)
    for i in range(3):
        packed[..., i] = power[..., i, i].real
    for k, (i, j) in enumerate(_ABOVE):
        packed[..., 3 + 2 * k] = power[..., i, j].real
        packed[..., 4 + 2 * k] = power[..., i, j].imag
    return packed


def unpack(packed: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Matrices of nine numbers each; the inverse of :func:`pack`.

    Parameters
    ----------
    packed : ndarray of float32, shape (..., 9)

    Returns
    -------
    ndarray of complex64, shape (..., 3, 3)
        Hermitian.
    """
    power = np.empty((*packed.shape[:-1], 3, 3), dtype=np.complex64)
    for i in range(3):
        power[..., i, i] = packed[..., i]
    for k, (i, j) in enumerate(_ABOVE):
        power[..., i, j] = packed[..., 3 + 2 * k] + 1j * packed[..., 4 + 2 * k]
        power[..., j, i] = power[..., i, j].conj()
    return power
