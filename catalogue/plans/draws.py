"""Random numbers of a plan: what is uncertain about a machine, and space-filling draws of it."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np
from pydantic import model_validator
from scipy.special import ndtri

from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.fields import QuantityField, RuleError, VectorField
from jointplay.solver.machines.parts import Part
from jointplay.solver.machines.units import RATIO

#: Width of the cells of a scrambled Sobol sequence of 30 bits; keeps draws off 0, where a normal quantile is infinite.
_CELL = 2.0**-30

_PositiveBounds = Annotated[tuple[float, float], VectorField((QuantityField(RATIO, above=0.0),) * 2)]


class Distribution(Part):
    """How one number of the machine scatters; exactly one of the fields is given.

    Parameters
    ----------
    uniform, loguniform : (float, float), optional
        Bounds of a uniform, or log-uniform (> 0), distribution of the number itself, SI.
    either_loguniform : (float, float), optional
        Bounds, > 0, of the log-uniform size of a number of either sign: of what there may be little or much of.
    factor_uniform, factor_loguniform : (float, float), optional
        Bounds, > 0, of a distribution of the factor on the machine's own number.
    lognormal : float, optional
        Standard deviation, > 0, of the natural logarithm of the factor on the machine's own number; its median is 1.
    """

    uniform: Annotated[tuple[float, float], VectorField((QuantityField(RATIO),) * 2)] | None = None
    loguniform: _PositiveBounds | None = None
    either_loguniform: _PositiveBounds | None = None
    factor_uniform: _PositiveBounds | None = None
    factor_loguniform: _PositiveBounds | None = None
    lognormal: Annotated[float, QuantityField(RATIO, above=0.0)] | None = None

    @model_validator(mode="after")
    def _one_in_order(self) -> Self:
        given = {name: getattr(self, name) for name in type(self).model_fields if getattr(self, name) is not None}
        if len(given) != 1:
            raise RuleError(f"must give exactly one of {', '.join(type(self).model_fields)}")
        for name, value in given.items():
            if isinstance(value, tuple) and value[0] > value[1]:
                raise RuleError("must be [low, high] with low <= high", (name,), list(value))
        return self

    @property
    def is_factor(self) -> bool:
        """Whether :meth:`quantile` is a factor on the machine's own number, not the number itself."""
        return self.uniform is None and self.loguniform is None and self.either_loguniform is None

    def quantile(self, u: float) -> float:
        """Number, or factor, below which the fraction `u` (in [0, 1]) of all draws lies."""
        if self.lognormal is not None:
            deviate = float(ndtri(min(max(u, _CELL / 2), 1.0 - _CELL / 2)))
            return math.exp(self.lognormal * deviate)
        if self.either_loguniform is not None:
            return math.copysign(log_uniform(*self.either_loguniform, abs(2.0 * u - 1.0)), u - 0.5)
        logarithmic = self.loguniform or self.factor_loguniform
        if logarithmic is not None:
            return log_uniform(*logarithmic, u)
        bounds = self.uniform or self.factor_uniform
        assert bounds is not None  # one of them is given, see _one_in_order
        low, high = bounds
        return low + u * (high - low)

    def __str__(self) -> str:
        """In words: ``x 0.97 to 1.03``."""
        if self.lognormal is not None:
            return f"x exp({self.lognormal:g} N(0, 1))"
        if self.either_loguniform is not None:
            return "+-{:g} to {:g} (log)".format(*self.either_loguniform)
        bounds = self.uniform or self.loguniform or self.factor_uniform or self.factor_loguniform
        assert bounds is not None
        scale = " (log)" if self.loguniform or self.factor_loguniform else ""
        return f"{'x ' if self.is_factor else ''}{bounds[0]:g} to {bounds[1]:g}{scale}"


def log_uniform(low: float, high: float, u: float) -> float:
    """Quantile `u` of the log-uniform distribution between `low` and `high`."""
    return low * math.pow(high / low, u)


def unit_draws(seed: int, dimensions: int, count: int) -> FloatArray:
    """The first `count` points of the scrambled Sobol sequence of `seed` in the unit cube.

    Row i does not depend on `count`: asking for more continues the sequence.

    Parameters
    ----------
    seed : int
        Seed of the scrambling.
    dimensions : int
        Numbers drawn at a time, >= 1.
    count : int
        Number of points.

    Returns
    -------
    ndarray, shape (count, dimensions)
        In [0, 1).

    Notes
    -----
    Owen's scrambling as left matrix scrambling with a digital shift (J. Matousek, J. Complexity 14 (1998)), by SciPy.
    Counts that are powers of two are balanced in every dimension.
    """
    from scipy.stats import qmc  # takes half a second to load, which opening a catalogue can do without

    sequence = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    exponent = max(0, math.ceil(math.log2(max(count, 1))))
    points: FloatArray = sequence.random_base2(exponent)
    return points[:count]
