"""Laws of dry friction by name, with the numbers of each, as they stand in a machine file.

All laws are Coulomb's, mu times the normal force; they differ in what stands for the sign of the sliding velocity v
(:mod:`jointplay.solver.equations.friction`).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import SerializerFunctionWrapHandler, model_serializer, model_validator

from jointplay.solver.machines import units
from jointplay.solver.machines.fields import QuantityField
from jointplay.solver.machines.parts import Part

FrictionLaw: TypeAlias = Literal["bristle", "tanh", "threshold"]
#: Numbers of each law, beside the coefficient.
FRICTION_NUMBERS: dict[FrictionLaw, tuple[str, ...]] = {
    "bristle": ("presliding",),
    "tanh": ("friction_velocity",),
    "threshold": ("friction_velocity",),
}
#: The law of what says neither a law nor a number of one.
USUAL_LAW: FrictionLaw = "bristle"
#: What a file may say of dry friction beside the coefficient.
FRICTION_CHOICES = ("friction_law", "friction_velocity", "presliding")


class DryFriction(Part):
    """Coulomb friction of a contact or a guide.

    ``friction`` is the coefficient. ``friction_law`` is ``bristle``, which sticks: at rest the surfaces hold each other
    and give way by ``presliding`` [m] before they slip; or ``tanh`` or ``threshold``, which creep: full friction only
    from about ``friction_velocity`` [m/s] on. Where no law is said, a number says which; else it is ``bristle`` where
    there is friction.
    """

    friction: Annotated[float, QuantityField(units.RATIO, at_least=0)] = 0.0
    friction_law: FrictionLaw = USUAL_LAW
    friction_velocity: Annotated[float, QuantityField(units.SPEED, above=0)] = 0.01
    presliding: Annotated[float, QuantityField(units.LENGTH, above=0)] = 3e-9

    @property
    def own_friction(self) -> dict[str, Any]:
        """What says the same friction again."""
        names = ("friction", "friction_law", *FRICTION_NUMBERS[self.friction_law])
        return {name: getattr(self, name) for name in names}

    @model_validator(mode="after")
    def _choose_law(self) -> DryFriction:
        given = self.model_fields_set
        if "friction_law" not in given:  # the model is frozen for everybody else
            laws = (law for law, numbers in FRICTION_NUMBERS.items() if law != "threshold" and given & {*numbers})
            # What has no friction keeps the law, and the content key, it had when there was no other.
            self.__dict__["friction_law"] = next(laws, USUAL_LAW if self.friction else "tanh")
        return self

    @model_serializer(mode="wrap")
    def _leave_out_numbers_of_other_laws(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Machines under the first law keep the content key they had when there was no other.
        written: dict[str, Any] = write(self)
        kept = {*FRICTION_NUMBERS[self.friction_law], *(() if self.friction_law == "tanh" else ("friction_law",))}
        return {key: value for key, value in written.items() if key not in FRICTION_CHOICES or key in kept}
