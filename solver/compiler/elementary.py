"""Elementary functions as straight vector code.

A call into the C library would stop the lanes, so sine, cosine, tanh, exp and log are written out: arithmetic and
selects. ``tests/solver/test_elementary.py`` measures their accuracy: sine and cosine 1.2e-16 absolute for arguments up
to 1e6 rad, tanh 2e-15 relative, exp 5e-16 and log 3e-16 relative (log of numbers near 1: 3e-16 absolute).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from jointplay.solver.compiler.ir import Block

#: pi/2 in three parts for the argument reduction; products of k < 2^24 with the first are exact.
_HALF_PI = (1.5707963109016418, 1.5893254712295857e-08, 6.123233995736766e-17)

_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(1, 8)]
_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(2, 9)]
#: expm1(r) = r + r^2 (1/2 + r/6 + ...) for |r| <= ln 2 / 2, where the first term left out is 2e-17 of the result.
_EXPM1 = [1 / math.factorial(k) for k in range(2, 14)]
#: ln 2 in two parts; products of k < 2^20 with the first are exact.
_LN2 = (0.693147180369123816490, 1.90821492927058770002e-10)
#: Beyond this tanh is 1 to the last bit.
_TANH_LIMIT = 20.0
#: Beyond this exp leaves the range of normal numbers.
_EXP_LIMIT = 700.0
#: log m = 2 s (1 + s^2/3 + s^4/5 ...) with s = (m - 1)/(m + 1), |s| <= 0.172; the first term left out is 1e-17.
_LOG = [2 / (2 * k + 1) for k in range(1, 11)]


def _polynomial(block: Block, x: str, coefficients: Sequence[float]) -> str:
    """Estrin's scheme: half the depth of Horner's, and the lanes wait for latency, not for arithmetic."""
    terms = [block.constant(c) for c in coefficients]
    power = x
    while len(terms) > 1:
        pairs = [
            block.fma(terms[i + 1], power, terms[i]) if i + 1 < len(terms) else terms[i]
            for i in range(0, len(terms), 2)
        ]
        terms = pairs
        if len(terms) > 1:
            power = block.mul(power, power)
    return terms[0]


def sine_cosine(block: Block, x: str) -> tuple[str, str]:
    """Sine and cosine of a row."""
    k, quadrant = block.nearest(x, 2 / math.pi)
    r = x
    for part in _HALF_PI:
        r = block.fma(k, block.constant(-part), r)
    z = block.mul(r, r)
    sine = block.fma(block.mul(r, z), _polynomial(block, z, _SINE), r)
    cosine = block.fma(z, block.constant(-0.5), block.constant(1.0))
    cosine = block.fma(block.mul(z, z), _polynomial(block, z, _COSINE), cosine)
    # Odd quadrants exchange the two; bit 1 of k is the sign of the sine, bit 1 of k + 1 that of the cosine.
    odd = block.lowest_bit(quadrant)
    signs = [
        block.integer("shl", block.integer("and", bits, 2), 62)
        for bits in (quadrant, block.integer("add", quadrant, 1))
    ]
    return (
        block.flip_sign(block.select(odd, cosine, sine), signs[0]),
        block.flip_sign(block.select(odd, sine, cosine), signs[1]),
    )


def _reduced_exponential(block: Block, x: str) -> tuple[str, str]:
    """expm1(r) and 2^k with x = r + k ln 2."""
    k, whole = block.nearest(x, 1 / math.log(2))
    r = x
    for part in _LN2:
        r = block.fma(k, block.constant(-part), r)
    reduced = block.fma(block.mul(r, r), _polynomial(block, r, _EXPM1), r)
    return reduced, block.power_of_two(whole)


def exponential(block: Block, x: str) -> str:
    """exp of a row, held between exp(-700) and exp(700)."""
    held = block.call("maxnum", x, block.constant(-_EXP_LIMIT))
    reduced, scale = _reduced_exponential(block, block.call("minnum", held, block.constant(_EXP_LIMIT)))
    return block.fma(scale, reduced, scale)


def logarithm(block: Block, x: str) -> str:
    """Natural logarithm of a row of positive normal numbers."""
    mantissa, exponent = block.split(x)
    one = block.constant(1.0)
    s = block.div(block.sub(mantissa, one), block.add(mantissa, one))
    z = block.mul(s, s)
    tail = block.fma(block.mul(s, z), _polynomial(block, z, _LOG), block.add(s, s))
    low = block.fma(exponent, block.constant(_LN2[1]), tail)
    return block.fma(exponent, block.constant(_LN2[0]), low)


def hyperbolic_tangent(block: Block, x: str) -> str:
    """tanh of a row, as E / (E + 2) with E = expm1(2 |x|), accurate relative to itself down to nothing."""
    size = block.call("minnum", block.call("fabs", x), block.constant(_TANH_LIMIT))
    y = block.add(size, size)
    reduced, scale = _reduced_exponential(block, y)
    e = block.fma(scale, reduced, block.sub(scale, block.constant(1.0)))
    value = block.div(e, block.add(e, block.constant(2.0)))
    return block.select(block.compare("olt", x, block.constant(0.0)), block.neg(value), value)
