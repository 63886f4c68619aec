"""Cross-power matrices of three motions as real numbers: Hermitian ones as nine, cyclic ones as twelve each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.arrays import AnyComplexArray
from jointplay.solver.spectra.band_power import CYCLES

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

CYCLIC = tuple(
    f"{part} {pair} {cycle}"
    for cycle in CYCLES
    for pair in ("x x", "y y", "theta theta", "x y", "x theta", "y theta")
    for part in ("re", "im")
)
"""What the numbers of cyclic cross-powers are: symmetric matrices, one for each cyclic order."""

COLUMNS = len(PACKED) + len(CYCLIC)
"""Numbers of a feature band: its cross-powers, then its cyclic ones."""

_ABOVE = ((0, 1), (0, 2), (1, 2))
_SYMMETRIC = ((0, 0), (1, 1), (2, 2), *_ABOVE)


def pack(power: AnyComplexArray) -> NDArray[np.float32]:
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


def pack_cyclic(cyclic: AnyComplexArray) -> NDArray[np.float32]:
    """Numbers, in the order of :data:`CYCLIC`, of the cyclic cross-powers of every band.

    Parameters
    ----------
    cyclic : ndarray of complex, shape (..., k, 3, 3)
        Symmetric; one matrix for each of :data:`jointplay.solver.spectra.band_power.CYCLES`.

    Returns
    -------
    ndarray of float32, shape (..., 12 k)
    """
    first, second = zip(*_SYMMETRIC, strict=True)
    values = np.ascontiguousarray(cyclic[..., first, second], np.complex64)
    return values.reshape(*values.shape[:-2], -1).view(np.float32)


def unpack_cyclic(packed: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Matrices (..., k, 3, 3) of :func:`pack_cyclic`'s numbers; its inverse."""
    values = np.ascontiguousarray(packed, np.float32).view(np.complex64)
    values = values.reshape(*packed.shape[:-1], len(CYCLES), len(_SYMMETRIC))
    cyclic = np.empty((*values.shape[:-1], 3, 3), np.complex64)
    for k, (i, j) in enumerate(_SYMMETRIC):
        cyclic[..., i, j] = cyclic[..., j, i] = values[..., k]
    return cyclic
