"""The oil between a pin and its socket, as it stands in a machine file."""

from __future__ import annotations

from typing import Annotated

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import QuantityField
from jointplay.solver.machines.parts import Part

#: Largest dynamic viscosity of a film, Pa s: gear oil in frost. More is a number in cP or mPa s.
MOST_VISCOUS = 20.0
#: Length over diameter up to which a bearing is short: the oil leaves it along the pin, not around it.
SHORT = 1.0


class Film(Part):
    """A film of oil, which a turning joint with a ``pin_radius`` has once it has clearance.

    ``viscosity`` is the dynamic one at the joint's temperature [Pa s], ``length`` that of the bearing along the pin
    [m]. ``roughness`` is that of both surfaces together [m]: no film is thinner, their tips meet.
    """

    viscosity: Annotated[float, QuantityField(units.VISCOSITY, above=0, at_most=MOST_VISCOUS)]
    length: Annotated[float, QuantityField(units.LENGTH, above=0)]
    roughness: Annotated[float, QuantityField(units.LENGTH, above=0, at_most=1e-3)] = 1e-6
